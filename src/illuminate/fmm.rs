//! The way by links: made, verified, and refined until the tolerance is met.

use std::borrow::Cow;
use std::f64::consts::FRAC_1_SQRT_2;
use std::time::Instant;

use glam::DVec3;

use super::even::even;
use super::linked::Linked;
use super::model::{Lit, model_error};
use super::task::{DirectLight, ROUGH_ERROR, ROUGH_RESIDUAL, Solved, Task, counts};
use super::verified::Verified;
use super::verify::{Claim, RECEIVERS, Verifier};
use super::work::{Bounced, Work};
use crate::error::{Error, Result};
use crate::links::{Links, SLACK};
use crate::operator::Fmm;
use crate::solve::Stop;
use crate::visibility::Visibility;

/// Allowed error of a link with tested visibility, in units of the tolerance and the mean irradiance,
/// to begin with.
const ERROR_A_LINK: f64 = 0.25;
/// Allowed error of all links without tests, in these units: bounces add to it. (A second round takes as long as
/// the first one; half of the error, a fifth more.)
const UNTESTED: f64 = 0.5;
/// Links are made at most so many times.
const ROUNDS: u64 = 8;
/// Part of the segments of a solution that its verification may test in a round, at a first look and at a
/// second one.
const VERIFICATION: f64 = 0.05;
/// All pairs of a small cloud are summed at a second look where the first one leaves it open whether the error is
/// small enough, if they are no more than so many times what that may test: a third of the solution's.
const ALL_PAIRS: u64 = 7;
/// Segments that it may test in any case.
const LEAST_SEGMENTS: u64 = 1 << 17;
/// The error falls as this power of what a link may be off by: measured are 0.3 to 0.55 with
/// occlusion. Without, errors are those of expansions.
const POWER: [f64; 2] = [0.45, 1.0];
/// Part of the error of the model below which nothing is refined.
const OF_MODEL: f64 = 1.0 / 3.0;
/// A refinement that leaves more than this part of the error was in vain.
const STUCK: f64 = 0.95;
/// What a refinement aims at, in units of what would just do.
const AIM: f64 = 0.9;
/// Bounds of the factor on what is allowed from one round to the next.
const STEP: [f64; 2] = [0.03, 0.7];
/// The error of sampled lights falls as this power of their tolerance on rough surfaces.
const LIGHTS_POWER: f64 = 0.7;
/// Smaller tolerances of lights than this one find no more.
pub(super) const FINEST_LIGHTS: f64 = 5e-4;
/// Largest such factor without occlusion, where a round costs next to nothing, and errors fall by steps.
const OPEN_STEP: f64 = 0.35;

/// What decides on the error of a solution.
#[derive(Clone, Copy, Debug)]
struct Effort {
    /// Error that a link may make, relative to the mean irradiance.
    links: f64,
    /// Tolerance of the sampled lights.
    lights: f64,
}

