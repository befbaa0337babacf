//! The ways from lights to irradiance: exact sums and the lists of the report (for links
//! see `fmm`, for rays `rays`).

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::checkpoint::Stages;
use super::checks::Checked;
use super::holes::Holes;
use super::rays::Rays;
use super::verified::Verified;
use super::work::{Bounced, Work};
use crate::error::Result;
use crate::lights::{self, SkySeen};
use crate::links::{self, Accuracy, CLAMPED, Links, States, Thresholds};
use crate::octree::Octree;
use crate::operator::{Direct, Fields, Fmm, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::smoothing::{Smoother, Surroundings};
use crate::solve::{Ended, Stop};
use crate::visibility::{Counted, PointVisibility, Visibility};

/// Allowed error of the first, rough links, in units of the mean irradiance. (With 0.3 the last ones are
/// no better, and the first take three times as many segments.)
pub(super) const ROUGH_ERROR: f64 = 1.0;
/// Residual to which the rough links are solved.
pub(super) const ROUGH_RESIDUAL: f64 = 0.03;
/// Part of the sky that is seen at least, on average, if not from inside.
const HARDLY_ANY_SKY: f64 = 0.05;
/// What f32 can reach.
const LEAST_RESIDUAL: f64 = 1e-6;

/// What stays the same through a run.
pub(super) struct Task<'a> {
    pub scene: &'a Scene,
    pub surfels: &'a Surfels,
    pub octree: &'a Octree,
    pub visibility: &'a Counted<'a>,
    pub holes: &'a Holes,
    /// Whether links go without tests: nothing is in the way, or nothing seems to be.
    pub untested: bool,
    /// Who is next to whom, once it was asked for.
    pub around: &'a OnceLock<Arc<Surroundings>>,
    pub tolerance: f64,
    /// Largest order of the expansions.
    pub order: usize,
    pub max_bounces: Option<u32>,
    /// Whether the tolerance counts however little the points allow.
    pub below_model: bool,
    pub seed: u64,
    pub stages: &'a Stages<'a>,
    pub progress: &'a dyn Progress,
}

/// Irradiance of the surfels, and how it was found.
#[derive(Default, Serialize, Deserialize)]
pub(super) struct Solved {
    pub irradiance: Vec<DVec3>,
    /// The part of it straight from lights, where it was found apart.
    pub direct: Vec<DVec3>,
    pub ended: Ended,
    pub checked: Option<Checked>,
    pub verified: Option<Verified>,
    pub model_error: Option<f64>,
    pub links: BTreeMap<String, u64>,
    pub rays: Option<Rays>,
    /// Seconds of the solver, with those of the checks.
    pub seconds: f64,
    /// Seconds of all verifications.
    pub verification: f64,
    /// Seconds of tests of other kinds than segments.
    pub tests: f64,
    /// Whether more of the same would not have met the tolerance.
    pub in_vain: bool,
}

/// Irradiance straight from the lights.
#[derive(Serialize, Deserialize)]
pub(super) struct DirectLight {
    pub irradiance: Vec<DVec3>,
    /// The part of it that is not exact: from sky and emitters.
    pub sampled: Vec<DVec3>,
    /// The part of that from the sky, and how much of it is seen.
    pub sky: Vec<DVec3>,
    pub seen: SkySeen,
}

/// How an operator made of links solves the equation, on one backend or the other.
pub(super) type Solve<'a> = &'a dyn Fn(&Links, &Work) -> Result<Bounced>;

impl<'a> Task<'a> {
    /// What smooths light over the surface.
    pub fn smoother(&self) -> Result<Smoother<'a>> {
        let around = match self.around.get() {
            Some(around) => around.clone(),
            None => {
                let found = Surroundings::find(self.surfels, self.visibility, self.progress)?;
                self.around.get_or_init(|| Arc::new(found)).clone()
            }
        };
        Ok(Smoother::among(self.surfels, around))
    }
}

