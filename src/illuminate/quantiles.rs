//! What a sample says of the whole.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// A figure with its bounds: it is above the lower one with 95% confidence, and below the upper one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    pub value: f64,
    pub low: f64,
    pub high: f64,
}

/// Resamples of a bootstrap.
const RESAMPLES: usize = 300;
/// Standard deviations of a normal distribution below which 95% lie.
pub(super) const DEVIATIONS: f64 = 1.645;

impl Interval {
    pub(super) fn exactly(value: f64) -> Interval {
        Interval {
            value,
            low: value,
            high: value,
        }
    }

    fn map(self, f: impl Fn(f64) -> f64) -> Interval {
        Interval {
            value: f(self.value),
            low: f(self.low),
            high: f(self.high),
        }
    }

    /// Square roots, of 0 where there is none.
    pub(super) fn root(self) -> Interval {
        self.map(|x| x.max(0.0).sqrt())
    }

    /// The mean of two independent ones that are equally well known.
    pub(super) fn and(self, other: Interval) -> Interval {
        let value = 0.5 * (self.value + other.value);
        let off = |of: fn(Interval) -> f64| 0.5 * of(self).hypot(of(other));
        Interval {
            value,
            low: value - off(|i| i.value - i.low),
            high: value + off(|i| i.high - i.value),
        }
    }

    /// The same of square roots, whose squares are averaged.
    pub(super) fn and_root(self, other: Interval) -> Interval {
        let [a, b] = [self, other].map(|root| root.map(|x| x * x));
        a.and(b).root()
    }

    /// In units of `whole`; 0 if that is nothing.
    pub(super) fn over(self, whole: f64) -> Interval {
        self.map(|x| if whole > 0.0 { x / whole } else { 0.0 })
    }
}

/// The mean of all, which is not negative, from estimates of a sample that may be: where noise makes theirs
/// negative, or too small, the upper bound is that of as much noise around 0, or around theirs.
pub(super) fn mean_square(sample: &[f64], random: &mut Pcg64Mcg) -> Interval {
    let mean = mean(sample, random);
    let least = mean.value.max(0.0) + DEVIATIONS * deviation(sample);
    Interval {
        high: mean.high.max(least),
        ..mean
    }
}

/// Standard deviation of the mean of a sample.
fn deviation(sample: &[f64]) -> f64 {
    let (sum, squares) = (sample.iter()).fold((0.0, 0.0), |(s, q), x| (s + x, q + x * x));
    deviation_of(sample.len() as f64, sum, squares)
}

fn deviation_of(n: f64, sum: f64, squares: f64) -> f64 {
    let mean = sum / n.max(1.0);
    let variance = (squares / n.max(1.0) - mean * mean).max(0.0);
    (variance / n.max(1.0)).sqrt()
}

/// The mean of all, from those of a sample.
pub(super) fn mean(sample: &[f64], random: &mut Pcg64Mcg) -> Interval {
    let n = sample.len();
    if n == 0 {
        return Interval::default();
    }
    let value = sample.iter().sum::<f64>() / n as f64;
    let own = deviation(sample);
    if own == 0.0 {
        return Interval::exactly(value);
    }
    // Bootstrap-t (Efron and Tibshirani 1993, chapter 12): how far the means of resamples are off
    // in units of their own deviation. A few large errors make the whole lopsided, which this knows.
    let mut off: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let (mut sum, mut squares) = (0.0, 0.0);
            for _ in 0..n {
                let x = sample[random.random_range(0..n)];
                sum += x;
                squares += x * x;
            }
            let mean = sum / n as f64;
            (mean - value) / deviation_of(n as f64, sum, squares).max(1e-3 * own)
        })
        .collect();
    off.sort_unstable_by(f64::total_cmp);
    let at = |part: f64| off[(part * (RESAMPLES - 1) as f64).round() as usize];
    Interval {
        value,
        low: value - at(0.95) * own,
        high: value - at(0.05) * own,
    }
}

/// Sorts values with their weights.
pub(super) fn sorted(values: impl Iterator<Item = f64>, weights: &[f64]) -> Vec<(f64, f64)> {
    let mut sample: Vec<(f64, f64)> = values.zip(weights.iter().copied()).collect();
    sample.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
    sample
}

/// The value below which a part of all lies, from a sorted sample of values with weights: the bounds are
/// order statistics.
pub(super) fn of(sorted: &[(f64, f64)], part: f64) -> Interval {
    let Some(&(largest, last)) = sorted.last() else {
        return Interval::default();
    };
    let whole: f64 = sorted.iter().map(|(_, weight)| weight).sum();
    let at = |wanted: f64| {
        let mut below = 0.0;
        let reached = |(_, weight): &&(f64, f64)| {
            below += weight;
            below >= wanted
        };
        sorted
            .iter()
            .find(reached)
            .map_or(largest, |(value, _)| *value)
    };
    let middle = part * whole;
    let value = at(middle);
    // Of what is below or above the value by chance.
    let square = |(x, weight): &(f64, f64)| {
        let off = if *x <= value { 1.0 - part } else { part };
        (weight * off).powi(2)
    };
    let spread = DEVIATIONS * sorted.iter().map(square).sum::<f64>().sqrt();
    Interval {
        value,
        low: at(middle - spread - last),
        high: at(middle + spread + last),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, stream};

    /// Noise alone, whose mean is below 0 by chance: nothing that is known as well as that.
    #[test]
    fn noise_is_no_small_error() {
        let sample: Vec<f64> = (0..400).map(|k| [-1.2, 1.0][k % 2]).collect();
        let random = || stream(1, Purpose::Verify, 0);
        let mean = mean(&sample, &mut random());
        let square = mean_square(&sample, &mut random());
        println!("{mean:?}, {square:?}");
        assert!(mean.value < 0.0 && mean.high < 0.0);
        // Of 400 with a deviation of 1.1.
        assert!((square.high / (DEVIATIONS * 1.1 / 20.0) - 1.0).abs() < 1e-6);
        assert_eq!((square.value, square.low), (mean.value, mean.low));
    }
}
