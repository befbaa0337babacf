//! The ways from lights to irradiance: exact sums, links, and the lists of the report (for rays see
//! `rays`).

use std::collections::BTreeMap;
use std::time::Instant;

use glam::{DVec3, Vec3};

use super::checks::Checked;
use super::rays::Rays;
use super::work::{Bounced, Work};
use crate::error::Result;
use crate::lights;
use crate::links::{self, Accuracy, CLAMPED, Links, States, Thresholds};
use crate::octree::Octree;
use crate::operator::{Direct, Fields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Ended, Stop};
use crate::visibility::{Counted, PointVisibility, Visibility};

/// Allowed error of a link with tested visibility in units of the tolerance and the mean irradiance.
/// How errors of many links add up is measured: allowed 0.015, the scenes are off by 0.007 to 0.016
/// in all (`tests/truth.rs` holds them to the tolerance), the indirect light of a real cave by 0.03.
const ERROR_A_LINK: f64 = 0.5;
/// The same for the first, rough links. (With 0.3 the last ones are no better, and the first take three
/// times as many segments.)
const ROUGH_ERROR: f64 = 1.0;
/// Residual to which the rough links are solved.
const ROUGH_RESIDUAL: f64 = 0.03;
/// What f32 can reach.
const LEAST_RESIDUAL: f64 = 1e-6;

/// What stays the same through a run.
pub(super) struct Task<'a> {
    pub scene: &'a Scene,
    pub surfels: &'a Surfels,
    pub octree: &'a Octree,
    pub visibility: &'a Counted<'a>,
    pub tolerance: f64,
    /// Largest order of the expansions.
    pub order: usize,
    pub max_bounces: Option<u32>,
    pub seed: u64,
    pub progress: &'a dyn Progress,
}

/// Irradiance of the surfels, and how it was found.
#[derive(Default)]
pub(super) struct Solved {
    pub irradiance: Vec<DVec3>,
    pub ended: Ended,
    pub checked: Option<Checked>,
    pub links: BTreeMap<String, u64>,
    pub rays: Option<Rays>,
    /// Seconds of the solver, with those of the checks.
    pub seconds: f64,
    /// Seconds of tests of other kinds than segments.
    pub tests: f64,
}

/// How an operator made of links solves the equation, on one backend or the other.
pub(super) type Solve<'a> = &'a dyn Fn(&Links, &Work) -> Result<Bounced>;

