//! The radiosity equation of a scene, solved with whichever operator there is.

use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::checks::{Bounce, Checked, check};
use crate::error::{Error, Result};
use crate::math::is_grey;
use crate::operator::{Fields, Fmm, TransportOperator};
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
#[derive(Clone, Serialize, Deserialize)]
pub(super) struct Bounced {
    pub irradiance: Vec<DVec3>,
    pub reflected: Vec<DVec3>,
    /// Reflected radiosity that the irradiance was made of: after a number of bounces that of one
    /// bounce less, otherwise the same but for the residual.
    pub sent: Vec<DVec3>,
    pub ended: Ended,
    pub checked: Option<Checked>,
}

/// Bounces that are followed one by one where the equation has no solution: its row sums, a little
/// over 1 by their own error, let light grow as it is reflected.
pub(super) const BOUNCES_INSTEAD: u32 = 30;

impl Work<'_> {
    /// Solves for the reflected radiosity, then takes one more step, whose change is the residual.
    pub fn solve<O: TransportOperator>(
        &self,
        operator: &O,
        progress: &dyn Progress,
    ) -> Result<Bounced> {
        self.finish(self.bounces(operator, progress)?, operator, progress)
    }

    /// The same by links on the CPU, where grey light on grey surfaces is one colour instead of three.
    pub fn solve_by_links(&self, operator: &Fmm<f32>, progress: &dyn Progress) -> Result<Bounced> {
        let bounces = match self.is_grey() {
            true => self.bounces(&operator.grey(), progress)?,
            false => self.bounces(operator, progress)?,
        };
        self.finish(bounces, operator, progress)
    }

    fn is_grey(&self) -> bool {
        let mut light = self.lights.iter().chain(self.start.into_iter().flatten());
        let mut reflectance = self.surfels.reflectance.iter();
        reflectance.all(|r| is_grey(r.to_array())) && light.all(|h| is_grey(h.to_array()))
    }

    /// All of it stays where the operator is; what the last step brings is all that comes back, and
    /// what it was made of.
    fn bounces<O: TransportOperator>(
        &self,
        operator: &O,
        progress: &dyn Progress,
    ) -> Result<Bounces> {
        let unit = self.unit();
        let (mut reflected, mut arrived, mut ended) =
            self.attempt(operator, unit, self.stop, progress)?;
        // Bounces only add light: a solution below the lights is none. Nor is one that is hardly closer
        // than so many bounces: what does not decay can be in it in any amount.
        let below = unit * sum(&arrived) < -self.stop.residual * sum(self.lights);
        if below || !ended.converged {
            let stop = Stop {
                bounces: Some(BOUNCES_INSTEAD),
                ..self.stop
            };
            let instead = self.attempt(operator, unit, stop, progress)?;
            if below || instead.2.residual < 2.0 * ended.residual {
                (reflected, arrived, ended) = instead;
            }
            ended.converged = false;
        }
        Ok(Bounces {
            sent: operator.fields().download(&reflected)?,
            arrived,
            ended,
            unit,
        })
    }

    /// Light in its unit again, and the operator checked, if it is.
    fn finish<O: TransportOperator>(
        &self,
        bounces: Bounces,
        operator: &O,
        progress: &dyn Progress,
    ) -> Result<Bounced> {
        let Bounces {
            mut sent,
            arrived,
            ended,
            unit,
        } = bounces;
        let check = |(visibility, seed)| {
            let last = Bounce {
                radiosity: &sent,
                irradiance: &arrived,
            };
            check(operator, self.surfels, &last, visibility, seed, progress)
        };
        let checked = self.checked.map(check).transpose()?;
        sent.par_iter_mut().for_each(|b| *b *= unit);
        // Expansions may leave a little less than nothing.
        let irradiance: Vec<DVec3> = (arrived.par_iter().zip(self.lights))
            .map(|(h, light)| (*h * unit + *light).max(DVec3::ZERO))
            .collect();
        Ok(Bounced {
            reflected: (irradiance.par_iter().zip(self.reflectance()))
                .map(|(h, r)| *h * r)
                .collect(),
            irradiance,
            sent,
            ended,
            checked,
        })
    }

    fn reflectance(&self) -> impl IndexedParallelIterator<Item = DVec3> {
        self.surfels.reflectance.par_iter().map(|r| r.as_dvec3())
    }

    /// The brightest light, rounded to a power of two: in this unit squares stay in the range of f32,
    /// and rounding is what it was.
    fn unit(&self) -> f64 {
        let brightest = self.lights.iter().map(|h| h.max_element());
        match brightest.fold(0.0, f64::max) {
            0.0 => 1.0,
            light => light.log2().round().exp2(),
        }
    }

    /// Reflected radiosity, the irradiance that it causes, and how the solver ended; light is in
    /// this unit.
    fn attempt<O: TransportOperator>(
        &self,
        operator: &O,
        unit: f64,
        stop: Stop,
        progress: &dyn Progress,
    ) -> Result<Attempt<O>> {
        let fields = operator.fields();
        let reflectance = fields.upload(&self.reflectance().collect::<Vec<_>>())?;
        let upload = |light: &[DVec3]| {
            let light: Vec<DVec3> = light.par_iter().map(|h| *h / unit).collect();
            fields.upload(&light)
        };
        let mut source = upload(self.lights)?;
        fields.multiply(&reflectance, &mut source)?;
        let start = self.start.map(upload).transpose()?;
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

/// A solution in a unit of light: what surfels send, and what that brings.
struct Bounces {
    sent: Vec<DVec3>,
    arrived: Vec<DVec3>,
    ended: Ended,
    unit: f64,
}

type Attempt<O> = (
    <<O as TransportOperator>::Fields as Fields>::Field,
    Vec<DVec3>,
    Ended,
);

fn sum(irradiance: &[DVec3]) -> f64 {
    irradiance.iter().map(|h| h.element_sum()).sum()
}
