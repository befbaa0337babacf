//! The uniform sky.

use glam::{DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::{BATCH, noise_of_half, smoothed};
use crate::error::Result;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, cosine_direction, stream};
use crate::smoothing::Smoother;
use crate::visibility::{Segment, Visibility};

/// How many times larger the error may be before it is smoothed.
const SMOOTHED: f64 = 2.5;

/// Irradiance from a uniform sky all around that gives an open plane the irradiance `sky`: the
/// share of cosine-weighted, stratified directions that leave the cloud, smoothed if there is a smoother.
pub fn sky(
    surfels: &Surfels,
    sky: Vec3,
    tolerance: f64,
    seed: u64,
    visibility: &dyn Visibility,
    smoother: Option<&Smoother>,
    progress: &dyn Progress,
) -> Result<Vec<DVec3>> {
    let strata = strata(tolerance, smoother.is_some());
    let batch = (BATCH * 32 / (strata * strata)).max(1);
    let all: Vec<u32> = (0..surfels.len() as u32).collect();
    let mut visible = Vec::with_capacity(surfels.len());
    progress.stage("sky", surfels.len() as u64);
    for some in all.chunks(batch) {
        progress.check()?;
        let random = |k: usize| stream(seed, Purpose::Sky, some[k].into());
        let shares = visible_sky(surfels, some, strata, random, visibility)?;
        visible.extend(shares.into_iter().map(DVec3::splat));
        progress.advance(some.len() as u64);
    }
    if let Some(smoother) = smoother {
        visible = smoothed(&visible, noise_of_half(strata * strata), smoother);
    }
    let sky = sky.as_dvec3();
    Ok(visible.into_iter().map(|share| sky * share).collect())
}

/// Into how many parts the directions of the sky are divided in either of two ways.
///
/// The error of a share from K stratified directions falls as K^(-3/4); K follows the tolerance.
pub(crate) fn strata(tolerance: f64, smoothed: bool) -> usize {
    let error = if smoothed {
        SMOOTHED * tolerance
    } else {
        tolerance
    };
    error.powf(-2.0 / 3.0).ceil().clamp(4.0, 64.0) as usize
}

/// The share of `strata`² cosine-weighted, stratified directions that leave the cloud, from each of
/// these surfels, by the random numbers of `random(k)` from the k-th.
pub(crate) fn visible_sky(
    surfels: &Surfels,
    some: &[u32],
    strata: usize,
    random: impl Fn(usize) -> Pcg64Mcg + Sync,
    visibility: &dyn Visibility,
) -> Result<Vec<f64>> {
    let directions = strata * strata;
    let reach = surfels.reach();
    let segments: Vec<Segment> = some
        .par_iter()
        .enumerate()
        .flat_map_iter(|(k, &i)| {
            let mut random = random(k);
            let i = i as usize;
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
    let share = |seen: &[bool]| seen.iter().filter(|&&v| v).count() as f64 / directions as f64;
    Ok(visible.chunks(directions).map(share).collect())
}
