//! `fmmgi-gpu solve`

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::ValueEnum;
use fmmgi_gpu::illuminate::checks::Checks;
use fmmgi_gpu::illuminate::surface_error;
use fmmgi_gpu::output::{self, Format, Paint, write_atomic, write_stats};
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{
    Checkpoint, Error, IlluminationMap, Method, Progress, Result, Scene, Stats, Transport, memory,
    render,
};
use glam::{DVec3, Vec3};

use super::asked::Asked;
use super::terminal::{self, Terminal};
use super::values::{self, Size};
use super::{Done, outputs, picture, reading};

/// Compute the light at every point of a scan or a scene.
///
/// Lengths are in the scan's unit, light is linear RGB. Without any output only a summary is
/// printed.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub asked: Asked,
    /// Write the points with their light: .ply, .laz, .las, .csv or .npy
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// What the colours of the points that are written are: by default keep in LAS and LAZ, lit in other formats
    #[arg(long, requires = "output")]
    paint: Option<PaintArg>,
    /// Write a picture
    #[arg(long, value_name = "OUT.png")]
    image: Option<PathBuf>,
    /// Write what was done and how well it went
    #[arg(long, value_name = "OUT.json")]
    stats: Option<PathBuf>,
    /// Keep what was found out about the cloud, so that other lights need not find it again
    #[arg(long, value_name = "FILE")]
    save_operator: Option<PathBuf>,
    /// Take what was kept of the same cloud; light that needs more accuracy than those before refines it
    #[arg(long, value_name = "FILE")]
    pub operator: Option<PathBuf>,
    /// Leave what is found in a folder, stage by stage: the same command goes on there, if it was killed
    #[arg(long, value_name = "DIR")]
    checkpoint: Option<PathBuf>,
    /// Tell only how well the equation over the surfels is solved, and not how far the light is off because they are
    /// not the scanned surface (a half of the time): the tolerance is that of the solver
    #[arg(long)]
    solver_error: bool,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", value_parser = values::size, default_value = "1280x720")]
    size: Size,
    /// Tell what is being done
    #[arg(short, long, conflicts_with = "quiet")]
    verbose: bool,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum PaintArg {
    /// The light that leaves them, as a display shows it; original_red... are those of the input
    Lit,
    /// The light that arrives, as a display shows it; original_red... are those of the input
    Irradiance,
    /// Those of the input
    Keep,
}

impl From<PaintArg> for Paint {
    fn from(arg: PaintArg) -> Self {
        match arg {
            PaintArg::Lit => Paint::Lit,
            PaintArg::Irradiance => Paint::Irradiance,
            PaintArg::Keep => Paint::Keep,
        }
    }
}

pub fn run(args: &Args) -> Result<Done> {
    run_with(args, |scene| scene.lights.extend(&args.asked.light))
}