impl Task<'_> {
    /// Whether there are surfels that reflect, and bounces to follow.
    pub fn reflects(&self) -> bool {
        let black = self.surfels.reflectance.iter().all(|r| *r == Vec3::ZERO);
        !black && self.max_bounces != Some(0)
    }

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

    /// Point lights, sky and emitters, the latter two as accurate as a tolerance needs; the penumbras of
    /// both are smoothed if there is a smoother. What was `seen` of the sky before counts.
    pub(super) fn direct_light(
        &self,
        tolerance: f64,
        seen: Option<SkySeen>,
        smoother: Option<&Smoother>,
        repairs: &mut Vec<String>,
    ) -> Result<DirectLight> {
        let mut irradiance = self.point_lights(repairs)?;
        let mut seen = seen.unwrap_or_else(|| SkySeen::none(self.surfels));
        let sky = self.sky(&mut seen, tolerance, smoother, repairs)?;
        let mut sampled = sky.clone();
        let lights = irradiance.iter_mut().zip(&mut sampled);
        for ((light, sampled), emitted) in lights.zip(self.emitted(tolerance, smoother)?) {
            *sampled += emitted;
            *light += *sampled;
        }
        Ok(DirectLight {
            irradiance,
            sampled,
            sky,
            seen,
        })
    }

    /// Light from the surfels that shine: sampled, or by links where these go without tests.
    fn emitted(&self, tolerance: f64, smoother: Option<&Smoother>) -> Result<Vec<DVec3>> {
        let (surfels, octree, progress) = (self.surfels, self.octree, self.progress);
        let emission: Vec<DVec3> = surfels.emission.iter().map(|e| e.as_dvec3()).collect();
        let dark = emission.iter().all(|e| *e == DVec3::ZERO);
        if self.untested && !dark {
            let apply = |irradiance: Option<&[DVec3]>| {
                let accuracy = self.accuracy(&emission, irradiance, tolerance);
                let links = links::build_open(surfels, octree, &accuracy, progress)?;
                let operator = Fmm::<f32>::new(surfels, octree, &links);
                let fields = operator.fields();
                fields.download(&operator.apply(&fields.upload(&emission)?)?)
            };
            // How much light there is says how accurate it has to be.
            let rough = apply(None)?;
            return apply(Some(&rough));
        }
        let mut emitted = lights::emitted(
            surfels,
            tolerance,
            lights::EXPANSIONS,
            self.seed,
            self.visibility,
            progress,
        )?;
        if let Some(smoother) = smoother {
            emitted.smooth(smoother);
        }
        Ok(emitted.irradiance())
    }

    fn point_lights(&self, repairs: &mut Vec<String>) -> Result<Vec<DVec3>> {
        let lights = &self.scene.lights;
        let lit = lights::point_lights(self.surfels, lights, self.visibility, self.progress)?;
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
        self.holes.lower(&mut irradiance);
        Ok(irradiance)
    }

    fn sky(
        &self,
        seen: &mut SkySeen,
        tolerance: f64,
        smoother: Option<&Smoother>,
        repairs: &mut Vec<String>,
    ) -> Result<Vec<DVec3>> {
        let (sky, n) = (self.scene.sky, self.surfels.len());
        if sky == Vec3::ZERO {
            return Ok(vec![DVec3::ZERO; n]);
        }
        seen.look(
            self.surfels,
            tolerance,
            smoother.is_some(),
            self.seed,
            self.visibility,
            self.progress,
        )?;
        let mut irradiance = seen.irradiance(sky, smoother);
        let arrives: f64 = irradiance.iter().map(|h| h.element_sum()).sum();
        let seen = arrives / (n as f64 * f64::from(sky.element_sum()));
        if seen < HARDLY_ANY_SKY {
            repairs.push(format!(
                "{:.1}% of the sky is seen on average: if this is an object, its normals point inward, and \
                 --normals outward turns them",
                100.0 * seen
            ));
        }
        self.holes.lower(&mut irradiance);
        Ok(irradiance)
    }

    /// Point lights and sky.
    fn lights(&self, repairs: &mut Vec<String>) -> Result<Vec<DVec3>> {
        let mut irradiance = self.point_lights(repairs)?;
        let mut seen = SkySeen::none(self.surfels);
        let sky = self.sky(&mut seen, self.tolerance, None, repairs)?;
        irradiance.iter_mut().zip(sky).for_each(|(h, s)| *h += s);
        Ok(irradiance)
    }

    pub(super) fn accuracy(
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
            direct: irradiance.clone(),
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
