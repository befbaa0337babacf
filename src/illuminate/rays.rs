//! The way by rays: what each surfel sees in random directions is kept for all bounces.

use std::ops::RangeInclusive;
use std::time::Instant;

use glam::{DVec3, Vec3};
use rand::RngExt;

use super::task::{Solve, Solved, Task, counts};
use super::work::{BOUNCES_INSTEAD, Bounced, Work};
use crate::error::{Error, Result};
use crate::links::{self, Links, Rows};
use crate::memory;
use crate::operator::{Fields, Fmm, TransportOperator};
use crate::passes::cpu;
use crate::random::{Purpose, stream};
use crate::solve::{Stop, solve};
use crate::visibility::Occluders;

/// Rays from each surfel that can be asked for.
pub const RAYS: RangeInclusive<u32> = 2..=1 << 16;
/// Rays to begin with.
pub(super) const FIRST_RAYS: u32 = 32;
/// Draws of an error that might have been, whose mean square is taken.
const DRAWS: u64 = 8;
/// Residual to which each of them is solved. What is brightened most, a small part of the whole, must
/// not be lost in it.
const ERROR_RESIDUAL: f64 = 0.01;

/// Further rounds in which a measured error is brought down by twice as many rays.
const ROUNDS: u64 = 2;

/// How many rays each surfel casts.
#[derive(Clone, Copy)]
pub(super) enum Wanted {
    /// So many.
    Exactly(u32),
    /// As many as bring their standard error within the tolerance.
    Noise,
    /// So many, and some more if the measured error asks for them.
    Verified(u32),
}

/// Rays that were cast.
#[derive(Clone, Copy)]
pub(super) struct Rays {
    /// From each surfel.
    pub count: u32,
    /// Standard error that they leave, relative to the irradiance (L2 norms).
    pub standard_error: f64,
    /// Seconds that they took.
    pub seconds: f64,
}

/// What a number of rays found.
struct Found {
    rays: u32,
    links: Links,
    bounced: Bounced,
    standard_error: f64,
}