/// The same, where `hang` says which point lights there are.
pub fn run_with(args: &Args, hang: impl FnOnce(&mut Scene)) -> Result<Done> {
    let began = Instant::now();
    let asked = &args.asked;
    let results = [&args.output, &args.image, &args.stats];
    let files: Vec<&Path> = (results.into_iter().chain([&args.save_operator]))
        .filter_map(Option::as_deref)
        .collect();
    outputs::check(&asked.inputs, &files)?;
    args.output.as_deref().map(Format::of).transpose()?;
    args.image.as_deref().map(outputs::check_png).transpose()?;
    if let Some(operator) = &args.operator {
        // A kept operator may be replaced by itself, refined.
        let results: Vec<&Path> = results.into_iter().filter_map(Option::as_deref).collect();
        outputs::spare(operator, &results)?;
    }
    let mut options = asked.options();
    if args.save_operator.is_some() || args.operator.is_some() {
        options.check_keeping()?;
        // What is kept are links, however few points there are.
        options.method = Method::Fmm;
    }
    let progress = Terminal::new(args.quiet, args.verbose);
    let checkpoint = args
        .checkpoint
        .as_deref()
        .map(|folder| Checkpoint::open(folder, &progress))
        .transpose()?;
    let mut chosen = asked.open(options.method)?;
    terminal::stop_on_ctrl_c();

    let mut scene = asked.load(&progress)?;
    for source in &scene.sources {
        outputs::spare(&source.path, &files)?;
    }
    hang(&mut scene);
    scene.sky = asked.sky.unwrap_or(scene.sky);
    let load = began.elapsed().as_secs_f64();
    reading::tell(&scene, &progress)?;
    warn_of_darkness(&scene, &progress);
    let about = |error: Error| asked.about(error);
    let (transport, mut result) = chosen.run(&progress, |backend| {
        let mut transport = match &args.operator {
            Some(path) => Transport::load(path, &scene, &options, backend, &progress)?,
            None => Transport::new(&scene, &options, backend, &progress).map_err(about)?,
        };
        let result = match &checkpoint {
            None => transport.illuminate(&scene, &progress),
            Some(checkpoint) => transport.illuminate_from(&scene, checkpoint, &progress),
        };
        let mut result = result.map_err(about)?;
        if !args.solver_error {
            result.stats.surface_error =
                surface_error(&scene, &options, backend, &result, &progress).map_err(about)?;
        }
        Ok((transport, result))
    })?;
    warn_of_lost_lamps(&scene, &result.map, &progress);
    let kept = args.save_operator.as_deref().zip(Some(transport));

    // Everything is computed before anything is written: an interruption leaves no half result.
    let png = args
        .image
        .as_ref()
        .map(|_| {
            let (surfels, map) = (&result.surfels, &result.map);
            let exposure = render::tone::exposure(&map.radiosity);
            picture::take(&scene, surfels, map, args.size, exposure, &progress)
        })
        .transpose()?;
    progress.check()?;
    progress.finish();

    let written = Instant::now();
    if let Some(path) = &args.output {
        let paint = args.paint.map(Paint::from);
        output::write_scene(path, &scene, &result.map, paint, &progress)?;
    }
    if let (Some(path), Some(png)) = (&args.image, png) {
        write_atomic(path, |writer| writer.write_all(&png))?;
    }
    if let Some((path, transport)) = &kept {
        transport.save(path)?;
    }
    let stats = &mut result.stats;
    stats.seconds.load = load;
    stats.seconds.write = written.elapsed().as_secs_f64();
    stats.seconds.total = began.elapsed().as_secs_f64();
    stats.peak_memory_bytes = memory::peak_bytes();
    if let Some(path) = &args.stats {
        write_stats(path, stats)?;
    }
    checkpoint.map_or(Ok(()), Checkpoint::clear)?;
    if !args.quiet {
        super::print(&summary(stats, &chosen.describe(), &files))?;
    }
    Ok(if stats.converged && stats.met() {
        Done::Well
    } else {
        Done::NotConverged
    })
}

/// A scan has no lights of its own, and a black result would puzzle.
fn warn_of_darkness(scene: &Scene, progress: &dyn Progress) {
    let dark = |light: &Vec3| *light == Vec3::ZERO;
    if scene.lights.iter().all(|light| dark(&light.intensity))
        && dark(&scene.sky)
        && scene.cloud.emission.iter().all(dark)
    {
        progress.note(
            "warning: nothing gives light, so everything will be dark: add --light or --sky, or \
             give points an emission (properties emission_red, emission_green, emission_blue)",
        );
    }
}

/// Share of the light of lamps in sight that is next to nothing.
const NEXT_TO_NOTHING: f64 = 0.02;

/// A lamp outside of a room, or in another coordinate system, lights nothing.
fn warn_of_lost_lamps(scene: &Scene, map: &IlluminationMap, progress: &dyn Progress) {
    let shines = scene
        .lights
        .iter()
        .any(|light| light.intensity != Vec3::ZERO);
    let (true, Some(bounds)) = (shines, scene.bounds()) else {
        return;
    };
    // What leaks through a wall is next to nothing of what a lamp in sight gives.
    let given = |p: &DVec3| {
        let of_lamp = |light: &PointLight| {
            f64::from(light.intensity.element_sum()) / light.position.distance_squared(*p)
        };
        scene.lights.iter().map(of_lamp).sum::<f64>()
    };
    let given: f64 = scene
        .cloud
        .positions
        .iter()
        .map(given)
        .filter(|e| e.is_finite())
        .sum();
    let got: f64 = map
        .irradiance
        .iter()
        .map(|h| f64::from(h.element_sum()))
        .sum();
    if got < NEXT_TO_NOTHING * given {
        let places = scene.lights.iter().map(|light| light.position.to_string());
        progress.note(&format!(
            "warning: the lamps light nothing, at {}: the points lie within {bounds}, and face away or are \
             hidden",
            places.collect::<Vec<_>>().join(", ")
        ));
    }
}

