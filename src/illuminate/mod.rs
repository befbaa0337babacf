//! The main job: scene in, illumination map and what it took out.

pub mod checks;
mod even;
mod rays;
pub mod stats;
mod task;
mod work;

use std::time::Instant;

use glam::{DVec3, Vec3};
use serde::Serialize;

pub use self::rays::RAYS;
use self::stats::{Seconds, Stats};
use self::task::Task;
use self::work::Work;
use crate::error::{Error, Result};
use crate::links::{self, Links, Thresholds};
use crate::map::IlluminationMap;
use crate::octree::{LEAF_SIZE, Octree};
use crate::operator::{Fmm, GpuFmm};
use crate::passes::gpu::{self, Gpu, GpuPointVisibility, GpuVisibility};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::scene::{BRIGHTEST, LARGEST, Scene, TOLERANCES};
use crate::visibility::{
    Counted, CpuPointVisibility, CpuVisibility, NothingInTheWay, Occluders, PointVisibility,
    Visibility,
};

/// How the transport operator is applied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Exact sum over all pairs of surfels, in f64 on the CPU: the truth, for small clouds.
    Direct,
    /// Links between facets, expansions, tested visibility.
    Fmm,
    /// The adaptive lists and the hierarchical visibility of Goradia's report: tests all pairs.
    Classic,
    /// Rays from every surfel, whose hits are kept for all bounces. Surfels are as large as their
    /// cells: areas given in the file do not count. The rays are cast on the CPU on every backend.
    Gather,
    /// `Direct` where that is cheaper, otherwise `Fmm`.
    #[default]
    Auto,
}

/// What stands in the way of light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Occlusion {
    /// The cells of the surfels.
    #[default]
    Surfels,
    /// Nothing.
    None,
}

/// What is asked for.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// How the operator is applied.
    pub method: Method,
    /// What blocks light.
    pub occlusion: Occlusion,
    /// Relative error asked for; `None` takes the scene's, or 0.03.
    pub tolerance: Option<f64>,
    /// Largest order of the expansions; `None` takes 1, and without occlusion or by the classic method
    /// what the tolerance needs.
    pub order: Option<usize>,
    /// Bounces to follow; `None` goes on until the solution stands.
    pub max_bounces: Option<u32>,
    /// Rays from each surfel with the method `Gather`, rounded up to a power of two; `None` casts as
    /// many as the tolerance needs.
    pub rays: Option<u32>,
    /// Seed of all samples: the same seed gives the same bits.
    pub seed: u64,
}

/// The map and what it took.
#[derive(Clone, Debug, Default)]
pub struct Illumination {
    /// Light at every point.
    pub map: IlluminationMap,
    /// The surfels that the points stood for, in the order of the octree.
    pub surfels: Surfels,
    /// What it took and how well it went.
    pub stats: Stats,
}

/// Where the passes run.
pub enum Backend<'a> {
    /// f32 on all threads of the current rayon pool.
    Cpu,
    /// WGSL on a device that the caller made.
    Gpu {
        /// Large clouds need the buffer limits (`max_buffer_size` and
        /// `max_storage_buffer_binding_size`) that the adapter offers, not the default ones.
        device: &'a wgpu::Device,
        /// The device's queue.
        queue: &'a wgpu::Queue,
        /// Its name, for the stats.
        adapter: &'a str,
    },
}

/// Clouds up to this size are summed up directly when the method is left open: finding links
/// would cost more segments than testing all pairs.
const DIRECT_UP_TO: usize = 1000;

/// Default of [`Options::tolerance`].
pub const DEFAULT_TOLERANCE: f64 = 0.03;

