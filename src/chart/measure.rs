//! One solve, measured.

use std::path::{Path, PathBuf};

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::truth::Errors;
use super::usage::{Clock, median};
use crate::error::Result;
use crate::passes::gpu::adapter::OpenDevice;
use crate::progress::Silent;
use crate::scene::SceneOptions;
use crate::{Backend, Method, Options, Scene, illuminate, memory};

/// Runs of one case, at most.
const RUNS: usize = 3;
/// Seconds after which a case is not run again.
const ENOUGH: f64 = 1.0;
/// Seed of the points of scenes.
const SEED: u64 = 1;

/// A scene and how it is solved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// Its file.
    pub scene: PathBuf,
    /// Points asked for.
    pub points: usize,
    pub method: Method,
    /// On the adapter, or on the CPU.
    pub gpu: bool,
    pub tolerance: f64,
    /// Of the expansions; `None` leaves it to the method.
    pub order: Option<usize>,
    /// From each surfel, with the method gather.
    pub rays: Option<u32>,
}

/// What the solve of a case took and told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Surfels that took part.
    pub surfels: usize,
    /// The method that was taken, and its order, if it has one.
    pub method: Method,
    pub order: Option<usize>,
    /// Runs of which the times are medians.
    pub runs: usize,
    /// From points to verified light: on the wall, and of all threads together.
    pub seconds: f64,
    pub cpu_seconds: f64,
    /// Largest memory of the process after the first run, over that before the scene was read.
    pub memory_bytes: Option<u64>,
    /// Applications of the operator.
    pub iterations: u32,
    /// Segments tested.
    pub segments: u64,
    /// Whether the solve says that it converged, and that its error is within the tolerance.
    pub kept: bool,
}

/// A finished case, with its errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solve {
    pub case: Case,
    pub measured: Measured,
    /// Against exact sums over the same points.
    pub point: Errors,
    /// Against the true surface, where it is known.
    pub surface: Option<Errors>,
}

impl Case {
    /// Name of the scene.
    pub fn name(&self) -> String {
        name_of(&self.scene)
    }

    /// For example "fmm, gpu".
    pub fn curve(&self) -> String {
        let order = match (self.method, self.order) {
            (Method::Fmm, Some(order)) => format!(" of order {order}"),
            _ => String::new(),
        };
        let backend = if self.gpu { "gpu" } else { "cpu" };
        format!("{}{order}, {backend}", word(self.method))
    }

    /// For example "cornell, 2000 points: gather, cpu, 64 rays".
    pub fn describe(&self) -> String {
        let setting = match (self.rays, self.order) {
            (Some(rays), _) => format!("{rays} rays"),
            (None, Some(order)) if self.method == Method::Classic => format!("order {order}"),
            _ => format!("tolerance {}", self.tolerance),
        };
        format!(
            "{}, {} points: {}, {setting}",
            self.name(),
            self.points,
            self.curve()
        )
    }

    fn options(&self) -> Options {
        Options {
            method: self.method,
            tolerance: Some(self.tolerance),
            order: self.order,
            rays: self.rays,
            below_model: true,
            ..Options::default()
        }
    }
}

/// Name of a scene by its file.
pub fn name_of(scene: &Path) -> String {
    scene
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// As the command line has it.
pub fn word(method: Method) -> &'static str {
    match method {
        Method::Direct => "direct",
        Method::Fmm => "fmm",
        Method::Classic => "classic",
        Method::Gather => "gather",
        Method::Auto => "auto",
    }
}

/// The scene with about this many points.
pub fn load(scene: &Path, points: usize) -> Result<Scene> {
    let options = SceneOptions {
        points: Some(points),
        seed: SEED,
        ..SceneOptions::default()
    };
    Scene::load(scene, &options, &Silent)
}

/// Solves a case in this process; also returns the irradiance of the points.
///
/// What memory it takes can be told once in a process.
pub fn measure(case: &Case, gpu: Option<&OpenDevice>) -> Result<(Measured, Vec<Vec3>)> {
    let idle = memory::peak_bytes();
    let scene = load(&case.scene, case.points)?;
    let backend = || match gpu {
        Some(gpu) => Backend::Gpu {
            device: &gpu.device,
            queue: &gpu.queue,
            adapter: &gpu.info.name,
        },
        None => Backend::Cpu,
    };
    let [mut walls, mut cpus] = [Vec::new(), Vec::new()];
    let mut first = None;
    let all = Clock::start();
    while walls.len() < RUNS && (walls.is_empty() || all.spent().wall < ENOUGH) {
        let clock = Clock::start();
        let lit = illuminate(&scene, &case.options(), backend(), &Silent)?;
        let spent = clock.spent();
        walls.push(spent.wall);
        cpus.push(spent.cpu);
        first.get_or_insert_with(|| (lit, memory::peak_bytes()));
    }
    let (lit, peak) = first.expect("there is a first run");
    let stats = lit.stats;
    let measured = Measured {
        surfels: stats.surfels,
        method: stats.method,
        order: stats.order,
        runs: walls.len(),
        seconds: median(&walls),
        cpu_seconds: median(&cpus),
        memory_bytes: peak.zip(idle).map(|(peak, idle)| peak - idle),
        iterations: stats.iterations,
        segments: stats.segments,
        kept: stats.converged && stats.met(),
    };
    Ok((measured, lit.map.irradiance))
}
