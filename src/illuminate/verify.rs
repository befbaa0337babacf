//! The error of a solution, measured.
//!
//! At some surfels, spread over the octree's order, the irradiance is compared with unbiased estimates
//! of what it should be: the exact sum over all points of what they emit and reflect in this very
//! solution, and the sky. Two independent estimates H', H'' at each make (H - H')·(H - H'') an
//! unbiased estimate of the squared error, however noisy they are, so that many surfels with few
//! segments each measure the error of all.
//!
//! That is the error of one application of the operator, r = H - L - F(E + ρH). The error of the
//! solution is (I - Fρ)⁻¹ r = r + G r: what is wrong is reflected on as light is.

use std::time::Instant;

use glam::{DVec3, Vec3};
use rand_pcg::Pcg64Mcg;

use super::amplified::{Amplified, amplified};
pub use super::measured::{Claim, Measured};
use super::measured::{DARK, Off, Part};
use super::quantiles::{self, Interval};
use super::receivers::Receivers;
pub use super::verified::{Errors, Verified};
use crate::error::Result;
use crate::expansion::Surface;
use crate::lights::visible_sky;
use crate::octree::Octree;
use crate::operator::{Draw, Sampler, TransportOperator, exact_irradiances};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, stream};
use crate::visibility::Visibility;

/// What a solution is verified with.
pub struct Verifier<'a> {
    pub surfels: &'a Surfels,
    pub octree: &'a Octree,
    pub visibility: &'a dyn Visibility,
    pub sky: Vec3,
    /// For each surfel of a fitted surface what its light of the sky is divided by; empty of others.
    pub scale: &'a [f32],
    /// Relative error that is to be told from none.
    pub tolerance: f64,
    pub seed: u64,
}

/// What errors of ambient light count on a fitted surface. Noise, edges and holes leave 4 to 15% of all light
/// unknown there.
const FITTED: f64 = 1.0 / 3.0;
/// Surfels that are looked at, at most and at least.
pub(super) const RECEIVERS: [usize; 2] = [30_000, 200];
/// Fewest of them for which exact sums are taken.
const EXACT: usize = 1000;
/// Draws of an estimate, on average, at a tolerance of 0.03: its noise should be as large as the error.
const DRAWS: f64 = 48.0;
/// That is for noise of one draw of light from surfels; for light of the sky, if one direction has this, relative to
/// all that comes from all around.
const SKY_NOISE: f64 = 0.5;
/// What two pilots of the sky differ by, in units of the noise of one direction.
const PILOT_SKY: f64 = 0.5;
/// Draws of the two estimates each that tell where more are needed.
const PILOT: u32 = 6;
/// Fewest and most draws of an estimate.
const COUNTS: [f64; 2] = [4.0, 8192.0];
/// Part of the draws that goes to the surfels with the largest errors.
const AGAIN: f64 = 0.15;
/// Part of the draws that goes to where noise is large for the light there, the rest to where it is large.
const RELATIVE: f64 = 0.25;

/// What is estimated one by one.
#[derive(Clone, Copy, PartialEq)]
enum Light {
    Reflected,
    Emitted,
    Sky,
}

