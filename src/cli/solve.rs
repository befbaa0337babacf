//! `fmmgi-gpu solve`

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::ValueEnum;
use fmmgi_gpu::illuminate::{RAYS, checks::Checks};
use fmmgi_gpu::output::{self, Format, write_atomic, write_stats};
use fmmgi_gpu::points::{Facing, Thinning};
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::{
    Error, Method, Occlusion, Options, Progress, Result, Scene, Stats, Transport, memory, render,
};
use glam::{DVec3, Vec3};

use super::terminal::{self, Terminal};
use super::values::{self, Size};
use super::{Done, backend, outputs, picture};

/// Compute the light at every point of a scan or a scene.
///
/// Lengths are in the scan's unit, light is linear RGB. Without any output only a summary is
/// printed.
#[derive(clap::Args)]
pub struct Args {
    /// Scans, and at most one scene file (.toml)
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Write the points with their light: .ply, .laz, .las, .csv or .npy
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
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
    /// Points to make on the shapes of a scene file, and on a mesh
    #[arg(long, value_name = "N")]
    points: Option<NonZeroUsize>,
    /// Take the faces of PLY files as the surface, and make points on them
    #[arg(long)]
    mesh: bool,
    /// How the light is summed up
    #[arg(long, value_enum, default_value = "auto")]
    method: MethodArg,
    /// Where the work is done
    #[arg(long, value_enum, default_value = "auto")]
    backend: backend::Choice,
    /// GPU to use: its number in "adapters", or a part of its name
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
    /// Relative error to aim at, 1e-6 to 0.5 [default: the scene's, or 0.03]
    #[arg(long, value_name = "T", value_parser = values::tolerance, allow_hyphen_values = true)]
    tolerance: Option<f64>,
    /// Largest order of the expansions, up to 12, on a GPU to 6 [default: 1, without occlusion and
    /// for classic 2 to 6 as the tolerance needs]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u8).range(0..=12))]
    order: Option<u8>,
    /// Rays from each point with --method gather, rounded up to a power of two [default: as many as the
    /// tolerance needs]
    #[arg(long, value_name = "N", value_parser = rays())]
    rays: Option<u32>,
    /// What stands in the way of light
    #[arg(long, value_enum, default_value = "surfels")]
    visibility: VisibilityArg,
    /// Bounces to follow; 0 is direct light alone [default: until nothing changes]
    #[arg(long, value_name = "N")]
    max_bounces: Option<u32>,
    /// Refine even where the points themselves allow no such accuracy
    #[arg(long)]
    below_model: bool,
    /// Threads to use [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Add a point light with a radiant intensity (1,1,1 if left out); can be given several times
    #[arg(long, value_name = "point:X,Y,Z[:R,G,B]", value_parser = values::light)]
    pub light: Vec<PointLight>,
    /// Irradiance that an open plane gets from a uniform sky, instead of the scene's
    #[arg(long, value_name = "R,G,B", value_parser = values::rgb, allow_hyphen_values = true)]
    sky: Option<Vec3>,
    /// To which side the normals point that a scan lacks: auto, inward (a room), outward (an object),
    /// or viewpoint:X,Y,Z from where all was seen
    #[arg(long, value_name = "SIDE", value_parser = values::facing, default_value = "auto")]
    normals: Facing,
    /// Thin out to this distance between points; those left out take the light of the others
    #[arg(long, value_name = "S", value_parser = values::positive)]
    spacing: Option<f64>,
    /// Thin out evenly to no more than this many points
    #[arg(long, value_name = "N")]
    max_points: Option<NonZeroUsize>,
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
enum MethodArg {
    /// Exact sum over all pairs, for small clouds
    Direct,
    /// Fast multipole method
    Fmm,
    /// Multipole method with the visibility of Goradia's report, which tests all pairs of points
    Classic,
    /// Monte Carlo: rays from every point
    Gather,
    /// What is cheaper
    Auto,
}

#[derive(Clone, Copy, ValueEnum)]
enum VisibilityArg {
    /// The points' pieces of surface
    Surfels,
    /// Nothing
    None,
}

pub fn run(args: &Args) -> Result<Done> {
    run_with(args, |scene| scene.lights.extend(&args.light))
}

/// The same, where `hang` says which point lights there are.
pub fn run_with(args: &Args, hang: impl FnOnce(&mut Scene)) -> Result<Done> {
    let began = Instant::now();
    let results = [&args.output, &args.image, &args.stats];
    let files: Vec<&Path> = (results.into_iter().chain([&args.save_operator]))
        .filter_map(Option::as_deref)
        .collect();
    outputs::check(&args.inputs, &files)?;
    args.output.as_deref().map(Format::of).transpose()?;
    if let Some(operator) = &args.operator {
        // A kept operator may be replaced by itself, refined.
        let results: Vec<&Path> = results.into_iter().filter_map(Option::as_deref).collect();
        outputs::spare(operator, &results)?;
    }
    let options = args.options();
    if args.save_operator.is_some() || args.operator.is_some() {
        options.check_keeping()?;
    }
    let chosen = backend::choose(args.backend, args.adapter.as_deref(), options.method)?;
    if let Some(threads) = args.threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads.into())
            .build_global()
            .map_err(|e| Error::TooLarge(format!("{threads} threads: {e}")))?;
    }
    terminal::stop_on_ctrl_c();
    let progress = Terminal::new(args.quiet, args.verbose);

    let options_of_scene = SceneOptions {
        points: args.points.map(NonZeroUsize::get),
        seed: args.seed,
        mesh: args.mesh,
    };
    let mut scene = Scene::load_all(&args.inputs, &options_of_scene, &progress)?;
    for source in &scene.sources {
        outputs::spare(&source.path, &files)?;
    }
    hang(&mut scene);
    scene.sky = args.sky.unwrap_or(scene.sky);
    let load = began.elapsed().as_secs_f64();
    let clock = Instant::now();
    let lamps: Vec<DVec3> = scene.lights.iter().map(|light| light.position).collect();
    scene
        .cloud
        .estimate_normals(&args.normals, &lamps, &progress)
        .map_err(|error| error.about(outputs::names(&args.inputs)))?;
    let normals = clock.elapsed().as_secs_f64();
    warn_of_darkness(&scene, &progress);
    progress.note(&format!("backend: {}", chosen.describe()));

    let about = |error: Error| error.about(outputs::names(&args.inputs));
    let mut transport = match &args.operator {
        None => Transport::new(&scene, &options, chosen.backend(), &progress).map_err(about)?,
        Some(path) => Transport::load(path, &scene, &options, chosen.backend(), &progress)?,
    };
    let mut result = transport.illuminate(&scene, &progress).map_err(about)?;
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
        output::write(path, &scene.cloud, &result.map)?;
    }
    if let (Some(path), Some(png)) = (&args.image, png) {
        write_atomic(path, |writer| writer.write_all(&png))?;
    }
    if let Some((path, transport)) = &kept {
        transport.save(path)?;
    }
    let stats = &mut result.stats;
    stats.seconds.load = load;
    stats.seconds.prepare += normals;
    stats.seconds.write = written.elapsed().as_secs_f64();
    stats.seconds.total = began.elapsed().as_secs_f64();
    stats.peak_memory_bytes = memory::peak_bytes();
    if let Some(path) = &args.stats {
        write_stats(path, stats)?;
    }
    if !args.quiet {
        super::print(&summary(stats, &chosen.describe(), &files))?;
    }
    Ok(if stats.converged && stats.met() {
        Done::Well
    } else {
        Done::NotConverged
    })
}