impl Task<'_> {
    /// Lights per surfel, then links for what is reflected, refined where those that are kept are not
    /// good enough: a rough solution says where light is strong and where it is weak, and the measured
    /// error whether the tolerance is kept.
    pub fn fmm(&self, linked: &mut Linked, repairs: &mut Vec<String>) -> Result<Solved> {
        let mut effort = Effort {
            links: match self.untested {
                true => UNTESTED * self.tolerance,
                false => ERROR_A_LINK * self.tolerance,
            },
            lights: self.tolerance,
        };
        let (surfels, visibility) = (self.surfels, self.visibility);
        // What is not tested is not sampled.
        let smoother = match self.untested {
            true => None,
            false => Some(self.smoother()?),
        };
        let smoother = smoother.as_ref();
        let stages = self.stages;
        let (mut direct, mended) = stages.next(|| {
            let mut mended = Vec::new();
            let direct = self.direct_light(effort.lights, None, smoother, &mut mended)?;
            Ok((direct, mended))
        })?;
        repairs.extend(mended);
        let mut seconds = 0.0;
        let mut solve = |linked: &mut Linked, work: &Work| {
            let clock = Instant::now();
            let bounced = linked.solve(self, work)?;
            seconds += clock.elapsed().as_secs_f64();
            Ok::<_, Error>(bounced)
        };
        let dark = direct.irradiance.iter().all(|h| *h == DVec3::ZERO);
        let mut before = match dark || !self.reflects() {
            true => None,
            false => Some(stages.next(|| self.rough(&direct, linked, &mut solve))?),
        };
        let mut history: Vec<(f64, f64)> = Vec::new();
        let mut best: Option<Solved> = None;
        let (mut verification, mut in_vain) = (0.0, 0);
        let mut tested = 0;
        for round in 0..ROUNDS {
            let found = before.as_ref().map(|before| {
                let irradiance = Some(before.irradiance.as_slice());
                let accuracy = self.accuracy(&before.reflected, irradiance, effort.links);
                linked.refine_in_stage(self, &accuracy, if round == 0 { SLACK } else { 1.0 })?;
                stages.next(|| {
                    let start = Some(before.reflected.as_slice());
                    let work = self.work(&direct.irradiance, start, self.stop());
                    let bounced = solve(linked, &work)?;
                    let noise = effort.links / ERROR_A_LINK;
                    Ok(match smoother {
                        None => bounced,
                        Some(smoother) => {
                            even(bounced, surfels, smoother, &direct.irradiance, noise)
                        }
                    })
                })
            });
            let found = match (found.transpose(), &best) {
                (Err(Error::TooLarge(why)), Some(_)) => {
                    self.progress.note(&format!("no further refinement: {why}"));
                    break;
                }
                (found, _) => found?,
            };
            let clock = Instant::now();
            let claimed = found.as_ref().map(|bounced| (linked.links(), bounced));
            let model = best.as_ref().and_then(|last| last.model_error);
            let segments = [visibility.segments(), tested];
            let (verified, model) =
                stages.next(|| self.verify_round(&direct, claimed, segments, model, round))?;
            tested += verified.segments;
            verification += clock.elapsed().as_secs_f64();
            self.progress.note(&format!(
                "links within {:.1e}, lights within {:.1e}: {verified}",
                effort.links, effort.lights
            ));
            let solved = match &found {
                None => Solved::without_reflection(direct.irradiance.clone()),
                Some(bounced) => Solved {
                    direct: direct.irradiance.clone(),
                    irradiance: bounced.irradiance.clone(),
                    ended: bounced.ended,
                    checked: bounced.checked,
                    links: counts(linked.links()),
                    ..Solved::default()
                },
            };
            let ended = solved.ended;
            let last = best.take().and_then(|last: Solved| last.verified);
            // Bounds are noisy: two refinements that gained nothing count.
            let gained = last.is_none_or(|last| verified.bound() <= STUCK * last.bound());
            in_vain = if gained { 0 } else { in_vain + 1 };
            best = Some(Solved {
                verified: Some(verified),
                model_error: model,
                in_vain: self.untested && !verified.met,
                ..solved
            });
            if verified.met || in_vain == 2 || !ended.converged || round + 1 == ROUNDS {
                break;
            }
            let reflected = verified.reflected.map_or(0.0, |r| r.rel_l2.value);
            history.push((effort.links, reflected));
            let last = effort;
            effort = effort.refined(&verified, &history, self.untested);
            before = found;
            if effort.lights < last.lights {
                direct = stages.next(|| {
                    let seen = Some(direct.seen.clone());
                    self.direct_light(effort.lights, seen, smoother, &mut Vec::new())
                })?;
            }
        }
        Ok(Solved {
            seconds,
            verification,
            ..best.unwrap_or_default()
        })
    }

    /// A first solution, by the links that are kept or by rough ones.
    fn rough(
        &self,
        direct: &DirectLight,
        linked: &mut Linked,
        solve: &mut impl FnMut(&mut Linked, &Work) -> Result<Bounced>,
    ) -> Result<Bounced> {
        let lights = &direct.irradiance;
        let stop = Stop {
            residual: ROUGH_RESIDUAL,
            bounces: None,
        };
        let work = Work {
            checked: None,
            ..self.work(lights, None, stop)
        };
        if !linked.is_none() {
            return solve(linked, &work);
        }
        let ambient: DVec3 = lights.iter().sum::<DVec3>() / lights.len() as f64;
        let guess: Vec<DVec3> = (lights.iter().zip(&self.surfels.reflectance))
            .map(|(h, r)| r.as_dvec3() * (*h + ambient))
            .collect();
        let mut rough = linked.rough(self);
        rough.refine(self, &self.accuracy(&guess, None, ROUGH_ERROR), 1.0)?;
        solve(&mut rough, &work)
    }

    /// The error of a round, and that of the model, which the first round finds out. `segments` are those that
    /// the solution took, and those that verified rounds before.
    pub(super) fn verify_round(
        &self,
        direct: &DirectLight,
        found: Option<(&Links, &Bounced)>,
        [segments, tested]: [u64; 2],
        model: Option<f64>,
        round: u64,
    ) -> Result<(Verified, Option<f64>)> {
        let budget = budget(segments, tested);
        let look = |again: u64, budget| self.verify(direct, found, budget, 2 * round + again);
        let mut verified = look(0, budget)?;
        let model = match round {
            0 => {
                let bounced = found.map(|(_, bounced)| bounced);
                self.model_error(direct, bounced, verified.total.one_bounce.value)?
            }
            _ => model,
        };
        let tolerance = match model {
            Some(model) if !self.below_model => self.tolerance.max(OF_MODEL * model),
            _ => self.tolerance,
        };
        verified.judge_by(tolerance);
        // Where the error is small enough, but not known well enough, to look at more points is cheaper than
        // to make it smaller.
        let unknown = (verified.bound() - verified.error()) * FRAC_1_SQRT_2;
        let closer = verified.receivers < RECEIVERS[0].min(self.surfels.len());
        let worth = closer && !self.visibility.is_open();
        let n = self.surfels.len() as u64;
        let all_pairs = n * n / 2;
        if !verified.met
            && worth
            && all_pairs <= ALL_PAIRS * self::budget(segments, 0)
            && verified.least() <= tolerance
        {
            verified = look(1, all_pairs)?;
            verified.judge_by(tolerance);
        } else if !verified.met && worth && verified.error() + unknown <= tolerance {
            verified = verified.and(&look(1, budget)?);
            verified.judge_by(tolerance);
        }
        Ok((verified, model))
    }

    /// Reflected radiosity that makes the irradiance of a solution.
    fn reflected<'b>(&self, bounced: Option<&'b Bounced>) -> Cow<'b, [DVec3]> {
        match (bounced, self.max_bounces) {
            (None, _) => vec![DVec3::ZERO; self.surfels.len()].into(),
            (Some(bounced), Some(_)) => bounced.sent.as_slice().into(),
            (Some(bounced), None) => bounced.reflected.as_slice().into(),
        }
    }

    /// What the number of points allows, where something is in the way: `error` is that of the
    /// solution.
    fn model_error(
        &self,
        direct: &DirectLight,
        bounced: Option<&Bounced>,
        error: f64,
    ) -> Result<Option<f64>> {
        if self.visibility.is_open() {
            return Ok(None);
        }
        let emission = self.surfels.emission.iter().map(|e| e.as_dvec3());
        let reflected = self.reflected(bounced);
        let radiosity: Vec<DVec3> = emission.zip(&*reflected).map(|(e, r)| e + *r).collect();
        let lit = Lit {
            scene: self.scene,
            surfels: self.surfels,
            irradiance: bounced.map_or(&direct.irradiance, |b| &b.irradiance),
            radiosity: &radiosity,
            seed: self.seed,
        };
        model_error(&lit, error)
    }

    /// How far a solution is from the point truth; without links it is light straight from the lights.
    fn verify(
        &self,
        direct: &DirectLight,
        found: Option<(&Links, &Bounced)>,
        budget: u64,
        round: u64,
    ) -> Result<Verified> {
        let verifier = Verifier {
            surfels: self.surfels,
            octree: self.octree,
            visibility: self.visibility.inner(),
            sky: self.scene.sky,
            scale: self.holes.scale(),
            tolerance: self.tolerance,
            seed: self.seed,
        };
        let bounced = found.map(|(_, bounced)| bounced);
        let claim = Claim {
            irradiance: bounced.map_or(&direct.irradiance, |b| &b.irradiance),
            lights: &direct.irradiance,
            sampled: &direct.sampled,
            sky: &direct.sky,
            reflected: &self.reflected(bounced),
        };
        let measured = verifier.measure(&claim, budget, round, self.progress)?;
        let operator = found.map(|(links, _)| Fmm::<f32>::new(self.surfels, self.octree, links));
        let bounces = self.max_bounces.map(|bounces| bounces.saturating_sub(1));
        verifier.judge(&claim, &measured, operator.as_ref(), bounces, self.progress)
    }
}

