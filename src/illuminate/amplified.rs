//! What becomes of an error of one bounce after all of them.

use glam::{DVec3, Vec3};
use rand::RngExt;

use super::quantiles::{DEVIATIONS, Interval};
use super::receivers::Receivers;
use crate::error::Result;
use crate::operator::{Fields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, stream};
use crate::solve::{Stop, solve};

/// Solves of the error's equation, each with three channels, of which the first two carry the two
/// estimates of the error and the others draws of what it would be by chance.
const SOLVES: u64 = 2;
/// Relative residual up to which they are solved, times what a reflection loses, and least value of that.
const RESIDUAL: f64 = 0.06;
const LEAST: f64 = 0.002;
/// Mean square, in units of that of the errors, up to which one draw is enough.
const NEGLIGIBLE: f64 = 0.1;

/// The part G r = F (I - ρF)⁻¹ ρ r of an error that light carries on from where it was made: |r + G r|²
/// is |r|² + 2 r·G r + |G r|². Grey: means of the channels.
pub(super) struct Amplified {
    /// G of both estimates of the error, at the receivers.
    carried: [Vec<f64>; 2],
    /// Mean of the product of both over all surfels, which is the mean of |G r|².
    square: f64,
    /// What 2 r·G r + |G r|² would be if the errors of the receivers had random signs: how well it is
    /// known.
    chance: f64,
    /// Whether there is no chance in it, as the error of every surfel is known.
    complete: bool,
}

/// Carries errors on of which there are two estimates at the receivers, each of which stands for its
/// part of the octree's order.
///
/// So errors of neighbours count as the same, which they are where a cluster is wrong; what is wrong
/// surfel by surfel averages out, and is overrated.
pub(super) fn amplified<O: TransportOperator>(
    operator: &O,
    surfels: &Surfels,
    receivers: &Receivers,
    errors: [&[f64]; 2],
    bounces: Option<u32>,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Amplified> {
    let n = surfels.len();
    let complete = receivers.len() == n && errors[0] == errors[1];
    let unit = receivers.mean(errors[0].iter().map(|e| e * e)).sqrt();
    let mut amplified = Amplified {
        carried: [(); 2].map(|()| vec![0.0; receivers.len()]),
        square: 0.0,
        chance: 0.0,
        complete,
    };
    if unit == 0.0 {
        return Ok(amplified);
    }
    let fields = operator.fields();
    let brightest = |r: &Vec3| DVec3::splat(f64::from(r.max_element()));
    let reflectance: Vec<DVec3> = surfels.reflectance.iter().map(brightest).collect();
    // What is left is reflected on as well, and in a white room again and again.
    let grey = reflectance.iter().map(|r| r.x).sum::<f64>() / n as f64;
    let stop = Stop {
        residual: RESIDUAL * (1.0 - grey).max(LEAST),
        bounces,
    };
    let reflectance = fields.upload(&reflectance)?;
    let mut chances = Vec::new();
    for k in 0..SOLVES {
        let mut random = stream(seed, Purpose::Errors, k);
        let mut sign = || if random.random() { 1.0 } else { -1.0 };
        let known: Vec<DVec3> = (errors[0].iter().zip(errors[1]))
            .map(|(a, b)| {
                let mean = 0.5 * (a + b);
                match k {
                    0 => DVec3::new(*a, *b, sign() * mean) / unit,
                    _ => DVec3::new(sign(), sign(), sign()) * (mean / unit),
                }
            })
            .collect();
        let spread = receivers.spread(&known);
        let mut source = fields.upload(&spread)?;
        fields.multiply(&reflectance, &mut source)?;
        let (sent, _) = solve(operator, &reflectance, &source, None, stop, progress)?;
        let arrived = fields.download(&operator.apply(&sent)?)?;
        let mean = |product: DVec3| product / n as f64;
        let square = mean(arrived.iter().map(|g| *g * *g).sum());
        let cross = mean(arrived.iter().zip(&spread).map(|(g, r)| *g * *r).sum());
        let chance = (square + 2.0 * cross.max(DVec3::ZERO)) * (unit * unit);
        chances.push(chance.z);
        if k == 0 {
            amplified.square = mean(DVec3::X * arrived.iter().map(|g| g.x * g.y).sum::<f64>()).x;
            amplified.square *= unit * unit;
            for (c, carried) in amplified.carried.iter_mut().enumerate() {
                let at = receivers
                    .surfels
                    .iter()
                    .map(|&i| unit * arrived[i as usize][c]);
                *carried = at.collect();
            }
            // One draw will do where it hardly counts.
            if complete || chance.z < NEGLIGIBLE * unit * unit {
                break;
            }
        } else {
            chances.extend([chance.x, chance.y]);
        }
    }
    amplified.chance = chances.iter().sum::<f64>() / chances.len() as f64;
    Ok(amplified)
}

impl Amplified {
    /// The relative error of all bounces, from that of the last: `errors` are its two estimates at the
    /// receivers, `whole` is what they are relative to.
    pub fn added_to(
        &self,
        one: Interval,
        receivers: &Receivers,
        errors: [&[f64]; 2],
        whole: f64,
    ) -> Interval {
        if whole == 0.0 {
            return one;
        }
        let [a, b] = &self.carried;
        let twice = [(errors[0], b), (errors[1], a)]
            .map(|(errors, carried)| {
                let products = errors.iter().zip(carried).map(|(e, g)| e * g);
                receivers.mean(products)
            })
            .iter()
            .sum::<f64>();
        let scale = 1.0 / (whole * whole);
        let added = scale * (twice + self.square);
        let likely = added.max(0.0);
        let deviation = match self.complete {
            true => RESIDUAL * likely.sqrt(),
            false => DEVIATIONS * (scale * self.chance).sqrt(),
        };
        let most = (likely.sqrt() + deviation).powi(2);
        let least = (likely.sqrt() - deviation).max(0.0).powi(2).min(likely);
        // Both are uncertain, and independently.
        let value = one.value * one.value + likely;
        let above = (one.high * one.high - one.value * one.value).hypot(most - likely);
        let below = (one.value * one.value - one.low * one.low).hypot(likely - least);
        Interval {
            value,
            low: value - below,
            high: value + above,
        }
        .root()
    }
}
