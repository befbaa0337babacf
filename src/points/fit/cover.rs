//! Surfels that cover the surface evenly, each fitted to the points around it.
//!
//! Points are taken in random order. One that no surfel covers yet becomes the place of a surfel, if it
//! lies on a surface: on the plane, cylinder or paraboloid of most of the points around it, which are spread on it as
//! densely as it is itself. Where that holds for too few, one surface ends at another: such points are taken last, and
//! what lies beside them goes on there. The surfel covers what is on its plane within its size. So no two surfels of one
//! surface are nearer than that (Poisson discs), those of two sheets know nothing of each other, and layers
//! within the noise are one sheet.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};
use rand::seq::SliceRandom;
use rayon::prelude::*;

use super::curved::Curved;
use super::patch::{FOOTPRINT, Model, Patch};
use super::plane::{AT_LEAST, Around, OFF, Plane, Weighted};
use super::round::Round;
use super::samples::{Samples, Scale};
use crate::error::Result;
use crate::points::neighbours::Neighbours;
use crate::progress::Progress;
use crate::random::{Purpose, stream};

/// A surfel is as large as this many deviations of the noise, so that its footprint tells a direction.
const NOISE: f32 = 5.0;
/// Where less than this part of the points within its size lie on its plane, a surfel is too large for what
/// is there: boards, posts, pipes, edges.
const WHOLE: f32 = 0.65;
/// Where more than this part lies on a plane within the noise, one surface ends at another.
const PART: f32 = 0.3;
/// Of a footprint with many more points so many tell as well what is there.
const MANY: usize = 128;
/// Where this part of the footprint does, off it by no more than so many deviations of the noise (root mean square),
/// nothing else is looked for.
const FLAT: f32 = 0.8;
const BENDS: f32 = 1.2;
/// Fewer points are on any plane: what goes on there comes first.
const SUPPORT: f32 = 9.0;
/// Fewer points than this do not tell the middle of what is there.
const FEW: usize = 4;
/// What is round has so many times as many points on it as a plane.
const ROUNDER: f32 = 1.3;
/// Surfels are made smaller for that down to this part of the size wanted.
const SMALLEST: f32 = 0.25;
/// Times that a footprint on a line is widened, and by what.
const WIDENED: usize = 2;
const WIDER: f32 = 1.6;
/// A point whose spacing is this many times that of the points on its plane is none of them.
const ALONE: f32 = 2.0;
/// So many of those next to it.
const BESIDE: usize = 8;
/// Points of a surface lie close about its plane: root mean square of their heights, in what is allowed. It is
/// 0.4 of normal noise, and 0.58 where points are everywhere.
const SPREAD: f32 = 0.5;
/// Maximal Poisson discs of the diameter h: so many in h².
const DISCS: f64 = 0.7;
/// Points of a surface lie around in so many of the sectors next to them, as far as so many sizes: not along a
/// line of mixed pixels before the void.
const AROUND: u32 = 3;
const SECTORS: f32 = 8.0;
const NEXT: std::ops::Range<f32> = 0.15..1.5;
/// Patches beside a point among which one is looked for whose plane it is on, and how far that goes on, in sizes.
const LOOKED_AT: usize = 16;
const ON: f32 = 3.0;
/// Parts of the points that are fitted at the same time: few enough to be far apart.
const BATCHES: usize = 64;

/// The size of surfels of which no more than `most` cover the points.
pub(super) fn size_for(scale: &Scale, most: usize) -> f32 {
    let spacing = &scale.spacing;
    let count = |size: f32| {
        let of = |d: &f32| f64::from(d / d.max(size)).powi(2);
        DISCS * spacing.par_iter().map(of).sum::<f64>()
    };
    let mut sizes = [0.0, spacing.par_iter().copied().reduce(|| 0.0, f32::max)];
    if count(f32::MIN_POSITIVE) <= most as f64 {
        return 0.0;
    }
    while count(sizes[1]) > most as f64 {
        sizes[1] *= 2.0;
    }
    for _ in 0..30 {
        let middle = 0.5 * (sizes[0] + sizes[1]);
        sizes[usize::from(count(middle) <= most as f64)] = middle;
    }
    sizes[1]
}

