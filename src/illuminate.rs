//! The main job: scene in, illumination map and what it took out.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::error::Result;
use crate::map::IlluminationMap;
use crate::progress::Progress;
use crate::scene::Scene;

/// How the transport operator is applied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Exact sum over all pairs of surfels, in f64 on the CPU: the truth, for small clouds.
    Direct,
    /// Links between facets, expansions, tested visibility.
    Fmm,
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
#[derive(Clone, Debug)]
pub struct Options {
    pub method: Method,
    pub occlusion: Occlusion,
    /// Relative error asked for; `None` takes the scene's, or 0.03.
    pub tolerance: Option<f64>,
    /// Bounces to follow; `None` goes on until the solution stands.
    pub max_bounces: Option<u32>,
    pub seed: u64,
}

/// Seconds spent, by stage.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Reading or generating the points.
    pub load: f64,
    /// Neighbours, cells, duplicates.
    pub prepare: f64,
    pub octree: f64,
    /// Finding links, without their segments.
    pub links: f64,
    /// Testing segments, for links and lights.
    pub visibility: f64,
    /// Applying the operator until convergence.
    pub solve: f64,
    pub write: f64,
    pub total: f64,
}

/// Row sums of the operator before any clamp: at most 1 for a true form-factor matrix.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct RowSum {
    pub max: f64,
    pub mean: f64,
}

/// What a solve took and how well it went: the content of `--stats`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Stats {
    /// Points of the cloud.
    pub points: usize,
    /// Points that take part in the transport.
    pub surfels: usize,
    pub method: Method,
    /// "cpu" or "gpu".
    pub backend: String,
    /// Name of the GPU adapter, if one was used.
    pub adapter: Option<String>,
    pub tolerance: f64,
    /// Applications of the operator by the solver.
    pub iterations: u32,
    /// Relative L2 residual of the radiosity equation at the end.
    pub residual: f64,
    pub converged: bool,
    pub seconds: Seconds,
    /// Number of links by kind.
    pub links: BTreeMap<String, u64>,
    /// Segments tested for visibility.
    pub segments: u64,
    pub peak_memory_bytes: Option<u64>,
    pub row_sum: RowSum,
    /// What was repaired or left out, in words with counts.
    pub repairs: Vec<String>,
}

/// The map and what it took.
#[derive(Clone, Debug, Default)]
pub struct Illumination {
    pub map: IlluminationMap,
    pub stats: Stats,
}

/// Where the passes run.
pub enum Backend<'a> {
    /// f32 on all threads of the current rayon pool.
    Cpu,
    /// WGSL on a device that the caller made.
    Gpu {
        device: &'a wgpu::Device,
        queue: &'a wgpu::Queue,
        adapter: &'a str,
    },
}

/// Computes the illumination map of a scene.
pub fn illuminate(
    _scene: &Scene,
    _options: &Options,
    _backend: Backend,
    _progress: &dyn Progress,
) -> Result<Illumination> {
    todo!()
}
