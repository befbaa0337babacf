//! The radiosity equation of a scene, solved with whichever operator there is.

use std::time::Instant;

use glam::DVec3;

use super::checks::{Bounce, Checks, check};
use super::stats::RowSum;
use crate::error::{Error, Result};
use crate::operator::{Fields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::solve::{Ended, Stop, solve};
use crate::visibility::Visibility;

/// A radiosity equation to solve: everything but the operator.
pub(super) struct Work<'a> {
    pub surfels: &'a Surfels,
    /// Irradiance straight from the lights.
    pub lights: &'a [DVec3],
    /// Reflected radiosity to start from.
    pub start: Option<&'a [DVec3]>,
    pub stop: Stop,
    /// What the operator is checked with after the solve, if it is: the visibility that it was made
    /// with, and a seed.
    pub checked: Option<(&'a dyn Visibility, u64)>,
}

/// Solution of a [`Work`].
#[derive(Default)]
pub(super) struct Bounced {
    pub irradiance: Vec<DVec3>,
    pub ended: Ended,
    pub row_sum: Option<RowSum>,
    pub checks: Option<Checks>,
    /// Seconds that the checks took.
    pub check_seconds: f64,
}

/// Bounces that are followed one by one where the equation has no solution: its row sums, a little
/// over 1 by their own error, let light grow as it is reflected.
const BOUNCES_INSTEAD: u32 = 30;

impl Work<'_> {
    /// Solves for the reflected radiosity, then takes one more step, whose change is the residual.
    ///
    /// All of it stays where the operator is; what the last step brings is all that comes back, and
    /// with checks what it was made of.
    pub fn solve<O: TransportOperator>(
        &self,
        operator: &O,
        progress: &dyn Progress,
    ) -> Result<Bounced> {
        let (mut reflected, mut arrived, mut ended) =
            self.attempt(operator, self.stop, progress)?;
        // Bounces only add light: a solution below the lights is none.
        if sum(&arrived) < -self.stop.residual * sum(self.lights) {
            let stop = Stop {
                bounces: Some(BOUNCES_INSTEAD),
                ..self.stop
            };
            (reflected, arrived, ended) = self.attempt(operator, stop, progress)?;
            ended.converged = false;
        }
        let mut bounced = Bounced {
            // Expansions may leave a little less than nothing.
            irradiance: (arrived.iter().zip(self.lights))
                .map(|(h, light)| (*h + *light).max(DVec3::ZERO))
                .collect(),
            ended,
            ..Bounced::default()
        };
        if let Some((visibility, seed)) = self.checked {
            let start = Instant::now();
            let last = Bounce {
                radiosity: &operator.fields().download(&reflected)?,
                irradiance: &arrived,
            };
            let (row_sum, checks) =
                check(operator, self.surfels, &last, visibility, seed, progress)?;
            bounced.row_sum = Some(row_sum);
            bounced.checks = Some(checks);
            bounced.check_seconds = start.elapsed().as_secs_f64();
        }
        Ok(bounced)
    }

    /// Reflected radiosity, the irradiance that it causes, and how the solver ended.
    fn attempt<O: TransportOperator>(
        &self,
        operator: &O,
        stop: Stop,
        progress: &dyn Progress,
    ) -> Result<Attempt<O>> {
        let fields = operator.fields();
        let reflectance = self.surfels.reflectance.iter().map(|r| r.as_dvec3());
        let reflectance = fields.upload(&reflectance.collect::<Vec<_>>())?;
        let mut source = fields.upload(self.lights)?;
        fields.multiply(&reflectance, &mut source)?;
        let start = self.start.map(|s| fields.upload(s)).transpose()?;
        let (reflected, ended) = solve(operator, &reflectance, &source, start, stop, progress)?;
        progress.check()?;
        let arrived = operator.apply(&reflected)?;
        let mut change = fields.copy(&arrived)?;
        fields.multiply(&reflectance, &mut change)?;
        fields.add(&[(1.0, &source), (-1.0, &reflected)], &mut change)?;
        let change = fields.dot(&change, &change)?.sqrt();
        let residual = match change > 0.0 {
            true => change / fields.dot(&source, &source)?.sqrt(),
            false => change,
        };
        let arrived = fields.download(&arrived)?;
        if !residual.is_finite() || arrived.iter().any(|h| !h.is_finite()) {
            return Err(Error::Invalid(
                "the solution is not finite: are coordinates, areas or lights of extreme size?"
                    .into(),
            ));
        }
        let ended = Ended {
            iterations: ended.iterations + 1,
            residual,
            // The solver's own residual may have drifted by rounding.
            converged: ended.converged
                && (stop.bounces.is_some() || residual <= 2.0 * stop.residual),
        };
        Ok((reflected, arrived, ended))
    }
}

type Attempt<O> = (
    <<O as TransportOperator>::Fields as Fields>::Field,
    Vec<DVec3>,
    Ended,
);

fn sum(irradiance: &[DVec3]) -> f64 {
    irradiance.iter().map(|h| h.element_sum()).sum()
}