/// Covers the samples with patches of this size, smaller ones where the surface needs it and larger ones
/// where points are farther apart.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
pub(super) fn cover(
    samples: &Samples,
    scale: &Scale,
    neighbours: &Neighbours,
    size: f32,
    progress: &dyn Progress,
) -> Result<Vec<Patch>> {
    let n = samples.len();
    progress.stage("surfels", 2 * n as u64);
    let mut order: Vec<u32> = (0..n as u32).collect();
    order.shuffle(&mut stream(0, Purpose::Fit, u64::MAX));
    let mut cover = Cover {
        samples,
        scale,
        neighbours,
        size,
        covered: vec![false; n],
        patches: Vec::new(),
    };
    cover.take(&order, progress, &|cover, i| cover.patch(i, true))?;
    // Edges come last: what is beside them goes on there.
    let places: Vec<Vec3> = cover.patches.iter().map(|p| p.position).collect();
    if places.is_empty() {
        cover.take(&order, progress, &|cover, i| cover.patch(i, false))?;
        return Ok(cover.patches);
    }
    let (tree, whole) = (Neighbours::new(&places)?, places.len());
    cover.take(&order, progress, &|cover, i| {
        let beside = cover.continued(i, &tree, whole);
        beside.or_else(|| cover.patch(i, false))
    })?;
    Ok(cover.patches)
}

/// Patches so far.
struct Cover<'a> {
    samples: &'a Samples,
    scale: &'a Scale,
    neighbours: &'a Neighbours<'a>,
    /// Wanted.
    size: f32,
    /// Which samples they cover.
    covered: Vec<bool>,
    patches: Vec<Patch>,
}

/// A patch and the samples that it covers.
type Found = (Patch, Vec<u32>);

