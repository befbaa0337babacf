//! `fmmgi-gpu visible`

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use fmmgi_gpu::links::Thresholds;
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::output::{write_atomic, write_painted};
use fmmgi_gpu::passes::gpu::{Gpu, GpuPointVisibility, GpuVisibility};
use fmmgi_gpu::points::{Evidence, Thinning};
use fmmgi_gpu::render::tone::tone_map;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{
    BySegment, CpuPointVisibility, CpuVisibility, Occluders, PointTest, PointVisibility, Seen,
    Visibility,
};
use fmmgi_gpu::{Backend, Error, IlluminationMap, Method, Progress, Result, Scene, Surfels};
use glam::{DVec3, Vec3};

use super::reading::Reading;
use super::terminal::{self, Terminal};
use super::values::{self, Size};
use super::{Done, backend, outputs, picture};

/// Paint what is seen from a point: the cells of the octree, and single points.
///
/// The point nearest to the place becomes cyan, cells that it sees yellow, single points in other
/// cells pale yellow; all others keep their colours, darkened. Without any output only a summary is
/// printed.
#[derive(clap::Args)]
pub struct Args {
    /// Scans, and at most one scene file (.toml)
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Place to look from, in the scan's unit
    #[arg(long, value_name = "X,Y,Z", value_parser = values::place, allow_hyphen_values = true)]
    from: DVec3,
    /// Write the painted points
    #[arg(short, long, value_name = "OUT.ply")]
    output: Option<PathBuf>,
    /// Write a picture
    #[arg(long, value_name = "OUT.png")]
    image: Option<PathBuf>,
    /// Points to make on the shapes of a scene file, and on a mesh
    #[arg(long, value_name = "N")]
    points: Option<NonZeroUsize>,
    #[command(flatten)]
    reading: Reading,
    /// What stands in the way
    #[arg(long, value_enum, default_value = "classic")]
    visibility: VisibilityArg,
    /// Where the work is done
    #[arg(long, value_enum, default_value = "auto")]
    backend: backend::Choice,
    /// GPU to use: its number in "adapters", or a part of its name
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
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

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum VisibilityArg {
    /// The points near the segment and their tangent planes (2.2.4.1 of the report)
    Classic,
    /// The points' pieces of surface, as in "solve"
    Surfels,
}

/// Surfels a leaf: cells of several points across.
const LEAF_SIZE: usize = 32;

// Paints, for a tone curve of this exposure.
const EXPOSURE: f32 = 2.0;
const POINT: Vec3 = Vec3::new(0.0, 1.2, 1.2);
const CELL: Vec3 = Vec3::new(1.0, 0.85, 0.0);
const SINGLE: Vec3 = Vec3::new(1.2, 1.1, 0.4);
const DARKENED: f32 = 0.07;
/// The point is drawn so many times as large as it is.
const POINT_SIZE: f32 = 3.0;

pub fn run(args: &Args) -> Result<Done> {
    let files: Vec<&Path> = [&args.output, &args.image]
        .into_iter()
        .filter_map(Option::as_deref)
        .collect();
    outputs::check(&args.inputs, &files)?;
    if let Some(path) = &args.output {
        outputs::check_ply(path)?;
    }
    args.image.as_deref().map(outputs::check_png).transpose()?;
    let chosen = backend::choose(args.backend, args.adapter.as_deref(), Method::Fmm)?;
    terminal::stop_on_ctrl_c();
    let progress = Terminal::new(args.quiet, args.verbose);
    let options = SceneOptions {
        points: args.points.map(NonZeroUsize::get),
        seed: args.seed,
        ..args.reading.options()
    };
    let scene = Scene::load_all(&args.inputs, &options, &progress)?;
    for source in &scene.sources {
        outputs::spare(&source.path, &files)?;
    }
    progress.note(&format!("backend: {}", chosen.describe()));

    let about = |error: Error| error.about(outputs::names(&args.inputs));
    let (evidence, thinning) = (Evidence::default(), Thinning::default());
    let prepared =
        Surfels::of_scan(&scene.cloud, &evidence, &thinning, &progress).map_err(about)?;
    let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
    let from = nearest(&surfels, args.from);
    let seen = see(args, &octree, &surfels, from, &chosen.backend(), &progress).map_err(about)?;

    let places = prepared.places(&surfels);
    let paints = paints(&octree, &surfels, from, &seen);
    let surfel_of = |i: usize| places[i].map(|k| k as usize);
    let paint: Vec<Vec3> = (0..scene.cloud.len())
        .map(|i| surfel_of(i).map_or(scene.cloud.reflectance[i] * DARKENED, |k| paints[k]))
        .collect();
    let png = match args.image {
        None => None,
        Some(_) => {
            let radius = |k: usize| {
                let size = if k as u32 == from { POINT_SIZE } else { 1.0 };
                size * (surfels.areas[k] / std::f32::consts::PI).sqrt()
            };
            let map = IlluminationMap {
                radius: (0..scene.cloud.len())
                    .map(|i| surfel_of(i).map_or(0.0, radius))
                    .collect(),
                radiosity: paint.clone(),
                ..IlluminationMap::default()
            };
            Some(picture::take(
                &scene, &surfels, &map, args.size, EXPOSURE, &progress,
            )?)
        }
    };
    progress.check()?;
    progress.finish();

    if let Some(path) = &args.output {
        let colours: Vec<[u8; 3]> = paint.iter().map(|&p| tone_map(p, EXPOSURE)).collect();
        let visible: Vec<bool> = (0..scene.cloud.len())
            .map(|i| surfel_of(i).is_some_and(|k| seen.surfels[k]))
            .collect();
        write_painted(path, &scene.cloud, &colours, "scalar_visible", &visible)?;
    }
    if let (Some(path), Some(png)) = (&args.image, png) {
        write_atomic(path, |writer| writer.write_all(&png))?;
    }
    if !args.quiet {
        let place = surfels.positions[from as usize].as_dvec3() + surfels.origin;
        // Rounded here, and without the sign of a zero.
        let normal = (surfels.normals[from as usize] * 1e3).round() / 1e3 + Vec3::ZERO;
        let mut lines = vec![
            format!(
                "from        {place:.6}, normal {normal}, {:.6} from the place given",
                place.distance(args.from)
            ),
            format!("backend     {}", chosen.describe()),
            format!("points      {} visible", share(seen.surfels.iter())),
            format!(
                "cells       {} visible",
                share(seen.leaves.iter().map(|(_, seen)| seen))
            ),
        ];
        lines.extend(
            prepared
                .repairs
                .iter()
                .map(|what| format!("repaired    {what}")),
        );
        lines.extend(
            files
                .iter()
                .map(|file| format!("written     {}", file.display())),
        );
        super::print(&lines.join("\n"))?;
    }
    Ok(Done::Well)
}

/// For example "5 of 10 (50.0%)".
fn share<'a>(of: impl ExactSizeIterator<Item = &'a bool>) -> String {
    let all = of.len();
    let visible = of.filter(|&&visible| visible).count();
    let percent = 100.0 * visible as f64 / all.max(1) as f64;
    format!("{visible} of {all} ({percent:.1}%)")
}

