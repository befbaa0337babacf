//! The radiosity equation of a scene, solved with whichever operator there is.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::operator::{Fields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::solve::{Ended, Stop, solve};
use crate::stats::RowSum;

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

impl Work<'_> {
    /// Solves for the reflected radiosity, then takes one more step, whose change is the residual.
    pub fn solve<O: TransportOperator>(
        &self,
        operator: &O,
        progress: &dyn Progress,
    ) -> Result<Bounced> {
        let fields = operator.fields();
        let reflectance: Vec<DVec3> = self
            .surfels
            .reflectance
            .iter()
            .map(|r| r.as_dvec3())
            .collect();
        let source: Vec<DVec3> = self
            .lights
            .iter()
            .zip(&reflectance)
            .map(|(h, r)| h * r)
            .collect();
        let start = self.start.map(|s| fields.upload(s)).transpose()?;
        let (reflected, ended) = solve(
            operator,
            &fields.upload(&reflectance)?,
            &fields.upload(&source)?,
            start,
            self.stop,
            progress,
        )?;
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
        // Expansions may leave a little less than nothing.
        let irradiance: Vec<DVec3> = irradiance.iter().map(|h| h.max(DVec3::ZERO)).collect();
        let row_sums = fields
            .download(&operator.apply(&fields.upload(&vec![DVec3::ONE; self.surfels.len()])?)?)?;
        Ok(Bounced {
            reflected: irradiance
                .iter()
                .zip(&reflectance)
                .map(|(h, r)| h * r)
                .collect(),
            irradiance,
            ended,
            row_sum: RowSum {
                max: row_sums.iter().fold(0.0, |m, r| m.max(r.x)),
                mean: row_sums.iter().map(|r| r.x).sum::<f64>() / row_sums.len() as f64,
            },
        })
    }
}
