//! What a solve took and how well it went.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Method;
use super::SurfaceError;
use super::checks::Checks;
use super::holes::HoleShares;
use super::verified::Verified;
use crate::plan::Plan;

/// Seconds spent, by stage.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Reading or generating the points.
    pub load: f64,
    /// Neighbours, cells, duplicates.
    pub prepare: f64,
    /// Sorting the surfels into facets, and their cells for tests.
    pub octree: f64,
    /// Finding links, without their segments.
    pub links: f64,
    /// Testing segments, for links and lights, and casting rays.
    pub visibility: f64,
    /// Applying the operator until convergence.
    pub solve: f64,
    /// Checking the operator.
    pub checks: f64,
    /// Measuring the error, with its segments.
    pub verification: f64,
    /// Writing the files.
    pub write: f64,
    /// From start to end.
    pub total: f64,
}

/// Row sums of the operator before any clamp: at most 1 for a true form-factor matrix.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct RowSum {
    /// Largest of all surfels.
    pub max: f64,
    /// Mean of all surfels.
    pub mean: f64,
}

/// Row sums on average above which there is more surface than can be seen.
const CROWDED: f64 = 1.1;

impl RowSum {
    /// Whether there is more around surfels than can be: layers of points, or areas that count twice.
    pub fn is_crowded(&self) -> bool {
        self.mean > CROWDED
    }
}

/// What a solve took and how well it went: the content of `--stats`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Stats {
    /// Points of the cloud.
    pub points: usize,
    /// Points that take part in the transport.
    pub surfels: usize,
    /// The method that was used, never `Auto`.
    pub method: Method,
    /// "cpu" or "gpu".
    pub backend: String,
    /// Name of the GPU adapter, if one was used.
    pub adapter: Option<String>,
    /// Relative error that was asked for.
    pub tolerance: f64,
    /// Largest order of the expansions, if there are any.
    pub order: Option<usize>,
    /// Applications of the operator by the solver.
    pub iterations: u32,
    /// Relative L2 residual of the radiosity equation at the end.
    pub residual: f64,
    /// Whether the residual is as small as the tolerance needs.
    pub converged: bool,
    /// Time by stage.
    pub seconds: Seconds,
    /// Number of links by kind.
    pub links: BTreeMap<String, u64>,
    /// Rays cast from each surfel, if any.
    pub rays: Option<u32>,
    /// Segments tested for visibility.
    pub segments: u64,
    /// Most memory of the process, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// Directions that lead through holes of a fitted surface.
    pub holes: Option<HoleShares>,
    /// The part of its surroundings that a surfel sees: 1 in a closed room.
    pub row_sum: Option<RowSum>,
    /// What physics asks of the operator: how far it is off.
    pub checks: Option<Checks>,
    /// The error of the irradiance, measured; `None` where it is exact or cannot be.
    pub error: Option<Verified>,
    /// How far the light is off because the surfels are not the scanned surface; `None` where they are the points,
    /// or where it was not asked for.
    pub surface_error: Option<SurfaceError>,
    /// What the number of points itself allows, whatever the tolerance: estimated relative L2 error of
    /// the irradiance against the true surface.
    pub model_error: Option<f64>,
    /// Whether the surfels were fitted to the points, or are the points.
    pub fitted: bool,
    /// What was repaired or left out, in words with counts.
    pub repairs: Vec<String>,
    /// What was decided and expected beforehand; `None` with an operator from a file.
    pub plan: Option<Plan>,
}

impl Stats {
    /// Whether the measured error is within the tolerance, and with it that by the surface, if that was asked for.
    pub fn met(&self) -> bool {
        let surface = self.surface_error.as_ref();
        self.error.is_none_or(|error| error.met)
            && surface.is_none_or(|surface| surface.bound <= self.tolerance)
            && !self.row_sum.is_some_and(|sum| sum.is_crowded())
    }
}