impl Verifier<'_> {
    /// Compares a solution with estimates that take about `budget` segments. Another `round` looks
    /// afresh.
    pub fn measure(
        &self,
        claim: &Claim,
        budget: u64,
        round: u64,
        progress: &dyn Progress,
    ) -> Result<Measured> {
        let start = Instant::now();
        progress.stage("verification", 1);
        let n = self.surfels.len();
        let exact_rows = match self.visibility.is_open() {
            true => (40 + (1 << 22) / n.max(1)).min(RECEIVERS[1]),
            false => 2 * budget as usize / n.max(1),
        };
        let exact = exact_rows.min(n) >= EXACT.min(n) || self.visibility.is_open();
        let lights = self.kinds(claim);
        let count = match exact {
            true => exact_rows.min(RECEIVERS[0]),
            false => {
                let draws: f64 = lights.iter().map(|light| self.draws(claim, *light)).sum();
                let count = (1.0 - AGAIN) * budget as f64 / (2.0 * draws.max(1.0));
                (count as usize).clamp(RECEIVERS[1], RECEIVERS[0])
            }
        };
        let mut random = stream(self.seed, Purpose::Verify, round << 8);
        let receivers = Receivers::choose(claim, count, &mut random);
        let mut measured = Measured {
            segments: 0,
            start,
            off: [(); 2].map(|()| vec![Off::default(); receivers.len()]),
            best: Vec::new(),
            receivers,
        };
        match exact {
            true => self.exactly(claim, budget, &mut measured)?,
            false => self.by_samples(claim, &lights, budget, round, &mut measured)?,
        }
        progress.check()?;
        progress.advance(1);
        Ok(measured)
    }

    /// Draws of an estimate of a light that make its noise about as large as the error.
    fn draws(&self, claim: &Claim, light: Light) -> f64 {
        // The noise falls as draws^(-3/4).
        let finer = |noise: f64| (noise * 0.03 / self.tolerance).powf(4.0 / 3.0);
        match light {
            Light::Reflected | Light::Emitted => DRAWS * finer(1.0).max(0.7),
            Light::Sky => {
                let n = claim.irradiance.len().max(1) as f64;
                let noises = (0..claim.irradiance.len()).map(|i| self.sky_noise(claim, i).powi(2));
                let noise = (noises.sum::<f64>() / n).sqrt() / claim.level(Part::Ambient).0;
                DRAWS * finer(noise / SKY_NOISE).max(0.7)
            }
        }
    }

    /// Standard deviation of what one direction brings of the sky.
    fn sky_noise(&self, claim: &Claim, i: usize) -> f64 {
        let sky = self.sky.as_dvec3();
        let seen = (claim.sky[i].element_sum() / sky.element_sum()).clamp(0.0, 1.0);
        sky.length() * (seen * (1.0 - seen)).sqrt()
    }

    /// Lights that are not exact.
    fn kinds(&self, claim: &Claim) -> Vec<Light> {
        let some = |light: &[DVec3]| light.iter().any(|b| *b != DVec3::ZERO);
        let shines = self.surfels.emission.iter().any(|e| *e != Vec3::ZERO);
        [
            (Light::Reflected, some(claim.reflected)),
            (Light::Emitted, shines),
            (Light::Sky, self.sky != Vec3::ZERO),
        ]
        .into_iter()
        .filter_map(|(light, is_there)| is_there.then_some(light))
        .collect()
    }

    /// What is wrong with a light, if this is what it should be.
    fn off(&self, claim: &Claim, i: u32, light: Light, truth: DVec3) -> Off {
        let i = i as usize;
        let mut off = Off::default();
        match light {
            Light::Reflected => off.reflected = claim.irradiance[i] - claim.lights[i] - truth,
            Light::Emitted => off.emitted = -truth,
            Light::Sky => off.sky = -truth,
        }
        off
    }

    fn exactly(&self, claim: &Claim, budget: u64, measured: &mut Measured) -> Result<()> {
        let emission: Vec<DVec3> = self.surfels.emission.iter().map(|e| e.as_dvec3()).collect();
        let rows: Vec<usize> = measured
            .receivers
            .surfels
            .iter()
            .map(|&i| i as usize)
            .collect();
        let fields = [claim.reflected, emission.as_slice()];
        if fields
            .iter()
            .flat_map(|f| f.iter())
            .any(|b| *b != DVec3::ZERO)
        {
            let sums = exact_irradiances(self.surfels, self.visibility, &rows, fields)?;
            measured.segments += (rows.len() * self.surfels.len() / 2) as u64;
            for (k, ([reflected, emitted], _)) in sums.into_iter().enumerate() {
                let i = measured.receivers.surfels[k];
                let mut off = self.off(claim, i, Light::Reflected, reflected);
                off.add(self.off(claim, i, Light::Emitted, emitted));
                for half in &mut measured.off {
                    half[k].add(off);
                }
            }
        }
        if self.sky != Vec3::ZERO {
            let count = (budget as f64 / (2 * rows.len().max(1)) as f64).clamp(16.0, 4096.0);
            let counts = vec![count; rows.len()];
            for half in 0..2 {
                let skies = self.sky(&measured.receivers.surfels, &counts, |k| {
                    self.random(k, half)
                })?;
                measured.segments += (rows.len() as f64 * count) as u64;
                for (off, sky) in measured.off[half as usize].iter_mut().zip(skies) {
                    off.sky -= sky;
                }
            }
        }
        measured.close(claim);
        measured.best = measured.mean();
        Ok(())
    }

    fn by_samples(
        &self,
        claim: &Claim,
        lights: &[Light],
        budget: u64,
        round: u64,
        measured: &mut Measured,
    ) -> Result<()> {
        let surface = Surface::new(self.surfels);
        let emission: Vec<DVec3> = self.surfels.emission.iter().map(|e| e.as_dvec3()).collect();
        let samplers = lights.iter().map(|light| match light {
            Light::Reflected => Some(claim.reflected),
            Light::Emitted => Some(emission.as_slice()),
            Light::Sky => None,
        });
        let samplers: Vec<Option<Sampler>> = samplers
            .map(|field| {
                field.map(|field| Sampler::new(self.octree, self.surfels, &surface, field))
            })
            .collect();
        let receivers = measured.receivers.surfels.clone();
        let mut segments = 0;
        // Two estimates of each light at some receivers, each with its number of draws.
        let mut estimates = |some: &[usize], counts: &[Vec<f64>], phase: u64| {
            let chosen: Vec<u32> = some.iter().map(|&k| receivers[k]).collect();
            let mut found: Vec<Vec<[DVec3; 2]>> = Vec::with_capacity(lights.len());
            for (l, sampler) in samplers.iter().enumerate() {
                let item = round << 8 | phase << 3 | (l as u64) << 1;
                let random = |half: u64| move |k: usize| self.random(some[k], item | half);
                let counts: Vec<f64> = some.iter().map(|&k| counts[l][k]).collect();
                segments += 2 * counts.iter().sum::<f64>() as u64;
                found.push(match sampler {
                    Some(sampler) => {
                        let draws: Vec<Draw> = (chosen.iter().zip(&counts))
                            .map(|(&receiver, &count)| Draw {
                                receiver,
                                count: count as u32,
                            })
                            .collect();
                        sampler.estimate(&draws, random(0), self.visibility)?
                    }
                    None => {
                        let once = self.sky(&chosen, &counts, random(0))?;
                        let again = self.sky(&chosen, &counts, random(1))?;
                        once.into_iter().zip(again).map(<[_; 2]>::from).collect()
                    }
                });
            }
            Ok::<_, crate::Error>(found)
        };
        let all: Vec<usize> = (0..receivers.len()).collect();
        let pilot_counts = vec![vec![f64::from(PILOT); receivers.len()]; lights.len()];
        let pilot = estimates(&all, &pilot_counts, 1)?;
        let left = budget as f64 - 2.0 * (lights.len() * receivers.len()) as f64 * f64::from(PILOT);
        let shares = self.shares(claim, lights, &measured.receivers, &pilot);
        let counts = |draws: f64| -> Vec<Vec<f64>> {
            let count = |share: &f64| (share * draws).clamp(COUNTS[0], COUNTS[1]).round();
            let of_light = |shares: &Vec<f64>| shares.iter().map(count).collect();
            shares.iter().map(of_light).collect()
        };
        let found = estimates(&all, &counts(0.5 * (1.0 - AGAIN) * left), 2)?;
        for (&light, found) in lights.iter().zip(found) {
            for (k, truths) in found.into_iter().enumerate() {
                for (half, truth) in truths.into_iter().enumerate() {
                    measured.off[half][k].add(self.off(claim, receivers[k], light, truth));
                }
            }
        }
        measured.close(claim);
        measured.best = measured.mean();
        // The largest of many noisy errors have the largest noise: they are measured afresh.
        let again = measured.largest(claim);
        if !again.is_empty() {
            let taken: f64 = shares
                .iter()
                .flat_map(|s| again.iter().map(|&k| s[k]))
                .sum();
            let counts = counts(0.5 * AGAIN * left / taken.max(f64::MIN_POSITIVE));
            let found = estimates(&again, &counts, 3)?;
            for &k in &again {
                measured.best[k] = claim.of_lights(receivers[k]);
            }
            for (&light, found) in lights.iter().zip(found) {
                for (&k, [a, b]) in again.iter().zip(found) {
                    let truth = 0.5 * (a + b);
                    measured.best[k].add(self.off(claim, receivers[k], light, truth));
                }
            }
        }
        measured.segments = segments;
        Ok(())
    }

    /// Which part of all draws goes to which light at which receiver: in proportion to the noise that
    /// the pilots show, some of them to its size and some to that relative to the light there.
    fn shares(
        &self,
        claim: &Claim,
        lights: &[Light],
        Receivers {
            surfels, weights, ..
        }: &Receivers,
        pilot: &[Vec<[DVec3; 2]>],
    ) -> Vec<Vec<f64>> {
        let level = |light: Light| match light {
            Light::Emitted => claim.level(Part::Total),
            _ => claim.level(Part::Ambient),
        };
        let mut shares = vec![vec![0.0; surfels.len()]; lights.len()];
        for (relative, part) in [(false, 1.0 - RELATIVE), (true, RELATIVE)] {
            let mut noises = shares.clone();
            for (l, &light) in lights.iter().enumerate() {
                let (rms, mean) = level(light);
                for (k, &i) in surfels.iter().enumerate() {
                    let [a, b] = pilot[l][k];
                    let differ = match light {
                        // Few directions tell less of it than what is claimed.
                        Light::Sky => PILOT_SKY * self.sky_noise(claim, i as usize),
                        _ => (a - b).length(),
                    };
                    let noise = differ + 0.1 * (a + b).length() + 0.02 * rms;
                    let scale = match relative {
                        true => claim.irradiance[i as usize].length().max(DARK * mean),
                        false => rms,
                    };
                    noises[l][k] = weights[k].sqrt() * noise / scale.max(f64::MIN_POSITIVE);
                }
            }
            let total: f64 = noises.iter().flatten().sum();
            for (share, noise) in shares.iter_mut().flatten().zip(noises.iter().flatten()) {
                *share += part * noise / total.max(f64::MIN_POSITIVE);
            }
        }
        shares
    }

    /// What is drawn for the `k`-th receiver.
    fn random(&self, k: usize, item: u64) -> Pcg64Mcg {
        let item = (k as u64) << 32 | 1 << 31 | item;
        stream(self.seed, Purpose::Verify, item)
    }

    /// Light from the sky at some surfels, in about so many directions each.
    fn sky(
        &self,
        receivers: &[u32],
        counts: &[f64],
        random: impl Fn(usize) -> Pcg64Mcg + Sync,
    ) -> Result<Vec<DVec3>> {
        // Squares of powers of two, so that surfels can be taken together.
        let strata = |count: f64| 1_usize << (count.max(4.0).log2() / 2.0).round() as u32;
        let mut skies = vec![DVec3::ZERO; receivers.len()];
        for level in 1..=6 {
            let some: Vec<usize> = (0..receivers.len())
                .filter(|&k| strata(counts[k]).min(64) == 1 << level)
                .collect();
            let chosen: Vec<u32> = some.iter().map(|&k| receivers[k]).collect();
            let random = |k: usize| random(some[k]);
            let shares = visible_sky(self.surfels, &chosen, 1 << level, random, self.visibility)?;
            for (k, share) in some.into_iter().zip(shares) {
                let scale = self.scale.get(receivers[k] as usize).unwrap_or(&1.0);
                skies[k] = self.sky.as_dvec3() * share / f64::from(*scale);
            }
        }
        Ok(skies)
    }

    /// Puts what was measured into numbers; `operator` carries errors on to further bounces.
    pub fn judge<O: TransportOperator>(
        &self,
        claim: &Claim,
        measured: &Measured,
        operator: Option<&O>,
        bounces: Option<u32>,
        progress: &dyn Progress,
    ) -> Result<Verified> {
        let [a, b] = measured.grey(Part::Total);
        let carried = match operator {
            Some(operator) => Some(amplified(
                operator,
                self.surfels,
                &measured.receivers,
                [&a, &b],
                bounces,
                self.seed,
                progress,
            )?),
            None => None,
        };
        let errors = |part| self.errors(claim, measured, part, carried.as_ref());
        let reflected = claim.level(Part::Reflected).0 > 0.0;
        let mut verified = Verified {
            receivers: measured.receivers.len(),
            segments: measured.segments,
            tolerance: self.tolerance,
            met: false,
            total: errors(Part::Total),
            direct: self.errors(claim, measured, Part::Direct, None).one_bounce,
            ambient: errors(Part::Ambient).rel_l2,
            reflected: reflected.then(|| errors(Part::Reflected)),
            part_reflected: claim.level(Part::Reflected).0
                / claim.level(Part::Ambient).0.max(f64::MIN_POSITIVE),
            ambient_counts: if self.scale.is_empty() { 1.0 } else { FITTED },
            seconds: measured.start.elapsed().as_secs_f64(),
        };
        verified.judge_by(self.tolerance);
        Ok(verified)
    }

    fn errors(
        &self,
        claim: &Claim,
        measured: &Measured,
        part: Part,
        carried: Option<&Amplified>,
    ) -> Errors {
        let (rms, mean) = claim.level(part);
        if rms == 0.0 {
            return Errors::default();
        }
        let [a, b] = measured.off.each_ref().map(|off| part.of(off));
        let receivers = &measured.receivers;
        let both = || a.iter().zip(&b);
        let squares = receivers.weighted(both().map(|(a, b)| a.dot(*b)));
        let signed = receivers.weighted(both().map(|(a, b)| (*a + *b).element_sum() / 2.0));
        let mut random = stream(self.seed, Purpose::Verify, 0);
        let complete = measured.is_complete(claim);
        type Mean = fn(&[f64], &mut Pcg64Mcg) -> Interval;
        let mut known = |sample: &[f64], mean: Mean| match complete {
            true => Interval::exactly(sample.iter().sum::<f64>() / sample.len() as f64),
            false => mean(sample, &mut random),
        };
        let one_bounce = known(&squares, quantiles::mean_square).root().over(rms);
        let sum: f64 = claim.sum(part);
        let relative = (receivers.surfels.iter().zip(part.of(&measured.best))).map(|(&i, off)| {
            let truth = claim.part(part, i as usize) - off;
            off.length() / truth.length().max(DARK * mean)
        });
        let sorted = quantiles::sorted(relative, &receivers.weights);
        let rel_l2 = match carried {
            None => one_bounce,
            Some(carried) => {
                let [a, b] = measured.grey(part);
                carried.added_to(one_bounce, receivers, [&a, &b], claim.grey(part))
            }
        };
        let quantile = |part| match (complete, quantiles::of(&sorted, part)) {
            (true, known) => Interval::exactly(known.value),
            (false, known) => known,
        };
        Errors {
            one_bounce,
            rel_l2,
            median: quantile(0.5),
            p95: quantile(0.95),
            p99: quantile(0.99),
            max: sorted.last().map_or(0.0, |(off, _)| *off),
            bias: known(&signed, quantiles::mean).over(sum),
        }
    }
}
