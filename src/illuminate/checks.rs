//! What physics asks of a transport operator, whichever it is, and how far it is off.

use std::time::Instant;

use glam::DVec3;
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::stats::RowSum;
use crate::error::Result;
use crate::expansion::Surface;
use crate::lights::visible_sky;
use crate::operator::{Fields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, stream};
use crate::visibility::Visibility;

/// How far an operator F is from what physics asks of it. 0 is perfect, if nothing else is said.
///
/// The sky is seen past the cells: with the classic method, whose links are seen past points, what
/// both make of the same surface differs too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Checks {
    /// 0 ≤ F: the least irradiance, relative to the mean, that any surfel gets from fields that are
    /// nowhere negative: 1, two random ones, the solution (but for what the solver leaves). Below 0 F
    /// has negative entries; above it is as good as any other.
    pub least: f64,
    /// A surfel sees either surfels or the sky: the sum of both parts, 1 if perfect, of some surfels.
    /// The sky is measured in tested directions. Backs of surfels are neither. `None` without
    /// occlusion.
    pub row_sum_and_sky: Option<Spread>,
    /// Obstructed ≤ unobstructed: by how much a row sum exceeds the exact one that all pairs have
    /// without occlusion, at most, of some surfels.
    pub excess: f64,
    /// A_i F_ij = A_j F_ji: |⟨A u, F v⟩ - ⟨A v, F u⟩| / |⟨A u, F v⟩| for two random fields.
    pub reciprocity: f64,
    /// What surfels reflect arrives at others or escapes: the power of both together, relative to
    /// that reflected, less 1. Negative where light is lost. What escapes is sampled: 0.003 is noise.
    /// `None` without occlusion.
    pub energy: Option<f64>,
}

/// What [`check`] found.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Checked {
    pub row_sum: RowSum,
    pub checks: Checks,
    /// Seconds that it took.
    pub seconds: f64,
}

/// A quantity of some surfels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    pub mean: f64,
    /// The value farthest from 1.
    pub worst: f64,
}

/// A radiosity, and the irradiance that the operator makes of it.
#[derive(Clone, Copy)]
pub struct Bounce<'a> {
    pub radiosity: &'a [DVec3],
    pub irradiance: &'a [DVec3],
}

/// Surfels whose rows are checked.
const ROWS: usize = 192;
/// Form factors for the exact sums of rows, and rows at least.
const PAIRS: usize = 1 << 21;
const EXACT_ROWS: usize = 16;
/// The sky over such a surfel is seen in this number, squared, of directions: its part is known to
/// about 0.01.
const ROW_STRATA: usize = 10;
/// Surfels, in proportion to the power that they reflect, whose light may escape, and the same for
/// them: many surfels in few directions each know a mean best.
const SENDERS: usize = 1024;
const SENDER_STRATA: usize = 3;
/// Parts of the cloud, in the octree's order, of which each has one value of a random field: what is
/// wrong between parts of a scene does not average out, as it would between single surfels.
const PARTS: usize = 64;