/// As many as a surfel can cast.
fn rays() -> clap::builder::RangedI64ValueParser<u32> {
    let [least, most] = [RAYS.start(), RAYS.end()].map(|&n| i64::from(n));
    clap::value_parser!(u32).range(least..=most)
}

impl Args {
    fn options(&self) -> Options {
        Options {
            method: match self.method {
                MethodArg::Direct => Method::Direct,
                MethodArg::Fmm => Method::Fmm,
                MethodArg::Classic => Method::Classic,
                MethodArg::Gather => Method::Gather,
                // What is kept are links, however few points there are.
                MethodArg::Auto if self.save_operator.is_some() => Method::Fmm,
                MethodArg::Auto => Method::Auto,
            },
            occlusion: match self.visibility {
                VisibilityArg::Surfels => Occlusion::Surfels,
                VisibilityArg::None => Occlusion::None,
            },
            tolerance: self.tolerance,
            order: self.order.map(usize::from),
            max_bounces: self.max_bounces,
            below_model: self.below_model,
            rays: self.rays,
            seed: self.seed,
            thinning: Thinning {
                spacing: self.spacing,
                max_points: self.max_points.map(NonZeroUsize::get),
            },
        }
    }
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
        let met = match stats.met() {
            true => "",
            false => ": TOLERANCE NOT MET",
        };
        lines.push(format!("error       {error}{met}"));
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
