//! The way by rays: what each surfel sees in random directions is kept for all bounces, and the light
//! that they bring is smoothed over the surface as far as it differs by their noise.

use std::ops::{Range, RangeInclusive};
use std::time::Instant;

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::bright::{Bright, Spots};
use super::even::even;
use super::fmm::{FINEST_LIGHTS, finer_lights};
use super::task::{Solve, Solved, Task, counts};
use super::verified::Verified;
use super::work::Bounced;
use crate::error::Result;
use crate::links::{self, Close, Links, Rows};
use crate::memory;
use crate::passes::cpu;
use crate::plan::Plan;
use crate::points::Surfels;
use crate::visibility::Occluders;

/// Rays from each surfel that can be asked for.
pub const RAYS: RangeInclusive<u32> = 2..=1 << 16;
/// The error falls as this power of the number of rays: that of smooth surfaces to begin with, then what was
/// seen, within these bounds.
const POWER: [f64; 2] = [0.4, 0.7];
/// A next round has at most so many times as many rays.
const MOST_MORE: f64 = 8.0;
/// What a next round aims at, in units of what would just do.
const AIM: f64 = 0.9;
/// Pairs up to so many spacings apart are close to each other; with so many rays that more of them hardly
/// cost anything, up to more.
const CLOSE: [f32; 2] = [3.0, 6.0];
const MANY_RAYS: u32 = 256;
/// Rays from each surfel that cost as much as to sample bright spots apart.
pub(crate) const SPARED: f64 = 64.0;
/// Factor on the tolerance of what spots send, where more rays are in vain.
const CARE: f64 = 0.3;
/// Twice as many rays that leave more than this part of the error are in vain: what is left is no noise,
/// but that rays meet cells where sums take points.
const STUCK: f64 = 0.9;
/// An error is known well enough to tell that, if its upper bound is less than this many times as large.
const KNOWN: f64 = 1.2;

/// What to begin with.
#[derive(Clone, Copy)]
pub(super) struct First {
    /// Rays from each surfel, and beyond how many they are given up.
    pub rays: u32,
    pub most: u32,
    /// Whether bright spots are sampled apart.
    pub apart: bool,
    /// Whether that is all that is wanted.
    pub only: bool,
}

impl First {
    /// What a plan expects, or what is asked for.
    pub fn of(plan: Option<&Plan>, asked: Option<u32>) -> First {
        let planned = plan.and_then(|plan| plan.rays);
        First {
            rays: asked.or(planned).unwrap_or(*RAYS.start()),
            most: plan.and_then(|plan| plan.most_rays).unwrap_or(*RAYS.end()),
            apart: plan.is_some_and(|plan| plan.spots_apart),
            only: asked.is_some(),
        }
    }
}

/// Rays that were cast.
#[derive(Clone, Copy, Serialize, Deserialize)]
pub(super) struct Rays {
    /// From each surfel.
    pub count: u32,
    /// Seconds that they took.
    pub seconds: f64,
}