/// Checks an operator that is made of `surfels`, in their order, and of `visibility`; `last` is the
/// last bounce of the solution. Costs one application of the operator, and segments and pairs for
/// some hundred surfels.
///
/// An operator that leaves out what is dark in the solution, as links do, lacks that in its row sums.
pub fn check<O: TransportOperator>(
    operator: &O,
    surfels: &Surfels,
    last: &Bounce,
    visibility: &dyn Visibility,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Checked> {
    let start = Instant::now();
    progress.stage("checks", 1);
    let n = surfels.len();
    if n == 0 {
        return Ok(Checked::default());
    }
    let mut random = stream(seed, Purpose::CheckFields, 0);
    // Red is 1, green and blue are random: one application does for all.
    let parts: [DVec3; PARTS] =
        std::array::from_fn(|_| DVec3::new(1.0, random.random(), random.random()));
    let sent: Vec<DVec3> = (0..n).map(|i| parts[i * PARTS / n]).collect();
    let fields = operator.fields();
    let rows = fields.download(&operator.apply(&fields.upload(&sent)?)?)?;
    progress.check()?;

    let chosen = |count: usize| -> Vec<u32> {
        let count = count.clamp(1, n);
        (0..count)
            .map(|k| ((2 * k + 1) * n / (2 * count)) as u32)
            .collect()
    };
    let open = visibility.is_open();
    let row_sum_and_sky = match open {
        true => None,
        false => {
            let chosen = chosen(ROWS);
            let random = |k: usize| stream(seed, Purpose::CheckRows, k as u64);
            let skies = visible_sky(surfels, &chosen, ROW_STRATA, random, visibility)?;
            let sums = chosen.iter().zip(skies);
            Some(spread(sums.map(|(&i, sky)| rows[i as usize].x + sky)))
        }
    };
    let energy = match open {
        true => None,
        false => balance(surfels, last, visibility, seed)?,
    };
    let row_sum = RowSum {
        max: rows.iter().fold(0.0, |m, r| m.max(r.x)),
        mean: rows.iter().map(|r| r.x).sum::<f64>() / n as f64,
    };
    let checks = Checks {
        least: least(&rows).min(least(last.irradiance)),
        row_sum_and_sky,
        excess: excess(surfels, &rows, &chosen((PAIRS / n).clamp(EXACT_ROWS, ROWS))),
        reciprocity: reciprocity(surfels, &sent, &rows),
        energy,
    };
    progress.advance(1);
    Ok(Checked {
        row_sum,
        checks,
        seconds: start.elapsed().as_secs_f64(),
    })
}

fn spread(values: impl Iterator<Item = f64>) -> Spread {
    let (mut count, mut total, mut worst) = (0, 0.0, 1.0_f64);
    for value in values {
        count += 1;
        total += value;
        if (value - 1.0).abs() > (worst - 1.0).abs() {
            worst = value;
        }
    }
    Spread {
        mean: total / f64::from(count.max(1)),
        worst,
    }
}

/// Smallest value of a channel relative to the mean of that channel; 0 where there is no light.
fn least(irradiance: &[DVec3]) -> f64 {
    let mean = irradiance.iter().sum::<DVec3>() / irradiance.len() as f64;
    let smallest = irradiance.iter().fold(DVec3::INFINITY, |m, h| m.min(*h));
    let relative = |c: usize| match mean[c] > 0.0 {
        true => smallest[c] / mean[c],
        false => smallest[c].min(0.0),
    };
    (0..3).map(relative).fold(f64::INFINITY, f64::min)
}

/// Largest excess of row sums over the exact ones without occlusion.
fn excess(surfels: &Surfels, rows: &[DVec3], chosen: &[u32]) -> f64 {
    let surface = Surface::<f32>::new(surfels);
    let unobstructed = |i: usize| -> f64 {
        let form_factors = (0..surface.len()).map(|j| f64::from(surface.form_factor(i, j)));
        form_factors.sum()
    };
    let excesses: Vec<f64> = chosen
        .par_iter()
        .map(|&i| rows[i as usize].x - unobstructed(i as usize))
        .collect();
    excesses.into_iter().fold(0.0, f64::max)
}

/// How far ⟨A u, F v⟩ and ⟨A v, F u⟩ are apart, u and v being green and blue of `sent`.
fn reciprocity(surfels: &Surfels, sent: &[DVec3], rows: &[DVec3]) -> f64 {
    let [mut uv, mut vu] = [0.0; 2];
    for ((area, sent), row) in surfels.areas.iter().zip(sent).zip(rows) {
        uv += f64::from(*area) * sent.y * row.z;
        vu += f64::from(*area) * sent.z * row.y;
    }
    match uv == vu {
        true => 0.0,
        false => (uv - vu).abs() / uv.abs(),
    }
}

/// Power that arrives or escapes of the power that leaves, relative to that, less 1.
fn balance(
    surfels: &Surfels,
    last: &Bounce,
    visibility: &dyn Visibility,
    seed: u64,
) -> Result<Option<f64>> {
    let power = |light: &[DVec3]| -> Vec<f64> {
        let areas = surfels.areas.iter();
        areas
            .zip(light)
            .map(|(a, b)| f64::from(*a) * b.element_sum())
            .collect()
    };
    let sent = power(last.radiosity);
    let total: f64 = sent.iter().sum();
    if total <= 0.0 {
        return Ok(None);
    }
    let arrived: f64 = power(last.irradiance).iter().sum();
    let senders = in_proportion(&sent, total, SENDERS);
    // A surfel that is chosen many times looks in other directions each time.
    let random = |k: usize| stream(seed, Purpose::CheckEnergy, k as u64);
    let skies = visible_sky(surfels, &senders, SENDER_STRATA, random, visibility)?;
    let escaping = skies.iter().sum::<f64>() / skies.len() as f64;
    Ok(Some(arrived / total + escaping - 1.0))
}

/// `count` items at equal distances along their weights, one behind the other.
fn in_proportion(weights: &[f64], total: f64, count: usize) -> Vec<u32> {
    let mut chosen = Vec::with_capacity(count);
    let mut passed = 0.0;
    for (i, weight) in weights.iter().enumerate() {
        passed += weight;
        while chosen.len() < count && (chosen.len() as f64 + 0.5) * total < passed * count as f64 {
            chosen.push(i as u32);
        }
    }
    chosen
}
