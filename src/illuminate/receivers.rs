//! Which surfels a solution is verified at.

use glam::DVec3;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::measured::Claim;

/// Part of the receivers that are chosen regardless of the light.
const REGARDLESS: f64 = 0.75;

/// Some surfels that stand for all, in the octree's order: more of them where there is more light that
/// can be wrong, as a few bright places may hold most of the error.
pub struct Receivers {
    /// One may be there several times.
    pub surfels: Vec<u32>,
    /// The mean of weight × value is that over all surfels, on average; at most 1 / [`REGARDLESS`].
    pub weights: Vec<f64>,
    /// The surfels up to which each stands for its surroundings.
    ends: Vec<u32>,
}

impl Receivers {
    /// One out of each of `count` parts of all that are equally important; all, if there are no more.
    pub(super) fn choose(claim: &Claim, count: usize, random: &mut Pcg64Mcg) -> Receivers {
        let n = claim.irradiance.len();
        if count >= n {
            return Receivers {
                surfels: (0..n as u32).collect(),
                weights: vec![1.0; n],
                ends: (1..=n as u32).collect(),
            };
        }
        let square = |i: usize| {
            let reflected = claim.irradiance[i] - claim.lights[i];
            reflected.length_squared() + claim.sampled[i].length_squared()
        };
        let mean = (0..n).map(square).sum::<f64>() / n as f64;
        // Relative to that of one chosen regardless of everything.
        let importance = |i: usize| match mean > 0.0 {
            true => REGARDLESS + (1.0 - REGARDLESS) * square(i) / mean,
            false => 1.0,
        };
        let weights: Vec<f64> = (0..n).map(|i| 1.0 / importance(i)).collect();
        let mut reached = 0.0;
        let up_to: Vec<f64> = (weights.iter())
            .map(|w| {
                reached += 1.0 / w;
                reached
            })
            .collect();
        let part = reached / count as f64;
        let place = |k: usize| (k as f64 + random.random::<f64>()) * part;
        let surfels: Vec<u32> = (0..count)
            .map(place)
            .map(|x| up_to.partition_point(|&end| end <= x).min(n - 1) as u32)
            .collect();
        // A surfel in two parts goes to the first.
        let end = |k: usize| match k == count {
            true => n as u32,
            false => up_to.partition_point(|&end| end < k as f64 * part) as u32 + 1,
        };
        Receivers {
            weights: surfels.iter().map(|&i| weights[i as usize]).collect(),
            ends: (1..=count).map(|k| end(k).min(n as u32)).collect(),
            surfels,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.surfels.len()
    }

    /// Values of the receivers for all surfels.
    pub(super) fn spread(&self, values: &[DVec3]) -> Vec<DVec3> {
        let mut spread = Vec::with_capacity(self.ends.last().copied().unwrap_or(0) as usize);
        for (value, &end) in values.iter().zip(&self.ends) {
            spread.resize(end as usize, *value);
        }
        spread
    }

    /// Values that each count as much as they stand for.
    pub(super) fn weighted(&self, values: impl IntoIterator<Item = f64>) -> Vec<f64> {
        self.weights
            .iter()
            .zip(values)
            .map(|(w, x)| w * x)
            .collect()
    }

    /// The mean over all surfels.
    pub(super) fn mean(&self, values: impl IntoIterator<Item = f64>) -> f64 {
        self.weighted(values).iter().sum::<f64>() / self.weights.len().max(1) as f64
    }
}