/// Segments that one look may test to verify what took so many; rounds before have tested some.
fn budget(segments: u64, tested: u64) -> u64 {
    let left = VERIFICATION * segments as f64 - 0.5 * tested as f64;
    (left as u64).max(LEAST_SEGMENTS)
}

/// Factor on the tolerance of lights whose error is so many times too large.
pub(super) fn finer_lights(wrong: f64) -> f64 {
    wrong.powf(-1.0 / LIGHTS_POWER).clamp(0.3, 0.8)
}

impl Effort {
    /// What should meet the tolerance, after rounds that did not: `history` has their allowed errors of
    /// links and the errors that came of them.
    fn refined(self, verified: &Verified, history: &[(f64, f64)], open: bool) -> Effort {
        let mut next = self;
        // How much smaller an error has to be, so that its upper bound, too, is within the tolerance.
        let too_large = |error: f64| error / (AIM * verified.tolerance);
        // A bound that is missed by little asks for a little more.
        let all = too_large(verified.likely()).max(1.0 / AIM);
        let (by_lights, by_links) = match verified.by_lights() && self.lights > FINEST_LIGHTS {
            true => (all, too_large(verified.by_operator())),
            false => (0.0, all),
        };
        if by_lights > 1.0 {
            next.lights *= finer_lights(by_lights);
        }
        if by_links > 1.0 {
            let [closed, opened] = POWER;
            let usual = if open { opened } else { closed };
            let power = match history {
                [.., (a, x), (b, y)] if *y > 0.0 && x > y && a > b => {
                    ((x / y).ln() / (a / b).ln()).clamp(0.7 * usual, 1.5 * usual)
                }
                _ => usual,
            };
            let largest = if open { OPEN_STEP } else { STEP[1] };
            next.links *= by_links.powf(-1.0 / power).clamp(STEP[0], largest);
        }
        next
    }
}
