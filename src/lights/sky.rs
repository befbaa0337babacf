//! The uniform sky.

use glam::{DVec3, Vec3};
use rand::RngExt;
use rayon::prelude::*;

use super::BATCH;
use crate::error::Result;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, cosine_direction, stream};
use crate::visibility::{Segment, Visibility};

/// Irradiance from a uniform sky all around that gives an open plane the irradiance `sky`: the
/// share of cosine-weighted, stratified directions that leave the cloud.
///
/// The error of a share from K stratified directions falls as K^(-3/4); K follows the tolerance.
pub fn sky(
    surfels: &Surfels,
    sky: Vec3,
    tolerance: f64,
    seed: u64,
    visibility: &dyn Visibility,
    progress: &dyn Progress,
) -> Result<Vec<DVec3>> {
    let strata = tolerance.powf(-2.0 / 3.0).ceil().clamp(4.0, 64.0) as usize;
    let directions = strata * strata;
    let reach = surfels.reach();
    let batch = (BATCH * 32 / directions).max(1);
    let mut irradiance = Vec::with_capacity(surfels.len());
    progress.stage("sky", surfels.len() as u64);
    while irradiance.len() < surfels.len() {
        progress.check()?;
        let first = irradiance.len();
        let last = (first + batch).min(surfels.len());
        let segments: Vec<Segment> = (first..last)
            .into_par_iter()
            .flat_map_iter(|i| {
                let mut random = stream(seed, Purpose::Sky, i as u64);
                (0..directions).map(move |k| {
                    let u = (k / strata) as f32 + random.random::<f32>();
                    let v = (k % strata) as f32 + random.random::<f32>();
                    let way = cosine_direction(
                        surfels.normals[i],
                        surfels.cells.tangents[i],
                        u / strata as f32,
                        v / strata as f32,
                    );
                    surfels.ray(i, way * reach)
                })
            })
            .collect();
        let visible = visibility.visible(&segments)?;
        irradiance.extend(visible.chunks(directions).map(|seen| {
            let share = seen.iter().filter(|&&v| v).count() as f64 / directions as f64;
            sky.as_dvec3() * share
        }));
        progress.advance((last - first) as u64);
    }
    Ok(irradiance)
}
