//! The radiosity equation of a scene, solved with whichever operator there is.

use glam::DVec3;

use super::stats::RowSum;
use crate::error::{Error, Result};
use crate::operator::{Fields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::solve::{Ended, Stop, solve};

/// A radiosity equation to solve: everything but the operator.
pub(super) struct Work<'a> {
    pub surfels: &'a Surfels,
    /// Irradiance straight from the lights.
    pub lights: &'a [DVec3],
    /// Reflected radiosity to start from.
    pub start: Option<&'a [DVec3]>,
    pub stop: Stop,
}

/// Solution of a [`Work`].
pub(super) struct Bounced {
    pub irradiance: Vec<DVec3>,
    pub reflected: Vec<DVec3>,
    pub ended: Ended,
    pub row_sum: RowSum,
}

/// Bounces that are followed one by one where the equation has no solution: its row sums, a little
/// over 1 by their own error, let light grow as it is reflected.
const BOUNCES_INSTEAD: u32 = 30;

impl Work<'_> {
    /// Solves for the reflected radiosity, then takes one more step, whose change is the residual.
    pub fn solve<O: TransportOperator>(
        &self,
        operator: &O,
        progress: &dyn Progress,
    ) -> Result<Bounced> {
        let mut bounced = self.attempt(operator, self.stop, progress)?;
        // Bounces only add light: a solution below the lights is none.
        if mean(&bounced.irradiance) < (1.0 - self.stop.residual) * mean(self.lights) {
            let stop = Stop {
                bounces: Some(BOUNCES_INSTEAD),
                ..self.stop
            };
            bounced = self.attempt(operator, stop, progress)?;
            bounced.ended.converged = false;
        }
        // Expansions may leave a little less than nothing.
        for h in &mut bounced.irradiance {
            *h = h.max(DVec3::ZERO);
        }
        bounced.reflected = reflect(&bounced.irradiance, &self.reflectance());
        Ok(bounced)
    }

    fn reflectance(&self) -> Vec<DVec3> {
        let reflectance = self.surfels.reflectance.iter();
        reflectance.map(|r| r.as_dvec3()).collect()
    }

    fn attempt<O: TransportOperator>(
        &self,
        operator: &O,
        stop: Stop,
        progress: &dyn Progress,
    ) -> Result<Bounced> {
        let fields = operator.fields();
        let reflectance = self.reflectance();
        let source = reflect(self.lights, &reflectance);
        let start = self.start.map(|s| fields.upload(s)).transpose()?;
        let (reflected, ended) = solve(
            operator,
            &fields.upload(&reflectance)?,
            &fields.upload(&source)?,
            start,
            stop,
            progress,
        )?;
        progress.check()?;
        let bounced = fields.download(&operator.apply(&reflected)?)?;
        let irradiance: Vec<DVec3> = bounced
            .iter()
            .zip(self.lights)
            .map(|(h, light)| *h + *light)
            .collect();
        if !ended.residual.is_finite() || irradiance.iter().any(|h| !h.is_finite()) {
            return Err(Error::Invalid(
                "the solution is not finite: are coordinates, areas or lights of extreme size?"
                    .into(),
            ));
        }
        let reflected = fields.download(&reflected)?;
        let change = distance(&reflect(&irradiance, &reflectance), &reflected);
        let residual = if change > 0.0 {
            change / length(&source)
        } else {
            0.0
        };
        progress.check()?;
        let ones = fields.upload(&vec![DVec3::ONE; self.surfels.len()])?;
        let row_sums = fields.download(&operator.apply(&ones)?)?;
        Ok(Bounced {
            irradiance,
            reflected,
            ended: Ended {
                iterations: ended.iterations + 1,
                residual,
                // The solver's own residual may have drifted by rounding.
                converged: ended.converged
                    && (stop.bounces.is_some() || residual <= 2.0 * stop.residual),
            },
            row_sum: RowSum {
                max: row_sums.iter().fold(0.0, |m, r| m.max(r.x)),
                mean: row_sums.iter().map(|r| r.x).sum::<f64>() / row_sums.len() as f64,
            },
        })
    }
}

/// ρ H
fn reflect(irradiance: &[DVec3], reflectance: &[DVec3]) -> Vec<DVec3> {
    irradiance
        .iter()
        .zip(reflectance)
        .map(|(h, r)| h * r)
        .collect()
}

fn mean(irradiance: &[DVec3]) -> f64 {
    irradiance.iter().map(|h| h.element_sum()).sum::<f64>() / irradiance.len() as f64
}

fn length(values: &[DVec3]) -> f64 {
    values
        .iter()
        .map(|v| v.length_squared())
        .sum::<f64>()
        .sqrt()
}

fn distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    let pairs = a.iter().zip(b);
    pairs
        .map(|(a, b)| a.distance_squared(*b))
        .sum::<f64>()
        .sqrt()
}