/// The surfel nearest to a place.
fn nearest(surfels: &Surfels, place: DVec3) -> u32 {
    let place = place - surfels.origin;
    let distance = |i: &u32| {
        let position = surfels.positions[*i as usize].as_dvec3();
        position.distance_squared(place)
    };
    (0..surfels.len() as u32)
        .min_by(|i, j| distance(i).total_cmp(&distance(j)))
        .unwrap_or(0)
}

fn see(
    args: &Args,
    octree: &Octree,
    surfels: &Surfels,
    from: u32,
    backend: &Backend,
    progress: &dyn Progress,
) -> Result<Seen> {
    let gpu = match *backend {
        Backend::Cpu => None,
        Backend::Gpu { device, queue, .. } => Some(Gpu::new(device, queue)),
    };
    let part = Thresholds::default().point_leaf;
    let see = |by: &dyn PointVisibility| Seen::from(octree, from, part, by, progress);
    let test = PointTest::default();
    match (args.visibility, gpu) {
        (VisibilityArg::Classic, None) => see(&CpuPointVisibility::<f32>::new(surfels, test)),
        (VisibilityArg::Classic, Some(gpu)) => see(&GpuPointVisibility::new(&gpu, surfels, test)?),
        (VisibilityArg::Surfels, gpu) => {
            let occluders = Occluders::build(surfels);
            let visibility: Box<dyn Visibility> = match gpu {
                None => Box::new(CpuVisibility::<f32>::new(&occluders)),
                Some(gpu) => Box::new(GpuVisibility::new(&gpu, &occluders)?),
            };
            see(&BySegment {
                surfels,
                visibility: visibility.as_ref(),
            })
        }
    }
}

/// A paint a surfel.
fn paints(octree: &Octree, surfels: &Surfels, from: u32, seen: &Seen) -> Vec<Vec3> {
    let mut paints: Vec<Vec3> = surfels.reflectance.iter().map(|r| r * DARKENED).collect();
    for (k, &(leaf, is_seen)) in seen.leaves.iter().enumerate() {
        // Neighbouring cells differ a little.
        let shade = 0.35 + 0.65 * (0.618 * k as f32).fract();
        for i in octree.facets[leaf].surfels() {
            match (is_seen, seen.surfels[i]) {
                (true, _) => paints[i] = CELL * shade,
                (false, true) => paints[i] = SINGLE,
                (false, false) => {}
            }
        }
    }
    paints[from as usize] = POINT;
    paints
}