/// The physical checks in a line.
fn told(checks: &Checks) -> String {
    let mut parts = Vec::new();
    if let Some(sum) = checks.row_sum_and_sky {
        parts.push(format!(
            "row sum and sky {:.4}, at worst {:.3}",
            sum.mean, sum.worst
        ));
    }
    if let Some(energy) = checks.energy {
        parts.push(format!("energy {:+.2}%", 100.0 * energy));
    }
    parts.push(format!("reciprocity {:.1e}", checks.reciprocity));
    parts.push(format!("excess {:.1e}", checks.excess));
    parts.push(format!("least {:.1e}", checks.least));
    parts.join(", ")
}

/// What a person wants to know after a solve.
fn summary(stats: &Stats, backend: &str, files: &[&Path]) -> String {
    let seconds = &stats.seconds;
    let mut lines = vec![
        format!(
            "points      {}, of which {} take part in the transport",
            stats.points, stats.surfels
        ),
        format!(
            "method      {}{}, tolerance {}",
            format!("{:?}", stats.method).to_lowercase(),
            stats
                .order
                .map_or(String::new(), |p| format!(" of order {p}")),
            stats.tolerance
        ),
        format!("backend     {backend}"),
        format!(
            "time        {:.2} s (load {:.2}, prepare {:.2}, octree {:.2}, links {:.2}, \
             visibility {:.2}, solve {:.2}, checks {:.2}, verification {:.2}, write {:.2})",
            seconds.total,
            seconds.load,
            seconds.prepare,
            seconds.octree,
            seconds.links,
            seconds.visibility,
            seconds.solve,
            seconds.checks,
            seconds.verification,
            seconds.write
        ),
        format!(
            "solution    {} iterations, residual {:.1e}{}",
            stats.iterations,
            stats.residual,
            if stats.converged {
                ""
            } else {
                ": NOT CONVERGED"
            }
        ),
    ];
    if let Some(rays) = stats.rays {
        lines.push(format!("rays        {rays} from each point"));
    }
    if let Some(error) = &stats.error {
        let met = match error.met {
            true => "",
            false => ": TOLERANCE NOT MET",
        };
        lines.push(format!("error       {error}{met}"));
    }
    if let Some(surface) = &stats.surface_error {
        let met = match surface.bound <= stats.tolerance {
            true => "",
            false => ": TOLERANCE NOT MET",
        };
        lines.push(format!("surface     {surface}{met}"));
    }
    if let Some(model) = stats.model_error {
        let enough = stats.error.map_or(stats.tolerance, |error| error.tolerance);
        let instead = match enough > stats.tolerance {
            true => format!(": refined to a third of that, not to {}", stats.tolerance),
            false => String::new(),
        };
        lines.push(format!(
            "model       so many points are off by {:.1}% or so{instead}",
            100.0 * model
        ));
    }
    if let Some(sum) = stats.row_sum {
        lines.push(format!(
            "row sum     {:.4} at most, {:.4} on average (1 in a closed room)",
            sum.max, sum.mean
        ));
    }
    if let Some(checks) = &stats.checks {
        lines.push(format!("checks      {}", told(checks)));
    }
    if let Some(bytes) = stats.peak_memory_bytes {
        lines.push(format!("memory      {} MB at most", bytes / 1_000_000));
    }
    lines.extend(
        stats
            .repairs
            .iter()
            .map(|what| format!("repaired    {what}")),
    );
    lines.extend(
        files
            .iter()
            .map(|file| format!("written     {}", file.display())),
    );
    lines.join("\n")
}
