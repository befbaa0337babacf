//! The uniform sky.

use glam::{DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

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
    let mut seen = SkySeen::none(surfels);
    let smooth = smoother.is_some();
    seen.look(surfels, tolerance, smooth, seed, visibility, progress)?;
    Ok(seen.irradiance(sky, smoother))
}

/// How much of the sky each surfel was seen to see.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct SkySeen {
    shares: Vec<f64>,
    /// From each surfel.
    directions: usize,
}

impl SkySeen {
    /// Nobody has looked yet.
    pub fn none(surfels: &Surfels) -> SkySeen {
        SkySeen {
            shares: vec![0.0; surfels.len()],
            directions: 0,
        }
    }

    /// Looks in as many more directions as a tolerance needs.
    pub fn look(
        &mut self,
        surfels: &Surfels,
        tolerance: f64,
        smoothed: bool,
        seed: u64,
        visibility: &dyn Visibility,
        progress: &dyn Progress,
    ) -> Result<()> {
        let missing = strata(tolerance, smoothed)
            .pow(2)
            .saturating_sub(self.directions);
        if missing == 0 {
            return Ok(());
        }
        let strata = (missing as f64).sqrt().ceil() as usize;
        let more = strata * strata;
        let batch = (BATCH * 32 / more).max(1);
        let all: Vec<u32> = (0..surfels.len() as u32).collect();
        let before = self.directions;
        let part = more as f64 / (before + more) as f64;
        progress.stage("sky", surfels.len() as u64);
        for (some, shares) in all.chunks(batch).zip(self.shares.chunks_mut(batch)) {
            progress.check()?;
            let item = |k: usize| u64::from(some[k]) | (before as u64) << 32;
            let random = |k: usize| stream(seed, Purpose::Sky, item(k));
            let found = visible_sky(surfels, some, strata, random, visibility)?;
            for (share, found) in shares.iter_mut().zip(found) {
                *share += part * (found - *share);
            }
            progress.advance(some.len() as u64);
        }
        self.directions += more;
        Ok(())
    }

    /// What the sky brings, smoothed if there is a smoother.
    pub fn irradiance(&self, sky: Vec3, smoother: Option<&Smoother>) -> Vec<DVec3> {
        let mut visible: Vec<DVec3> = self.shares.iter().copied().map(DVec3::splat).collect();
        if let Some(smoother) = smoother {
            visible = smoothed(&visible, noise_of_half(self.directions), smoother);
        }
        let sky = sky.as_dvec3();
        visible.into_iter().map(|share| sky * share).collect()
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::PointCloud;
    use crate::progress::Silent;

    /// A wall across half of the sky, askew to the strata.
    struct Wall;

    impl Visibility for Wall {
        fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
            let before = |s: &Segment| 2.0 * (s.to[0] - s.from[0]) + (s.to[1] - s.from[1]) > 0.0;
            Ok(segments.iter().map(before).collect())
        }
    }

    /// Directions of a second look count together with those of the first.
    #[test]
    fn who_looks_again_sees_more() {
        let place = |k: usize| DVec3::new((k % 20) as f64, (k / 20) as f64, 0.0);
        let cloud = PointCloud {
            positions: (0..400).map(place).collect(),
            normals: vec![Vec3::Z; 400],
            reflectance: vec![Vec3::ONE; 400],
            emission: vec![Vec3::ZERO; 400],
            ..PointCloud::default()
        };
        let surfels = Surfels::prepare(&cloud, &Silent).unwrap().surfels;
        let mut seen = SkySeen::none(&surfels);
        let mut look = |tolerance| {
            seen.look(&surfels, tolerance, false, 1, &Wall, &Silent)
                .unwrap();
            let off = seen.shares.iter().map(|share| (share - 0.5).powi(2));
            (seen.directions, (off.sum::<f64>() / 400.0).sqrt())
        };
        let [(few, coarse), (many, fine), again] = [0.1, 0.02, 0.03].map(&mut look);
        println!("{few} directions: {coarse:.4}, {many}: {fine:.4}");
        assert_eq!(few, 25);
        assert!((196..260).contains(&many));
        // All afresh it would be 0.2 of it.
        assert!(fine < 0.3 * coarse);
        assert_eq!(again, (many, fine));
    }
}
