//! The way by rays: what each surfel sees in random directions is kept for all bounces.

use std::ops::RangeInclusive;
use std::time::Instant;

use glam::{DVec3, Vec3};

use super::task::{Solve, Solved, Task, counts};
use super::work::Bounced;
use crate::error::{Error, Result};
use crate::links::{self, Links, Rows};
use crate::memory;
use crate::passes::cpu;
use crate::visibility::Occluders;

/// Rays from each surfel that can be asked for.
pub const RAYS: RangeInclusive<u32> = 2..=1 << 16;
/// Rays to begin with.
const FIRST_RAYS: u32 = 32;

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

impl Task<'_> {
    /// Lights per surfel, then rays for what is reflected: twice as many, until half of them agree
    /// with the other half.
    pub fn gather(
        &self,
        occluders: &Occluders,
        wanted: Option<u32>,
        repairs: &mut Vec<String>,
        solve: Solve,
    ) -> Result<Solved> {
        let n = self.surfels.len();
        if let Some(wanted) = wanted {
            memory::check_rays(n, wanted.next_power_of_two())?;
        }
        let lights = self.direct_light(repairs)?;
        let black = self.surfels.reflectance.iter().all(|r| *r == Vec3::ZERO);
        let dark = lights.iter().all(|h| *h == DVec3::ZERO);
        if black || dark || self.max_bounces == Some(0) {
            return Ok(Solved::without_reflection(lights));
        }
        let mut casting = 0.0;
        let mut cast = |numbers| {
            let clock = Instant::now();
            let (seed, progress) = (self.seed, self.progress);
            let rows = links::gather::<f32>(self.surfels, occluders, numbers, seed, progress)?;
            casting += clock.elapsed().as_secs_f64();
            Ok::<Rows, Error>(rows)
        };
        let mut rays = wanted.unwrap_or(FIRST_RAYS).next_power_of_two() / 2;
        let mut near = cast(0..rays)?;
        let mut start: Option<Vec<DVec3>> = None;
        let mut seconds = 0.0;
        loop {
            memory::check_rays(n, 2 * rays)?;
            let more = cast(rays..2 * rays)?;
            rays *= 2;
            let links = Links {
                near: links::mean(&near, &more)?,
                ..Links::none(self.octree.facets.len(), n)
            };
            let clock = Instant::now();
            let bounced = solve(&links, &self.work(&lights, start.as_deref(), self.stop()))?;
            seconds += clock.elapsed().as_secs_f64();
            let standard_error = standard_error([&near, &more], &bounced);
            let enough = standard_error <= self.tolerance;
            if wanted.is_none() && !enough && rays < *RAYS.end() {
                start = Some(bounced.reflected);
                near = links.near;
                continue;
            }
            let mut ended = bounced.ended;
            ended.converged &= enough || wanted.is_some();
            return Ok(Solved {
                irradiance: bounced.irradiance,
                ended,
                checked: bounced.checked,
                links: counts(&links),
                rays: Some(Rays {
                    count: rays,
                    standard_error,
                    seconds: casting,
                }),
                seconds,
                ..Solved::default()
            });
        }
    }
}

/// Standard error of the mean of two operators, relative to the irradiance: half of what they
/// differ by. Both halves are stratified and complete each other, so that the true error is smaller
/// by a little.
fn standard_error(halves: [&Rows; 2], bounced: &Bounced) -> f64 {
    let reflected: Vec<Vec3> = bounced.reflected.iter().map(|b| b.as_vec3()).collect();
    let [a, b] = halves.map(|near| {
        let mut irradiance = vec![Vec3::ZERO; reflected.len()];
        cpu::near_field::<f32>(near, &reflected, &mut irradiance);
        irradiance
    });
    let differences = a.iter().zip(&b).map(|(a, b)| (*a - *b).as_dvec3());
    let spread: f64 = differences.map(|d| d.length_squared()).sum();
    let whole: f64 = bounced.irradiance.iter().map(|h| h.length_squared()).sum();
    if whole > 0.0 {
        0.5 * (spread / whole).sqrt()
    } else {
        0.0
    }
}