impl Task<'_> {
    /// Lights per surfel, then rays for what is reflected: more and more of them, until the tolerance
    /// is met, or they are in vain, or the memory is full.
    pub fn gather(
        &self,
        occluders: &Occluders,
        first: First,
        kept: &mut Option<Cast>,
        repairs: &mut Vec<String>,
        solve: Solve,
    ) -> Result<Solved> {
        let before = kept.as_ref().map_or(0, |cast| cast.count);
        let mut rays = first.rays.next_power_of_two().max(before);
        let check_memory = |rays| match rays > before {
            true => memory::check_rays(self.surfels.len(), rays, memory::available()),
            false => Ok(()),
        };
        check_memory(rays)?;
        let smoother = self.smoother()?;
        let mut lights = self.tolerance;
        let mut direct = self.direct_light(lights, None, Some(&smoother), repairs)?;
        if direct.irradiance.iter().all(|h| *h == DVec3::ZERO) {
            return Ok(Solved::without_reflection(direct.irradiance));
        }
        let cast = match kept {
            Some(cast) => cast,
            None => kept.insert(Cast::none(self.surfels)),
        };
        let (mut casting, mut solving, mut verification) = (0.0, 0.0, 0.0);
        let mut start: Option<Vec<DVec3>> = None;
        let mut spots = Spots::of(self.surfels, &direct.irradiance);
        // Whether what these send is sampled apart.
        let mut apart = match cast.count {
            0 => first.apart || self.spares(rays, &spots),
            _ => cast.apart,
        };
        let (mut bright, mut care) = (None::<Bright>, 1.0);
        // So many of the round before, if that had fewer.
        let (mut fewer, mut stuck_before) = (None::<u32>, false);
        let mut best: Option<(Solved, Verified)> = None;
        // Segments by verifications so far.
        let mut tested = 0;
        for round in 0.. {
            casting += cast.up_to(rays, self, occluders)?;
            let links = &cast.links;
            if apart && bright.is_none() {
                bright = Some(self.bright(&direct, &spots, care * lights, &smoother)?);
                start = None;
            }
            let lamps = bright.as_ref().map_or(&direct.irradiance, |b| &b.lights);
            let clock = Instant::now();
            let work = self.work(lamps, start.as_deref(), self.stop());
            let bounced = solve(links, &work)?;
            let noise = noise(&cast.halves, &bounced, lamps);
            let bounced = even(bounced, self.surfels, &smoother, lamps, noise);
            solving += clock.elapsed().as_secs_f64();
            start = Some(bounced.reflected.clone());
            let bounced = match &bright {
                Some(bright) => bright.whole(bounced, self.surfels),
                None => bounced,
            };
            let model = best.as_ref().and_then(|(last, _)| last.model_error);
            let newly_cast = u64::from(cast.count - before) * self.surfels.len() as u64;
            let segments = [self.visibility.segments() + newly_cast, tested];
            let claimed = Some((links, &bounced));
            let (verified, model) = self.verify_round(&direct, claimed, segments, model, round)?;
            tested += verified.segments;
            verification += verified.seconds;
            self.progress.note(&format!(
                "{rays} rays from each point, lights within {lights:.1e}: {verified}"
            ));
            let last = best.take().map(|(_, last)| last);
            // The power of the number of rays by which the error fell.
            let fell = last.zip(fewer).map(|(last, fewer)| {
                let ratio = verified.error() / last.error().max(f64::MIN_POSITIVE);
                -ratio.log2() / f64::from(rays / fewer).log2()
            });
            // A few points that are far off make an error that is not well known: then it takes two rounds.
            let known = verified.bound() < KNOWN * verified.error();
            let stuck = fell.is_some_and(|power| power < -STUCK.log2());
            let mut in_vain = !verified.met && stuck && (known || stuck_before);
            if in_vain && bright.is_some() && care == 1.0 {
                // What is left may be wrong with the spots.
                (bright, care, in_vain) = (None, CARE, false);
            }
            stuck_before = stuck;
            let solved = Solved {
                direct: direct.irradiance.clone(),
                irradiance: bounced.irradiance,
                ended: bounced.ended,
                checked: bounced.checked,
                verified: Some(verified),
                model_error: model,
                links: counts(links),
                in_vain,
                ..Solved::default()
            };
            best = Some((solved, verified));
            let all = rays == *RAYS.end() || first.only;
            if verified.met || in_vain || all || !bounced.ended.converged {
                break;
            }
            let mut wrong = verified.likely() / (AIM * verified.tolerance);
            if verified.by_lights() && lights > FINEST_LIGHTS {
                lights *= finer_lights(wrong);
                direct =
                    self.direct_light(lights, Some(direct.seen), Some(&smoother), &mut Vec::new())?;
                (spots, bright) = (Spots::of(self.surfels, &direct.irradiance), None);
                wrong = verified.by_operator() / (AIM * verified.tolerance);
                if wrong <= 1.0 {
                    fewer = None;
                    continue;
                }
            }
            let [least, most] = POWER;
            let power = fell.map_or(most, |power| power.clamp(least, most));
            // One more look at whether they are in vain should cost little.
            let most_more = if stuck { 2.0 } else { MOST_MORE };
            let enough = |wrong: f64, least: f64| {
                let more = wrong.powf(1.0 / power).clamp(least, most_more);
                let enough = (f64::from(rays) * more) as u32;
                enough.next_power_of_two().min(*RAYS.end())
            };
            let newly = !apart && self.spares(enough(wrong, 2.0), &spots);
            apart |= newly;
            // Without the noise of spots the same rays may do.
            let next = match newly {
                true => enough(wrong * spots.left, 1.0),
                false => enough(wrong, 2.0),
            };
            if next > first.most {
                if let Some((solved, _)) = &mut best {
                    solved.in_vain = true;
                }
                break;
            }
            if let Err(why) = check_memory(next) {
                self.progress.note(&format!("no more rays: {why}"));
                break;
            }
            fewer = (next > rays).then_some(rays);
            rays = next;
        }
        cast.apart = apart;
        let solved = best.map(|(solved, _)| solved).unwrap_or_default();
        Ok(Solved {
            rays: Some(Rays {
                count: cast.count,
                seconds: casting,
            }),
            seconds: solving,
            verification,
            ..solved
        })
    }

    /// Whether it spares enough of so many rays if spots are sampled apart. Where bounces are counted it
    /// cannot be: what spots reflect would be one ahead.
    fn spares(&self, rays: u32, spots: &Spots) -> bool {
        let spared = f64::from(rays) * (1.0 - spots.left.powf(1.0 / POWER[1]));
        self.max_bounces.is_none() && spared >= SPARED
    }
}

