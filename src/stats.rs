//! What a solve took and how well it went.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::illuminate::Method;

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
