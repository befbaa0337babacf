//! What becomes of an error of one bounce after all of them.

use glam::DVec3;
use rand::RngExt;

use super::quantiles::Interval;
use crate::error::Result;
use crate::operator::{Fields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, stream};
use crate::solve::{Stop, solve};

/// Solves of the error's equation. Each has three channels: one error and draws of what the same
/// errors would add up to by chance.
const SOLVES: u64 = 2;
/// Quantile of Student's distribution at 95% for as many draws, 5.
const STUDENT: f64 = 2.015;

/// The part G r = F (I - ρF)⁻¹ ρ r of an error that light carries from where it was made.
pub(super) struct Amplified {
    /// Root mean square of all surfels.
    rms: f64,
    /// What it would be if the errors had random signs: how well it is known.
    noise: f64,
    /// At the receivers.
    at_receivers: Vec<f64>,
}

/// Carries errors that are known at `receivers` alone: each stands for its part of the octree's order.
///
/// So errors of neighbours count as the same, which they are if a cluster is wrong; what is wrong
/// surfel by surfel would average out, and is overrated.
pub(super) fn amplified<O: TransportOperator>(
    operator: &O,
    surfels: &Surfels,
    receivers: &[u32],
    errors: &[f64],
    stop: Stop,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Amplified> {
    let n = surfels.len();
    let unit = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt();
    let mut carried = Amplified {
        rms: 0.0,
        noise: 0.0,
        at_receivers: vec![0.0; receivers.len()],
    };
    if unit == 0.0 {
        return Ok(carried);
    }
    let fields = operator.fields();
    let brightest = |r: &glam::Vec3| DVec3::splat(f64::from(r.max_element()));
    let reflectance: Vec<DVec3> = surfels.reflectance.iter().map(brightest).collect();
    let reflectance = fields.upload(&reflectance)?;
    let mut squares = 0.0;
    for draw in 0..SOLVES {
        let mut random = stream(seed, Purpose::Errors, draw);
        let mut sign = || if random.random() { 1.0 } else { -1.0 };
        let known: Vec<DVec3> = errors
            .iter()
            .map(|e| {
                let first = if draw == 0 { 1.0 } else { sign() };
                DVec3::new(first, sign(), sign()) * (e / unit)
            })
            .collect();
        let spread: Vec<DVec3> = (0..n).map(|i| known[i * known.len() / n]).collect();
        let mut source = fields.upload(&spread)?;
        fields.multiply(&reflectance, &mut source)?;
        let (sent, _) = solve(operator, &reflectance, &source, None, stop, progress)?;
        let arrived = fields.download(&operator.apply(&sent)?)?;
        let mean = arrived.iter().map(|h| *h * *h).sum::<DVec3>() / n as f64;
        squares += mean.y + mean.z;
        if draw == 0 {
            carried.rms = unit * mean.x.sqrt();
            carried.at_receivers = (receivers.iter())
                .map(|&i| unit * arrived[i as usize].x)
                .collect();
        } else {
            squares += mean.x;
        }
    }
    carried.noise = unit * (squares / (3 * SOLVES - 1) as f64).sqrt();
    Ok(carried)
}

impl Amplified {
    /// The relative error of all bounces: `one` that of the last, `errors` at the receivers, `whole`
    /// what they are relative to.
    pub fn added_to(&self, one: Interval, errors: &[f64], whole: f64) -> Interval {
        if whole == 0.0 {
            return one;
        }
        let likely = (self.rms.powi(2) - self.noise.powi(2)).max(0.0).sqrt() / whole;
        let most = (self.rms + STUDENT * self.noise) / whole;
        let least = (self.rms - STUDENT * self.noise).max(0.0) / whole;
        // Where the error of the last bounce and what earlier ones brought have the same sign they
        // add up.
        let common: f64 = errors.iter().zip(&self.at_receivers).map(|(e, g)| e * g).sum();
        let common = common / errors.len().max(1) as f64 / (self.rms * self.rms).max(f64::MIN_POSITIVE);
        let sum = |one: f64, carried: f64, share: f64| {
            (one * one + carried * carried * (1.0 + 2.0 * share)).max(0.0).sqrt()
        };
        Interval {
            value: sum(one.value, likely, common),
            low: sum(one.low, least, common.min(0.0)),
            high: sum(one.high, most, common.max(0.0)),
        }
    }
}
