//! What is held against each other when a solution is verified: what it claims, and what was measured.

use std::time::Instant;

use glam::DVec3;

use super::receivers::Receivers;

/// Part of the receivers that have the largest errors and are measured again.
const LARGEST: f64 = 0.06;
/// Darkest irradiance, relative to the mean, that errors are taken relative to.
pub(super) const DARK: f64 = 0.01;

/// A solution that is to be verified; all fields in the octree's order.
pub struct Claim<'a> {
    pub irradiance: &'a [DVec3],
    /// The part of it that comes straight from lights.
    pub lights: &'a [DVec3],
    /// The part of that which is sampled: from sky and shining surfels.
    pub sampled: &'a [DVec3],
    /// The part of that which comes from the sky.
    pub sky: &'a [DVec3],
    /// Reflected radiosity that makes the rest of it.
    pub reflected: &'a [DVec3],
}

/// Differences between a solution and estimates of it at one receiver.
#[derive(Clone, Copy, Default, PartialEq)]
pub(super) struct Off {
    /// Of light straight from shining surfels.
    pub(super) emitted: DVec3,
    pub(super) sky: DVec3,
    pub(super) reflected: DVec3,
}

/// Differences found, not yet put into numbers.
pub struct Measured {
    pub(super) receivers: Receivers,
    pub(super) segments: u64,
    pub(super) start: Instant,
    /// From two independent estimates.
    pub(super) off: [Vec<Off>; 2],
    /// The best known, for quantiles.
    pub(super) best: Vec<Off>,
}

/// What errors are taken of.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Part {
    Total,
    Reflected,
    /// What comes from all around: reflected light and that of the sky.
    Ambient,
    /// What is sampled of the light straight from lights, in units of the whole.
    Direct,
}

impl Part {
    pub(super) fn of(self, off: &[Off]) -> Vec<DVec3> {
        let of = |off: &Off| match self {
            Part::Total => off.emitted + off.sky + off.reflected,
            Part::Reflected => off.reflected,
            Part::Ambient => off.sky + off.reflected,
            Part::Direct => off.emitted + off.sky,
        };
        off.iter().map(of).collect()
    }
}

impl Claim<'_> {
    /// The sampled light straight from lights at a surfel.
    pub(super) fn of_lights(&self, i: u32) -> Off {
        let i = i as usize;
        Off {
            emitted: self.sampled[i] - self.sky[i],
            sky: self.sky[i],
            reflected: DVec3::ZERO,
        }
    }

    pub(super) fn part(&self, part: Part, i: usize) -> DVec3 {
        match part {
            Part::Total | Part::Direct => self.irradiance[i],
            Part::Reflected => self.irradiance[i] - self.lights[i],
            Part::Ambient => self.irradiance[i] - self.lights[i] + self.sky[i],
        }
    }

    pub(super) fn all(&self, part: Part) -> impl Iterator<Item = DVec3> {
        (0..self.irradiance.len()).map(move |i| self.part(part, i))
    }

    /// Root mean square of the length of a part, and the mean.
    pub(super) fn level(&self, part: Part) -> (f64, f64) {
        let n = self.irradiance.len().max(1) as f64;
        let (square, sum) = self.all(part).fold((0.0, 0.0), |(square, sum), h| {
            (square + h.length_squared(), sum + h.length())
        });
        ((square / n).sqrt(), sum / n)
    }

    /// Mean of all channels together.
    pub(super) fn sum(&self, part: Part) -> f64 {
        let n = self.irradiance.len().max(1) as f64;
        self.all(part).map(|h| h.element_sum()).sum::<f64>() / n
    }

    /// Root mean square of the mean of the channels.
    pub(super) fn grey(&self, part: Part) -> f64 {
        let n = self.irradiance.len().max(1) as f64;
        let square: f64 = self
            .all(part)
            .map(|h| (h.element_sum() / 3.0).powi(2))
            .sum();
        (square / n).sqrt()
    }
}

impl Off {
    pub(super) fn add(&mut self, other: Off) {
        self.emitted += other.emitted;
        self.sky += other.sky;
        self.reflected += other.reflected;
    }
}

impl Measured {
    /// Whether the error of every surfel is known: there is no chance in it.
    pub(super) fn is_complete(&self, claim: &Claim) -> bool {
        let [a, b] = &self.off;
        self.receivers.len() == claim.irradiance.len() && a == b
    }

    /// What was claimed of the sampled lights, of which so far only the truth was taken off.
    pub(super) fn close(&mut self, claim: &Claim) {
        for off in &mut self.off {
            for (off, &i) in off.iter_mut().zip(&self.receivers.surfels) {
                off.add(claim.of_lights(i));
            }
        }
    }

    /// Means of the channels of both estimates of an error.
    pub(super) fn grey(&self, part: Part) -> [Vec<f64>; 2] {
        let grey = |off: DVec3| off.element_sum() / 3.0;
        let of = |off: &Vec<Off>| part.of(off).into_iter().map(grey).collect();
        self.off.each_ref().map(of)
    }

    pub(super) fn mean(&self) -> Vec<Off> {
        let [a, b] = &self.off;
        let mean = |(a, b): (&Off, &Off)| Off {
            emitted: 0.5 * (a.emitted + b.emitted),
            sky: 0.5 * (a.sky + b.sky),
            reflected: 0.5 * (a.reflected + b.reflected),
        };
        a.iter().zip(b).map(mean).collect()
    }

    /// The receivers with the largest errors of either part.
    pub(super) fn largest(&self, claim: &Claim) -> Vec<usize> {
        let count = (LARGEST * self.receivers.len() as f64).ceil() as usize;
        let mut chosen = Vec::new();
        for part in [Part::Total, Part::Ambient] {
            let mean = claim.level(part).1;
            let off = part.of(&self.best);
            let relative = |k: usize| {
                let light = claim
                    .part(part, self.receivers.surfels[k] as usize)
                    .length();
                off[k].length() / light.max(DARK * mean).max(f64::MIN_POSITIVE)
            };
            let mut order: Vec<usize> = (0..off.len()).collect();
            order.sort_by(|&a, &b| relative(b).total_cmp(&relative(a)).then(a.cmp(&b)));
            chosen.extend(order.into_iter().take(count));
        }
        chosen.sort_unstable();
        chosen.dedup();
        chosen
    }
}