/// Computes the illumination map of a scene.
pub fn illuminate(
    scene: &Scene,
    options: &Options,
    backend: Backend,
    progress: &dyn Progress,
) -> Result<Illumination> {
    let tolerance = options
        .tolerance
        .or(scene.tolerance)
        .unwrap_or(DEFAULT_TOLERANCE);
    check(scene, tolerance)?;
    check_options(options, &backend)?;
    let mut clock = Clock::start();
    let prepared = Surfels::prepare(&scene.cloud, progress)?;
    let prepare = clock.lap();
    progress.stage("octree", 1);
    let (order, leaf_size) = expansions(options, tolerance, prepared.surfels.len(), &backend)?;
    let (octree, surfels) = Octree::build(&prepared.surfels, leaf_size);
    let occluders = match options.occlusion {
        Occlusion::Surfels => Some(Occluders::build(&surfels)),
        Occlusion::None => None,
    };
    let octree_seconds = clock.lap();

    let method = choose(options, &backend, surfels.len());
    let device = match &backend {
        Backend::Cpu => None,
        Backend::Gpu { device, queue, .. } => Some(Gpu::new(device, queue)),
    };
    let tester = tester(occluders.as_ref(), method, device.as_ref())?;
    let visibility = Counted::new(tester.as_ref());
    let task = Task {
        scene,
        surfels: &surfels,
        octree: &octree,
        visibility: &visibility,
        tolerance,
        order,
        max_bounces: options.max_bounces,
        seed: options.seed,
        progress,
    };
    let mut repairs = prepared.repairs.clone();
    let solve = |links: &Links, work: &Work| match &device {
        None => work.solve(&Fmm::<f32>::new(&surfels, &octree, links), progress),
        Some(gpu) => work.solve(&GpuFmm::new(gpu, &surfels, &octree, links)?, progress),
    };
    let whole = |links: &Links, repairs: &mut Vec<String>| match &device {
        None => task.by_operator(&Fmm::<f32>::new(&surfels, &octree, links), repairs),
        Some(gpu) => task.by_operator(&GpuFmm::new(gpu, &surfels, &octree, links)?, repairs),
    };
    let solved = match (method, &occluders) {
        (Method::Direct, _) => task.direct(&mut repairs)?,
        (Method::Classic, _) => {
            let test = Thresholds::default().point;
            let points: Box<dyn PointVisibility> = match &device {
                None => Box::new(CpuPointVisibility::<f32>::new(&surfels, test)),
                Some(gpu) => Box::new(GpuPointVisibility::new(gpu, &surfels, test)?),
            };
            task.classic(points.as_ref(), |links| whole(links, &mut repairs))?
        }
        (Method::Gather, Some(occluders)) => {
            task.gather(occluders, options.rays, &mut repairs, &solve)?
        }
        _ => task.fmm(&mut repairs, &solve)?,
    };
    let casting = solved.rays.map_or(0.0, |rays| rays.seconds);
    let tests = visibility.seconds() + solved.tests + casting;
    let checks = solved.checked.map_or(0.0, |c| c.seconds);
    let rest = clock.lap();
    let map = IlluminationMap::new(&scene.cloud, &prepared, &surfels, &solved.irradiance);
    let (name, adapter) = match backend {
        Backend::Cpu => ("cpu", None),
        Backend::Gpu { adapter, .. } => ("gpu", Some(adapter.to_owned())),
    };
    Ok(Illumination {
        map,
        stats: Stats {
            points: scene.cloud.len(),
            surfels: surfels.len(),
            method,
            backend: name.into(),
            adapter,
            tolerance,
            order: matches!(method, Method::Fmm | Method::Classic).then_some(order),
            iterations: solved.ended.iterations,
            residual: solved.ended.residual,
            converged: solved.ended.converged,
            seconds: Seconds {
                prepare,
                octree: octree_seconds,
                visibility: tests,
                solve: solved.seconds - checks,
                checks,
                links: (rest - tests - solved.seconds).max(0.0),
                ..Seconds::default()
            },
            links: solved.links,
            rays: solved.rays.map(|rays| rays.count),
            standard_error: solved.rays.map(|rays| rays.standard_error),
            segments: visibility.segments(),
            peak_memory_bytes: None,
            row_sum: solved.checked.map(|c| c.row_sum),
            checks: solved.checked.map(|c| c.checks),
            repairs,
        },
        surfels,
    })
}

/// Order of the expansions of links whose visibility is sampled: that is what limits their accuracy.
const ORDER: usize = 1;
/// Highest order on the CPU. In f32 rounding leaves nothing to gain beyond.
const MAX_ORDER: usize = 12;