/// Rays that were cast for the lights so far, and the links that they make. They serve any light.
pub(super) struct Cast {
    close: Close,
    /// How far apart these are at most, in spacings.
    spacings: f32,
    /// The means of one half of the rays and of the other.
    halves: [Rows; 2],
    /// Rays from each surfel, a power of two; 0 at first.
    count: u32,
    /// Those of close pairs and of rays, and how many of these there were.
    links: Links,
    linked: u32,
    /// Whether bright spots had to be sampled apart.
    apart: bool,
}

impl Cast {
    fn none(surfels: &Surfels) -> Cast {
        let none = || Rows::none(surfels.len());
        Cast {
            close: Close::none(surfels),
            spacings: 0.0,
            halves: [none(), none()],
            count: 0,
            links: Links::none(0, surfels.len()),
            linked: 0,
            apart: false,
        }
    }

    /// What another light would begin with: rays from each surfel, and whether spots are sampled apart.
    pub fn state(&self) -> (u32, bool) {
        (self.count, self.apart)
    }

    /// Casts up to so many rays from each surfel, a power of two, and returns the seconds that they took.
    fn up_to(&mut self, rays: u32, task: &Task, occluders: &Occluders) -> Result<f64> {
        if rays == self.linked {
            return Ok(0.0);
        }
        self.widen(rays, task)?;
        let (surfels, seed, progress) = (task.surfels, task.seed, task.progress);
        let mut seconds = 0.0;
        let close = &self.close;
        let mut numbers = |numbers: Range<u32>| {
            let clock = Instant::now();
            let rows = links::gather::<f32>(surfels, occluders, close, numbers, seed, progress);
            seconds += clock.elapsed().as_secs_f64();
            rows
        };
        if self.count == 0 {
            self.halves = [numbers(0..rays / 2)?, numbers(rays / 2..rays)?];
            self.count = rays;
        }
        while self.count < rays {
            let more = numbers(self.count..2 * self.count)?;
            let [half, other] = &self.halves;
            self.halves = [links::mean(half, other, progress)?, more];
            self.count *= 2;
        }
        let [half, other] = &self.halves;
        let both = links::mean(half, other, progress)?;
        self.links = Links {
            near: self.close.and(&both, progress)?,
            ..Links::none(task.octree.facets.len(), surfels.len())
        };
        self.linked = rays;
        Ok(seconds)
    }

    /// Takes as many pairs for close as is right for so many rays.
    fn widen(&mut self, rays: u32, task: &Task) -> Result<()> {
        let spacings = CLOSE[usize::from(rays >= MANY_RAYS)];
        if spacings > self.spacings {
            let close = Close::find(task.surfels, spacings, task.visibility, task.progress)?;
            for half in &mut self.halves {
                *half = close.without(half, task.progress)?;
            }
            (self.close, self.spacings) = (close, spacings);
        }
        Ok(())
    }
}

/// Noise of the light that rays bring, relative to it: half of what two halves of them differ by.
fn noise(halves: &[Rows; 2], bounced: &Bounced, lights: &[DVec3]) -> f64 {
    // As f32 can hold the squares of.
    let brightest = bounced.sent.iter().map(|b| b.max_element());
    let unit = brightest.fold(f64::MIN_POSITIVE, f64::max);
    let sent: Vec<Vec3> = bounced.sent.iter().map(|b| (*b / unit).as_vec3()).collect();
    let [a, b] = halves.each_ref().map(|near| {
        let mut irradiance = vec![Vec3::ZERO; sent.len()];
        cpu::near_field::<f32, _>(near, &sent, &mut irradiance);
        irradiance
    });
    let differences = a
        .iter()
        .zip(&b)
        .map(|(a, b)| (*a - *b).as_dvec3() * 0.5 * unit);
    let square = |light: DVec3| light.length_squared();
    let all = bounced.irradiance.iter().zip(lights);
    let reflected: f64 = all.map(|(h, light)| square(*h - *light)).sum();
    match reflected > 0.0 {
        true => (differences.map(square).sum::<f64>() / reflected).sqrt(),
        false => 0.0,
    }
}