impl Task<'_> {
    /// Everything by exact sums.
    pub fn direct(&self, repairs: &mut Vec<String>) -> Result<Solved> {
        let operator = Direct::new(self.surfels, self.visibility, self.progress)?;
        self.by_operator(&operator, repairs)
    }

    /// Everything by the lists of the report, which `solve` applies.
    pub fn classic(
        &self,
        points: &dyn PointVisibility,
        solve: impl FnOnce(&Links) -> Result<Solved>,
    ) -> Result<Solved> {
        let (surfels, octree, progress) = (self.surfels, self.octree, self.progress);
        if self.visibility.is_open() {
            let links = links::adaptive(octree, surfels, CLAMPED, self.order, progress)?;
            return Ok(Solved {
                links: named(links.counts()),
                ..solve(&links)?
            });
        }
        let states = States::find(octree, &Thresholds::default(), points, progress)?;
        let links = links::classic(octree, surfels, self.order, &states, points, progress)?;
        let mut counts = named(links.counts());
        counts.extend(named(states.counts()));
        Ok(Solved {
            links: counts,
            tests: states.tally.seconds,
            ..solve(&links)?
        })
    }

    /// Everything by one operator, the light of emitting surfels too.
    pub fn by_operator<O: TransportOperator>(
        &self,
        operator: &O,
        repairs: &mut Vec<String>,
    ) -> Result<Solved> {
        let mut lights = self.lights(repairs)?;
        let emission: Vec<DVec3> = self.surfels.emission.iter().map(|e| e.as_dvec3()).collect();
        let start = Instant::now();
        let fields = operator.fields();
        let emitted = fields.download(&operator.apply(&fields.upload(&emission)?)?)?;
        for (light, emitted) in lights.iter_mut().zip(emitted) {
            *light += emitted;
        }
        let bounced = self
            .work(&lights, None, self.stop())
            .solve(operator, self.progress)?;
        Ok(Solved {
            irradiance: bounced.irradiance,
            ended: bounced.ended,
            checked: bounced.checked,
            seconds: start.elapsed().as_secs_f64(),
            ..Solved::default()
        })
    }

    /// Lights per surfel, then links for what is reflected: rough ones first, whose solution says
    /// where light is strong and where it is weak, then those that keep the tolerance.
    pub fn fmm(&self, repairs: &mut Vec<String>, solve: Solve) -> Result<Solved> {
        let lights = self.direct_light(repairs)?;
        let reflectance = || self.surfels.reflectance.iter().map(|r| r.as_dvec3());
        let ambient: DVec3 = lights.iter().sum::<DVec3>() / lights.len() as f64;
        let guess: Vec<DVec3> = lights
            .iter()
            .zip(reflectance())
            .map(|(h, r)| r * (*h + ambient))
            .collect();
        if guess.iter().all(|b| *b == DVec3::ZERO) || self.max_bounces == Some(0) {
            return Ok(Solved::without_reflection(lights));
        }
        let rough_stop = Stop {
            residual: ROUGH_RESIDUAL,
            bounces: None,
        };
        let mut seconds = 0.0;
        let mut run = |accuracy: &Accuracy, work: &Work| {
            let links = self.links(accuracy)?;
            let clock = Instant::now();
            let bounced = solve(&links, work)?;
            seconds += clock.elapsed().as_secs_f64();
            Ok((links, bounced))
        };
        let rough = self.accuracy(&guess, None, ROUGH_ERROR);
        let work = self.work(&lights, None, rough_stop);
        let unchecked = Work {
            checked: None,
            ..work
        };
        let (_, rough) = run(&rough, &unchecked)?;
        let allowed = match self.visibility.is_open() {
            true => self.tolerance,
            false => ERROR_A_LINK * self.tolerance,
        };
        let fine = self.accuracy(&rough.reflected, Some(&rough.irradiance), allowed);
        let work = self.work(&lights, Some(&rough.reflected), self.stop());
        let (links, fine) = run(&fine, &work)?;
        Ok(Solved {
            irradiance: fine.irradiance,
            ended: fine.ended,
            checked: fine.checked,
            links: counts(&links),
            seconds,
            ..Solved::default()
        })
    }

    fn links(&self, accuracy: &Accuracy) -> Result<Links> {
        let (surfels, octree, progress) = (self.surfels, self.octree, self.progress);
        match self.visibility.is_open() {
            true => links::build_open(surfels, octree, accuracy, progress),
            false => links::build(surfels, octree, accuracy, self.visibility, progress),
        }
    }

    /// Point lights, sky and emitters.
    pub(super) fn direct_light(&self, repairs: &mut Vec<String>) -> Result<Vec<DVec3>> {
        let mut lights = self.lights(repairs)?;
        let emitted = lights::emitters(
            self.surfels,
            self.tolerance,
            self.seed,
            self.visibility,
            self.progress,
        )?;
        for (light, emitted) in lights.iter_mut().zip(emitted) {
            *light += emitted;
        }
        Ok(lights)
    }

    /// Point lights and sky.
    fn lights(&self, repairs: &mut Vec<String>) -> Result<Vec<DVec3>> {
        let scene = self.scene;
        let lit =
            lights::point_lights(self.surfels, &scene.lights, self.visibility, self.progress)?;
        if lit.too_close > 0 {
            repairs.push(format!(
                "{} surfels lie closer to a light than their own radius: lit as from that radius",
                lit.too_close
            ));
        }
        if lit.on_surface > 0 {
            repairs.push(format!(
                "{} lights lie on a surface: lifted off it",
                lit.on_surface
            ));
        }
        let mut irradiance = lit.irradiance;
        if scene.sky != Vec3::ZERO {
            let sky = lights::sky(
                self.surfels,
                scene.sky,
                self.tolerance,
                self.seed,
                self.visibility,
                self.progress,
            )?;
            for (h, s) in irradiance.iter_mut().zip(sky) {
                *h += s;
            }
        }
        Ok(irradiance)
    }

    fn accuracy(
        &self,
        reflected: &[DVec3],
        irradiance: Option<&[DVec3]>,
        relative: f64,
    ) -> Accuracy {
        Accuracy::new(
            self.octree,
            reflected,
            irradiance,
            relative,
            self.order,
            self.seed,
        )
    }

    pub(super) fn work<'w>(
        &'w self,
        lights: &'w [DVec3],
        start: Option<&'w [DVec3]>,
        stop: Stop,
    ) -> Work<'w> {
        Work {
            surfels: self.surfels,
            lights,
            start,
            stop,
            checked: Some((self.visibility.inner(), self.seed)),
        }
    }

    pub(super) fn stop(&self) -> Stop {
        Stop {
            residual: (0.03 * self.tolerance).clamp(LEAST_RESIDUAL, 1e-3),
            bounces: self.max_bounces,
        }
    }
}

impl Solved {
    /// Light straight from the lights is all there is.
    pub(super) fn without_reflection(irradiance: Vec<DVec3>) -> Solved {
        Solved {
            irradiance,
            ended: Ended {
                converged: true,
                ..Ended::default()
            },
            ..Solved::default()
        }
    }
}

pub(super) fn counts(links: &Links) -> BTreeMap<String, u64> {
    named(links.counts())
}

fn named<const N: usize>(counts: [(&str, u64); N]) -> BTreeMap<String, u64> {
    let owned = counts.into_iter().map(|(kind, n)| (kind.to_owned(), n));
    owned.collect()
}