impl Task<'_> {
    /// Lights per surfel, then rays for what is reflected: twice as many, until half of them agree
    /// with the other half, or the measured error is small enough, or the memory is full.
    pub fn gather(
        &self,
        occluders: &Occluders,
        wanted: Wanted,
        repairs: &mut Vec<String>,
        solve: Solve,
    ) -> Result<Solved> {
        let first = match wanted {
            Wanted::Exactly(rays) | Wanted::Verified(rays) => rays.next_power_of_two(),
            Wanted::Noise => FIRST_RAYS,
        };
        let check_memory = |rays| memory::check_rays(self.surfels.len(), rays, memory::available());
        check_memory(first)?;
        let direct = self.direct_light(self.tolerance, None, repairs)?;
        let lights = &direct.irradiance;
        let black = self.surfels.reflectance.iter().all(|r| *r == Vec3::ZERO);
        let dark = lights.iter().all(|h| *h == DVec3::ZERO);
        if black || dark || self.max_bounces == Some(0) {
            return Ok(Solved::without_reflection(direct.irradiance));
        }
        let (mut casting, mut solving) = (0.0, 0.0);
        let mut cast = |numbers| {
            let clock = Instant::now();
            let (seed, progress) = (self.seed, self.progress);
            let rows = links::gather::<f32>(self.surfels, occluders, numbers, seed, progress)?;
            casting += clock.elapsed().as_secs_f64();
            Ok::<Rows, Error>(rows)
        };
        let half = cast(0..first / 2)?;
        let mut twice = |rays: u32, near: &Rows, start: Option<&[DVec3]>| {
            check_memory(rays)?;
            let more = cast(rays / 2..rays)?;
            let links = self.links_of(links::mean(near, &more, self.progress)?);
            let clock = Instant::now();
            let work = self.work(lights, start, self.stop());
            let bounced = solve(
                &links,
                &Work {
                    checked: None,
                    ..work
                },
            )?;
            let standard_error = self.standard_error([near, &more], &links, &bounced)?;
            solving += clock.elapsed().as_secs_f64();
            Ok(Found {
                rays,
                links,
                bounced,
                standard_error,
            })
        };
        let mut found = twice(first, &half, None)?;
        drop(half);
        let verify = |found: &Found, bounced: &Bounced, model, round| {
            let segments = u64::from(found.rays) * self.surfels.len() as u64;
            let clock = Instant::now();
            let claimed = Some((&found.links, bounced));
            let verified = self.verify_round(&direct, claimed, segments, model, round)?;
            Ok::<_, Error>((verified, clock.elapsed().as_secs_f64()))
        };
        let (mut verified, mut model, mut verification) = (None, None, 0.0);
        for round in 0.. {
            let enough = match wanted {
                Wanted::Exactly(_) => true,
                Wanted::Noise => found.standard_error <= self.tolerance,
                Wanted::Verified(_) => {
                    let (looked, seconds) = verify(&found, &found.bounced, model, round)?;
                    let error = looked.0;
                    verification += seconds;
                    self.progress.note(&format!("{} rays: {error}", found.rays));
                    (verified, model) = (Some(error), looked.1);
                    error.met || round == ROUNDS
                }
            };
            if enough || found.rays >= *RAYS.end() {
                break;
            }
            let start = Some(found.bounced.reflected.as_slice());
            found = match twice(2 * found.rays, &found.links.near, start) {
                Err(Error::TooLarge(why)) => {
                    self.progress.note(&format!("no more rays: {why}"));
                    break;
                }
                found => found?,
            };
        }
        let clock = Instant::now();
        let work = self.work(lights, Some(&found.bounced.reflected), self.stop());
        let bounced = solve(&found.links, &work)?;
        solving += clock.elapsed().as_secs_f64();
        let mut ended = bounced.ended;
        if verified.is_none() {
            let (looked, seconds) = verify(&found, &bounced, None, 0)?;
            verification = seconds;
            (verified, model) = (Some(looked.0), looked.1);
            let enough = found.standard_error <= self.tolerance;
            ended.converged &= matches!(wanted, Wanted::Exactly(_)) || enough;
        }
        Ok(Solved {
            direct: direct.irradiance,
            irradiance: bounced.irradiance,
            ended,
            checked: bounced.checked,
            verification,
            verified,
            model_error: model,
            links: counts(&found.links),
            rays: Some(Rays {
                count: found.rays,
                standard_error: found.standard_error,
                seconds: casting,
            }),
            seconds: solving,
            ..Solved::default()
        })
    }

    fn links_of(&self, near: Rows) -> Links {
        Links {
            near,
            ..Links::none(self.octree.facets.len(), self.surfels.len())
        }
    }

    /// Standard error of the irradiance by the mean of two operators, relative to it.
    ///
    /// Half of what the operators differ by is an error d of the irradiance, which is reflected on as
    /// light is: (I - ρF) e = ρ d, in all d + F e. Where little is absorbed, one number decides, the
    /// mean of d: to know how large it is as a rule, d is drawn again with random signs, as rays of one
    /// surfel know nothing of those of another. Both halves are stratified and complete each other,
    /// so that the true error is smaller by a little.
    fn standard_error(&self, halves: [&Rows; 2], links: &Links, bounced: &Bounced) -> Result<f64> {
        let whole: f64 = bounced.irradiance.iter().map(|h| h.length_squared()).sum();
        if whole == 0.0 {
            return Ok(0.0);
        }
        // As f32 can hold the squares of.
        let unit = (whole / bounced.irradiance.len() as f64).sqrt();
        let operator = Fmm::<f32>::new(self.surfels, self.octree, links);
        let fields = operator.fields();
        let upload = |light: &[DVec3]| {
            let light: Vec<DVec3> = light.iter().map(|h| *h / unit).collect();
            fields.upload(&light)
        };
        let reflected = upload(&bounced.reflected)?;
        let [mut difference, other] = halves.map(|near| {
            let mut irradiance = vec![Vec3::ZERO; reflected.len()];
            cpu::near_field::<f32>(near, &reflected, &mut irradiance);
            irradiance
        });
        fields.axpy(-1.0, &other, &mut difference)?;
        fields.scale(0.5, &mut difference)?;
        let reflectance: Vec<DVec3> = self
            .surfels
            .reflectance
            .iter()
            .map(|r| r.as_dvec3())
            .collect();
        let reflectance = fields.upload(&reflectance)?;
        let stop = Stop {
            residual: ERROR_RESIDUAL,
            bounces: match bounced.ended.converged {
                true => self.max_bounces.map(|bounces| bounces - 1),
                false => Some(BOUNCES_INSTEAD),
            },
        };
        let mut square = 0.0;
        for draw in 0..DRAWS {
            let mut random = stream(self.seed, Purpose::Errors, draw);
            let sign = |d: &Vec3| if random.random() { *d } else { -*d };
            let mut error: Vec<Vec3> = difference.iter().map(sign).collect();
            let mut source = fields.copy(&error)?;
            fields.multiply(&reflectance, &mut source)?;
            let (reflected, _) =
                solve(&operator, &reflectance, &source, None, stop, self.progress)?;
            fields.axpy(1.0, &operator.apply(&reflected)?, &mut error)?;
            square += fields.dot(&error, &error)? / DRAWS as f64;
        }
        Ok((square * unit * unit / whole).sqrt())
    }
}
