//! What the links may get wrong, and where it matters.

use glam::DVec3;
use rayon::prelude::*;

use crate::octree::Octree;

/// What the links may get wrong, and where it matters.
#[derive(Clone, Debug)]
pub struct Accuracy {
    /// Largest order of the expansions.
    pub order: usize,
    /// Irradiance that a link may be off by, before the factors of the targets.
    pub error: f32,
    /// A facet: largest radiosity of a surfel in it.
    pub radiosity: Vec<f32>,
    /// A facet: factor on `error` for links that end there (dark places need more care).
    pub target_factor: Vec<f32>,
    /// Seed of the segments that are drawn.
    pub seed: u64,
}

/// Radiosity, in units of the mean irradiance, that every facet is taken to have at least: light
/// that a rough solution has missed must find its way.
const LEAST_RADIOSITY: f64 = 0.01;
/// Bounds of the factor on a link's error from the light at its target.
pub(crate) const LOCAL_TOLERANCE: [f64; 2] = [0.1, 3.0];

impl Accuracy {
    /// An error of each link `relative` to the mean irradiance, and finer or coarser where a place
    /// is darker or brighter than the mean. Without the irradiance of a first solution, the mean of
    /// the radiosity stands for it. Both fields are in the octree's order.
    pub fn new(
        octree: &Octree,
        radiosity: &[DVec3],
        irradiance: Option<&[DVec3]>,
        relative: f64,
        order: usize,
        seed: u64,
    ) -> Accuracy {
        let grey = |h: &DVec3| h.element_sum() / 3.0;
        let mean = |field: &[DVec3]| field.iter().map(grey).sum::<f64>() / field.len() as f64;
        let level = mean(irradiance.unwrap_or(radiosity)).max(f64::MIN_POSITIVE);
        let local = |range: std::ops::Range<usize>| {
            let least = irradiance.map_or(level, |h| {
                h[range].iter().map(grey).fold(f64::INFINITY, f64::min)
            });
            (least / level).clamp(LOCAL_TOLERANCE[0], LOCAL_TOLERANCE[1]) as f32
        };
        let strongest = |range: std::ops::Range<usize>| {
            radiosity[range]
                .iter()
                .map(|b| b.max_element())
                .fold(LEAST_RADIOSITY * level, f64::max) as f32
        };
        let facets = &octree.facets;
        Accuracy {
            order,
            error: (relative * level) as f32,
            radiosity: facets.par_iter().map(|f| strongest(f.surfels())).collect(),
            target_factor: facets.par_iter().map(|f| local(f.surfels())).collect(),
            seed,
        }
    }

    /// Irradiance that a link to this facet may be off by.
    pub fn allowed(&self, target: u32) -> f32 {
        self.error * self.target_factor[target as usize]
    }

    /// What a link has to be good for: the radiosity of its source, in units of the error allowed at
    /// its target. Nothing else of the light matters to a link with tested visibility.
    pub fn demand(&self, [target, source]: [u32; 2]) -> f32 {
        match self.radiosity[source as usize] {
            0.0 => 0.0,
            radiosity => (radiosity / self.allowed(target)).min(f32::MAX),
        }
    }
}