/// Largest order of the expansions, and the size of the leaves for it.
fn expansions(
    options: &Options,
    tolerance: f64,
    surfels: usize,
    backend: &Backend,
) -> Result<(usize, usize)> {
    let open = options.occlusion == Occlusion::None;
    let classic = options.method == Method::Classic;
    let order = options.order.unwrap_or(match open || classic {
        true => links::open::order(tolerance),
        false => ORDER,
    });
    let (most, place) = match backend {
        Backend::Cpu => (MAX_ORDER, "on the CPU"),
        Backend::Gpu { .. } => (gpu::MAX_ORDER, "on a GPU"),
    };
    if order > most {
        return Err(Error::Usage(format!(
            "order {order}: expansions {place} have orders up to {most}"
        )));
    }
    let leaf_size = match (open, classic) {
        (true, _) => links::open::leaf_size(order, surfels),
        (false, true) => links::CLASSIC_LEAF_SIZE,
        (false, false) => LEAF_SIZE,
    };
    Ok((order, leaf_size))
}

/// Refuses what the method cannot do, or would ignore.
fn check_options(options: &Options, backend: &Backend) -> Result<()> {
    let usage = |what: String| Err(Error::Usage(what));
    let method = options.method;
    if method == Method::Gather && options.occlusion == Occlusion::None {
        return usage(
            "the gather method follows rays to the surface that they meet, which is in the way of \
             all behind it: without occlusion use another method"
                .into(),
        );
    }
    if options.rays.is_some() && method != Method::Gather {
        return usage("rays belong to the gather method: use --method gather".into());
    }
    if options.rays.is_some_and(|n| !RAYS.contains(&n)) {
        return usage(format!(
            "a surfel casts from {} to {} rays",
            RAYS.start(),
            RAYS.end()
        ));
    }
    if options.order.is_some() && matches!(method, Method::Gather | Method::Direct) {
        return usage(
            "an order belongs to expansions: the methods direct and gather have none".into(),
        );
    }
    match (method, backend) {
        (Method::Direct, Backend::Gpu { .. }) => usage(
            "the direct method is the reference in f64 and runs on the CPU only: use --backend \
             cpu, or --method fmm"
                .into(),
        ),
        _ => Ok(()),
    }
}

/// The method that is taken. Who asks for an order wants expansions.
fn choose(options: &Options, backend: &Backend, surfels: usize) -> Method {
    let few = surfels <= DIRECT_UP_TO && options.order.is_none();
    match (options.method, backend) {
        (Method::Auto, Backend::Cpu) if few => Method::Direct,
        (Method::Auto, _) => Method::Fmm,
        (chosen, _) => chosen,
    }
}

/// What tests segments: f64 for the reference, f32 or the device for the product.
fn tester<'a>(
    occluders: Option<&'a Occluders>,
    method: Method,
    device: Option<&Gpu>,
) -> Result<Box<dyn Visibility + 'a>> {
    Ok(match (occluders, method, device) {
        (None, ..) => Box::new(NothingInTheWay),
        (Some(occluders), Method::Direct, _) => Box::new(CpuVisibility::<f64>::new(occluders)),
        (Some(occluders), _, None) => Box::new(CpuVisibility::<f32>::new(occluders)),
        (Some(occluders), _, Some(gpu)) => Box::new(GpuVisibility::new(gpu, occluders)?),
    })
}

/// Numbers that no light can have.
fn check(scene: &Scene, tolerance: f64) -> Result<()> {
    let invalid = |what: String| Err(Error::Invalid(what));
    if !TOLERANCES.contains(&tolerance) {
        return invalid(format!(
            "tolerance {tolerance}: must lie between {} and {}",
            TOLERANCES.start(),
            TOLERANCES.end()
        ));
    }
    let shines = |rgb: Vec3| rgb.cmpge(Vec3::ZERO).all() && rgb.cmple(Vec3::splat(BRIGHTEST)).all();
    for (k, light) in scene.lights.iter().enumerate() {
        if !(light.position.abs().cmple(DVec3::splat(LARGEST)).all() && shines(light.intensity)) {
            return invalid(format!(
                "light {k} at {} with intensity {}: numbers must be finite, intensities not \
                 negative",
                light.position, light.intensity
            ));
        }
    }
    if !shines(scene.sky) {
        return invalid(format!(
            "sky {}: must be finite and not negative",
            scene.sky
        ));
    }
    Ok(())
}

/// A stop watch with laps.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Clock(Instant::now())
    }

    /// Seconds since the start or the last lap.
    fn lap(&mut self) -> f64 {
        let seconds = self.0.elapsed().as_secs_f64();
        self.0 = Instant::now();
        seconds
    }
}