impl Cover<'_> {
    /// Takes what is found at samples that are not covered yet, one after the other.
    fn take(
        &mut self,
        order: &[u32],
        progress: &dyn Progress,
        find: &(dyn Fn(&Cover, usize) -> Option<Found> + Sync),
    ) -> Result<()> {
        for batch in order.chunks(order.len().div_ceil(BATCHES).clamp(256, 8192)) {
            progress.check()?;
            let open = batch.par_iter().filter(|&&i| !self.covered[i as usize]);
            let found: Vec<Found> = open.filter_map(|&i| find(self, i as usize)).collect();
            for (patch, on_it) in found {
                // One of the same batch may have come first.
                if !self.covered[patch.sample as usize] {
                    on_it.iter().for_each(|&k| self.covered[k as usize] = true);
                    self.covered[patch.sample as usize] = true;
                    self.patches.push(patch);
                }
            }
            progress.advance(batch.len() as u64);
        }
        Ok(())
    }

    /// The patch at a sample on the plane of one of the first so many patches beside it, which `tree` finds, if
    /// that goes on there.
    fn continued(&self, i: usize, tree: &Neighbours, whole: usize) -> Option<Found> {
        let place = self.samples.positions[i];
        let finest = self.scale.spacing[i].max(NOISE * self.scale.noise[i]);
        let beside = tree.around(place, LOOKED_AT.min(whole));
        let on = beside
            .iter()
            .map(|&k| &self.patches[k as usize])
            .filter(|patch| {
                place.distance(patch.position) < ON * patch.size
                    && patch.deviations(place).abs() < OFF
                    && patch.is_seen_with(self.samples, i as u32)
            });
        let next = on.min_by(|a, b| {
            let [a, b] =
                [a, b].map(|p| p.deviations(place).abs() + place.distance(p.position) / p.size);
            a.total_cmp(&b)
        })?;
        let size = finest.max(next.size.min(self.size.max(finest)));
        let plane = next.tangent_at(place);
        let near = self.neighbours.all_within(place, FOOTPRINT * size);
        let places = &self.samples.positions;
        let on: Vec<usize> = (0..near.len())
            .filter(|&k| next.deviations(places[near[k].0 as usize]).abs() < OFF)
            .filter(|&k| next.is_seen_with(self.samples, near[k].0))
            .collect();
        let around = on.iter().map(|&k| places[near[k].0 as usize] - place);
        if on.len() <= AT_LEAST || !is_around(&plane, around, size) {
            return None;
        }
        let covered: Vec<u32> = (on.iter())
            .filter(|&&k| near[k].1 <= size * size)
            .map(|&k| near[k].0)
            .collect();
        let patch = Patch {
            sample: i as u32,
            position: match next.flat {
                true => self.middle(&plane, place, &covered),
                false => plane.centre,
            },
            normal: plane.normal,
            size,
            spacing: self.scale.spacing[i],
            ..*next
        };
        Some((patch, covered))
    }

    /// Where samples are, from a place, and where they were seen from, if that is known of any.
    fn seen(&self, place: Vec3, near: &[(u32, f32)]) -> (Vec<Vec3>, Vec<Vec3>) {
        let way = |&(k, _): &(u32, f32)| self.samples.positions[k as usize] - place;
        let views = near.iter().filter_map(|n| self.samples.view(n.0));
        (near.iter().map(way).collect(), views.collect())
    }

    /// The middle of samples on a plane: a sample at an edge stands for what lies on one side of it.
    fn middle(&self, plane: &Plane, place: Vec3, samples: &[u32]) -> Vec3 {
        let places = samples
            .iter()
            .map(|&k| self.samples.positions[k as usize] - place);
        let middle = match samples.len() < FEW {
            true => Vec3::ZERO,
            false => places.sum::<Vec3>() / samples.len() as f32,
        };
        place + middle - plane.height(place + middle) * plane.normal
    }

    /// The patch at a sample and the samples that it covers; `None` where the sample is on no surface, or if a
    /// `whole` one is wanted where most of what is around is not on it.
    fn patch(&self, i: usize, whole: bool) -> Option<Found> {
        let Cover {
            samples,
            scale,
            neighbours,
            size: wanted,
            ..
        } = *self;
        let place = samples.positions[i];
        let noise = scale.noise[i];
        let finest = scale.spacing[i].max(NOISE * noise);
        let mut size = finest.max(wanted);
        let least = finest.max(SMALLEST * wanted);
        let mut random = stream(0, Purpose::Fit, i as u64);
        let mut widened = 0;
        loop {
            let all = neighbours.all_within(place, FOOTPRINT * size);
            let near: Vec<(u32, f32)> = (all.iter().copied())
                .step_by(all.len().div_ceil(MANY).max(1))
                .collect();
            let (places, views) = self.seen(place, &near);
            let around = Around {
                places: &places,
                views: &views,
                view: samples.view(i as u32).unwrap_or_default(),
                radius: FOOTPRINT * size,
                noise,
            };
            // The part of what is around that is on it.
            let part_on = |model: &Model| {
                // What was seen on its other side is no matter.
                let normal = model.tangent().normal;
                let inside = (0..near.len())
                    .filter(|&k| near[k].1 <= size * size && around.is_seen_with(normal, k));
                let (on, all) = inside.fold((0, 0), |(on, all), k| {
                    (on + u32::from(model.off(&around, k) <= 1.0), all + 1)
                });
                match model.off(&around, 0) <= 1.0 {
                    true => on as f32 / all as f32,
                    false => 0.0,
                }
            };
            let on = |model: &Model| {
                let seen = (0..near.len()).map(|k| model.off(&around, k));
                let seen = seen.filter(|off| off.is_finite());
                seen.fold((0.0_f32, 0.0), |(on, all), off| {
                    (on + f32::from(u8::from(off <= 1.0)), all + 1.0)
                })
            };
            let is_whole = |model: &Model| part_on(model) >= WHOLE;
            let is_part = |model: &Model| {
                part_on(model) >= PART && {
                    let on = (0..places.len()).filter(|&k| model.off(&around, k) <= 1.0);
                    is_around(&model.tangent(), on.map(|k| places[k]), size)
                }
            };
            let [bent, straight] = around.planes(&mut random)?;
            let flat = Model::Flat(straight);
            let tangent = Model::Tangent(bent);
            // Parts of all that is around: few points next to each other are on any surface.
            let (on_flat, of) = on(&flat);
            let curved = match on_flat >= FLAT * of && around.rough(&straight) < BENDS {
                true => None,
                false => Curved::fit(&around, &bent),
            };
            let round = curved.and_then(|curved| Round::fit(&around, &curved));
            let round = round
                .map(Model::Round)
                .filter(|round| is_whole(round) && on(round).0 >= ROUNDER * on_flat);
            let model = if let Some(round) = round {
                round
            } else if whole && on_flat < SUPPORT {
                return None;
            } else if is_whole(&flat) {
                flat
            } else if whole && is_part(&flat) {
                return None;
            } else if is_whole(&tangent) && around.is_flat(&bent) {
                tangent
            } else {
                match curved.map(Model::Curved).filter(is_whole) {
                    Some(curved) => curved,
                    None if is_part(&flat) => flat,
                    None if is_whole(&tangent) => tangent,
                    None if widened == 0 && size > least => {
                        size = least.max(0.5 * size);
                        continue;
                    }
                    None if whole => return None,
                    None => tangent,
                }
            };
            if model.off(&around, 0) > 1.0 {
                return None;
            }
            let offs: Vec<f32> = (0..places.len()).map(|k| model.off(&around, k)).collect();
            let on: Vec<usize> = (0..places.len()).filter(|&k| offs[k] <= 1.0).collect();
            let plane = model.tangent();
            let on_it = || on.iter().map(|&k| places[k]);
            let wide = Weighted::of(on_it().map(|p| (p, 1.0))).plane();
            let wide = wide.is_some_and(|p| p.is_wide()) && is_around(&plane, on_it(), size);
            let few = on.len() <= AT_LEAST;
            if few || !wide {
                // Among many of the other side the own side may be few; without views few are no surface.
                if widened == WIDENED || few && views.is_empty() {
                    return None;
                }
                widened += 1;
                size *= WIDER;
                continue;
            }
            let squares = on.iter().map(|&k| offs[k] * offs[k]).sum::<f32>();
            let spread = (squares / on.len() as f32).sqrt();
            // The point itself is the first one.
            let mut others: Vec<f32> = (on.iter().skip(1).take(BESIDE))
                .map(|&k| scale.spacing[near[k].0 as usize])
                .collect();
            let half = others.len() / 2;
            let usual = *others.select_nth_unstable_by(half, f32::total_cmp).1;
            if spread > SPREAD || scale.spacing[i] > ALONE * usual {
                return None;
            }
            let position = place - plane.height(Vec3::ZERO) * plane.normal;
            let flat = matches!(model, Model::Flat(_));
            let (places, views) = self.seen(place, &all);
            let around = Around {
                places: &places,
                views: &views,
                ..around
            };
            let within: Vec<usize> = (0..all.len())
                .take_while(|&k| all[k].1 <= size * size)
                .filter(|&k| match model {
                    Model::Flat(_) | Model::Round(_) => model.off(&around, k) <= 1.0,
                    _ => around.off(&plane, k) <= 1.0,
                })
                .collect();
            let covered: Vec<u32> = within.iter().map(|&k| all[k].0).collect();
            let position = match flat && !whole {
                true => self.middle(&plane.moved(place), place, &covered),
                false => position,
            };
            let squares = within.iter().map(|&k| plane.height(places[k]).powi(2));
            let mean = squares.sum::<f32>() / within.len().max(1) as f32;
            let (colour, mottled) = samples.mean_colour(&covered);
            let patch = Patch {
                sample: i as u32,
                position,
                normal: plane.normal,
                size,
                noise,
                rough: noise.max(mean.sqrt()),
                flat,
                round: match model {
                    Model::Round(round) => Some(round.moved(place)),
                    _ => None,
                },
                colour,
                mottled,
                spacing: scale.spacing[i],
                view: around.view,
                both: false,
            };
            return Some((patch, covered));
        }
    }
}

/// Whether places on a plane lie around the origin, not along a line.
fn is_around(plane: &Plane, places: impl Iterator<Item = Vec3>, size: f32) -> bool {
    let (tangent, bitangent) = plane.normal.any_orthonormal_pair();
    let next = NEXT.start * size..NEXT.end * size;
    let sectors = places
        .map(|p| Vec2::new(p.dot(tangent), p.dot(bitangent)))
        .filter(|p| next.contains(&p.length()))
        .fold(0_u32, |sectors, p| {
            let sector = (p.to_angle() / TAU + 0.5) * SECTORS;
            sectors | 1 << (sector as u32 % SECTORS as u32)
        });
    sectors.count_ones() >= AROUND
}
