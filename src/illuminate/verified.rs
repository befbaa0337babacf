//! What verifying a solution says of it.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::quantiles::Interval;

/// Upper bound of an error over the error, as a rule.
const SPREAD: f64 = 1.3;

/// Errors of a solution against the point truth, relative as [`Comparison`](crate::compare::Comparison)
/// has it, each with its 95% bounds, lower and upper.
///
/// Quantiles hold a little noise of the estimates as well, and are rather too large.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Errors {
    /// Relative L2 error of the last bounce: the operator was applied once to the light of the
    /// solution, and is compared with the exact sum over that same light.
    pub one_bounce: Interval,
    /// Relative L2 error of the solution: that of all bounces.
    pub rel_l2: Interval,
    pub median: Interval,
    pub p95: Interval,
    pub p99: Interval,
    /// The largest that was found. Larger ones have at most 6 points out of as many as were looked at,
    /// with 95% confidence.
    pub max: f64,
    pub bias: Interval,
}

/// What verifying a solution found.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Verified {
    /// Surfels that were looked at.
    pub receivers: usize,
    /// Segments that it took.
    pub segments: u64,
    /// Seconds that it took.
    pub seconds: f64,
    /// Upper bound of the errors that was asked for.
    pub tolerance: f64,
    /// Whether the relative L2 errors of the irradiance and of ambient light are within it, with 95% confidence.
    pub met: bool,
    /// Of the irradiance.
    pub total: Errors,
    /// Relative L2 error by sampled light straight from sky and shining surfels, a part of that.
    pub direct: Interval,
    /// Relative L2 error of ambient light, which comes from all around: what was reflected before, and
    /// that of the sky.
    pub ambient: Interval,
    /// Of the irradiance by light that was reflected before, relative to itself; `None` where there is
    /// none.
    pub reflected: Option<Errors>,
    /// Root mean square of reflected light, in units of that of ambient light.
    pub part_reflected: f64,
    /// What errors of ambient light count: 1, and less of a fitted surface, which is itself not known as well.
    #[serde(default = "one")]
    pub ambient_counts: f64,
}

fn one() -> f64 {
    1.0
}

impl Verified {
    /// Upper 95% bound of the relative L2 errors of all light and of ambient light, as far as that counts.
    pub fn bound(&self) -> f64 {
        let ambient = self.ambient_counts * self.ambient.high;
        self.total.rel_l2.high.max(ambient)
    }

    /// The larger one of these errors.
    pub(super) fn error(&self) -> f64 {
        let ambient = self.ambient_counts * self.ambient.value;
        self.total.rel_l2.value.max(ambient)
    }

    /// Lower bound of the larger one.
    pub(super) fn least(&self) -> f64 {
        let ambient = self.ambient_counts * self.ambient.low;
        self.total.rel_l2.low.max(ambient)
    }

    /// The upper bound, as it is as a rule.
    pub(super) fn likely(&self) -> f64 {
        let ambient = self.ambient_counts * likely(self.ambient);
        likely(self.total.rel_l2).max(ambient)
    }

    /// Whether it is the lights that are wrong, and with them what is reflected of them.
    pub(super) fn by_lights(&self) -> bool {
        self.direct.value > 0.5 * self.total.rel_l2.value
    }

    /// What the operator adds to the error of ambient light, as a rule.
    pub(super) fn by_operator(&self) -> f64 {
        let of_reflected = self.reflected.map_or(0.0, |part| likely(part.one_bounce));
        self.ambient_counts * self.part_reflected * of_reflected
    }

    /// Two independent looks at one solution together: the means of what they found, and half of the
    /// variance.
    pub(super) fn and(&self, other: &Verified) -> Verified {
        Verified {
            receivers: self.receivers + other.receivers,
            segments: self.segments + other.segments,
            seconds: self.seconds + other.seconds,
            tolerance: self.tolerance,
            met: false,
            total: self.total.and(&other.total),
            direct: self.direct.and_root(other.direct),
            ambient: self.ambient.and_root(other.ambient),
            reflected: self.reflected.zip(other.reflected).map(|(a, b)| a.and(&b)),
            part_reflected: self.part_reflected,
            ambient_counts: self.ambient_counts,
        }
    }

    /// Takes a tolerance as what was asked for.
    pub(super) fn judge_by(&mut self, tolerance: f64) {
        self.tolerance = tolerance;
        self.met = self.bound() <= tolerance;
    }
}

impl Errors {
    fn and(&self, other: &Errors) -> Errors {
        Errors {
            one_bounce: self.one_bounce.and_root(other.one_bounce),
            rel_l2: self.rel_l2.and_root(other.rel_l2),
            median: self.median.and(other.median),
            p95: self.p95.and(other.p95),
            p99: self.p99.and(other.p99),
            max: self.max.max(other.max),
            bias: self.bias.and(other.bias),
        }
    }
}

impl fmt::Display for Verified {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let percent = |error: Interval| {
            let [value, low, high] = [error.value, error.low, error.high].map(|x| 100.0 * x);
            format!("{value:.2}% ({low:.2} to {high:.2})")
        };
        write!(f, "{} in all", percent(self.total.rel_l2))?;
        match &self.reflected {
            Some(_) if self.part_reflected < 1.0 => {
                write!(f, ", {} of reflected light and sky", percent(self.ambient))?;
            }
            Some(_) => write!(f, ", {} of reflected light", percent(self.ambient))?,
            None => {}
        }
        if self.reflected.is_some() && self.ambient_counts < 1.0 {
            write!(
                f,
                " (which counts {:.2} on a fitted surface)",
                self.ambient_counts
            )?;
        }
        let [p95, max] = [self.total.p95.value, self.total.max].map(|x| 100.0 * x);
        write!(
            f,
            ", 95% of the points within {p95:.1}%, the worst {max:.0}%"
        )?;
        let bias = 100.0 * self.total.bias.value;
        write!(f, ", bias {bias:+.2}%, by {} points", self.receivers)
    }
}

/// Upper bound of an error, as it is as a rule: one point that is far off makes the bound, but not the error,
/// very large.
fn likely(error: Interval) -> f64 {
    error.high.min(SPREAD * error.value)
}
