//! Light from surfels that shine.
//!
//! The emitters have an octree of their own. Each receiver descends it to the clusters that it can
//! tell apart; their light without occlusion is summed up. A few segments, to emitters drawn in
//! proportion to their light, give the visible part; more where those of a receiver and of its
//! neighbours do not agree.

use glam::{DVec3, Vec3, Vec3A};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::{noise_of_half, smoothed};
use crate::error::Result;
use crate::expansion::{Expansions, NEAR_SPACINGS, Surface, Workspace};
use crate::octree::{LEAF_SIZE, Octree};
use crate::passes::cpu::{m2m, p2m};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, stream};
use crate::smoothing::Smoother;
use crate::visibility::{Segment, Visibility, in_rows};

/// Segments a receiver, at least and at most: as many as find, with those of its neighbours, a shadow
/// that takes this part of the tolerance off the light.
const SEGMENTS: [usize; 2] = [8, 16];
const SHADOW: f64 = 0.7;
/// Further ones where the first do not agree, at a tolerance of 0.03, and the most at any.
const MORE_SEGMENTS: [f64; 2] = [48.0, 1000.0];
/// Receivers before and after one, in the octree's order, that tell whether a shadow is near: where
/// few segments all miss its edge.
const NEIGHBOURS: usize = 4;
/// Order of the clusters' expansions.
const ORDER: usize = 3;
/// Error that they may make at worst, in units of the tolerance, and the largest clusters.
pub const EXPANSIONS: f64 = 0.5;
const LARGEST_OPENING: f64 = 0.6;

/// Irradiance from the surfels' emission, with the visible part as it was sampled.
pub fn emitters(
    surfels: &Surfels,
    tolerance: f64,
    seed: u64,
    visibility: &dyn Visibility,
    progress: &dyn Progress,
) -> Result<Vec<DVec3>> {
    Ok(emitted(surfels, tolerance, EXPANSIONS, seed, visibility, progress)?.irradiance())
}

/// Light from the surfels' emission.
pub struct Emitted {
    /// Irradiance if nothing is in the way.
    unoccluded: Vec<DVec3>,
    /// Part of it that arrives.
    visible: Vec<DVec3>,
    /// Standard deviation of a part of one half.
    noise: f64,
}

impl Emitted {
    pub fn irradiance(&self) -> Vec<DVec3> {
        let parts = self.unoccluded.iter().zip(&self.visible);
        parts.map(|(light, part)| *light * *part).collect()
    }

    /// Smooths the noise of penumbras over the surface.
    pub fn smooth(&mut self, smoother: &Smoother) {
        self.visible = smoothed(&self.visible, self.noise, smoother);
    }
}

/// Surfels that are lit in one batch: each holds up to some thousand clusters.
pub(crate) const RECEIVERS: usize = 1 << 12;

/// Finds the light from the surfels' emission. Expansions may be off by so many tolerances at worst; as a
/// rule it is a tenth of that.
pub fn emitted(
    surfels: &Surfels,
    tolerance: f64,
    expansions: f64,
    seed: u64,
    visibility: &dyn Visibility,
    progress: &dyn Progress,
) -> Result<Emitted> {
    let shining: Vec<u32> = (0..surfels.len() as u32)
        .filter(|&i| surfels.emission[i as usize].max_element() > 0.0)
        .collect();
    let mut emitted = Emitted {
        unoccluded: vec![DVec3::ZERO; surfels.len()],
        visible: vec![DVec3::ZERO; surfels.len()],
        noise: 0.0,
    };
    if shining.is_empty() {
        return Ok(emitted);
    }
    let emitters = Emitters::new(surfels, &shining, expansions * tolerance);
    // From K strata the visible part of a lamp with a straight shadow on it is off by K^(-3/4).
    let [more, limit] = MORE_SEGMENTS;
    let more = (more * (0.03 / tolerance).powf(4.0 / 3.0)).min(limit) as usize;
    let [least, most] = SEGMENTS;
    let together = (2 * NEIGHBOURS + 1) as f64 * SHADOW * tolerance;
    let segments = (together.recip() as usize).clamp(least, most);
    emitted.noise = noise_of_half(segments + more);
    progress.stage("emitters", surfels.len() as u64);
    for first in (0..surfels.len()).step_by(RECEIVERS) {
        progress.check()?;
        let batch = first..(first + RECEIVERS).min(surfels.len());
        let mut receivers: Vec<Receiver> = batch
            .clone()
            .into_par_iter()
            .map_init(
                || Workspace::new(emitters.moments.indices()),
                |workspace, i| emitters.receiver(i, seed, workspace),
            )
            .collect();
        for (count, everywhere) in [(segments, true), (more, false)] {
            let in_doubt = in_doubt(&receivers);
            let drawn: Vec<Vec<Drawn>> = receivers
                .par_iter_mut()
                .zip(in_doubt)
                .map(|(r, in_doubt)| match everywhere || in_doubt {
                    true => emitters.draw(r, count),
                    false => Vec::new(),
                })
                .collect();
            let segments: Vec<Segment> = receivers
                .par_iter()
                .zip(&drawn)
                .flat_map_iter(|(r, drawn)| {
                    drawn
                        .iter()
                        .map(|d| surfels.segment(r.index, d.emitter as usize))
                })
                .collect();
            let visible = visibility.visible(&segments)?;
            let of_each = in_rows(&visible, drawn.iter().map(Vec::len));
            let answered = receivers.par_iter_mut().zip(&drawn).zip(of_each);
            answered.for_each(|((r, drawn), seen)| {
                drawn
                    .iter()
                    .zip(seen)
                    .for_each(|(d, seen)| r.count(d, *seen));
            });
        }
        for (i, r) in batch.clone().zip(&receivers) {
            emitted.unoccluded[i] = r.unoccluded;
            emitted.visible[i] = r.visible();
        }
        progress.advance(batch.len() as u64);
    }
    Ok(emitted)
}

/// Which receivers may have a shadow's edge on them: not all segments, theirs and those of their
/// neighbours, say the same.
fn in_doubt(receivers: &[Receiver]) -> Vec<bool> {
    (0..receivers.len())
        .into_par_iter()
        .map(|k| {
            let near = k.saturating_sub(NEIGHBOURS)..(k + NEIGHBOURS + 1).min(receivers.len());
            let (mut some, mut all) = (false, true);
            for r in &receivers[near] {
                some |= r.seen != DVec3::ZERO;
                all &= r.seen == r.tested;
            }
            some && !all
        })
        .collect()
}

/// The emitters with their octree and moments.
struct Emitters {
    octree: Octree,
    /// Of the emitters, in the order of their octree.
    emission: Vec<DVec3>,
    /// All surfels: the receivers.
    all: Surface<f64>,
    /// Of each emitter in the power of its leaf, all colours together.
    shares: Vec<Share>,
    /// Of each facet in the power of its parent. Each is of a sum of its own: dim ones keep their share
    /// among themselves, however bright others are.
    facet_shares: Vec<Share>,
    /// Index among all surfels.
    index: Vec<u32>,
    /// Of the emission in units of the brightest, which f32 can hold whatever it is.
    moments: Expansions<f32>,
    unit: f64,
    /// Relative error that expansions may make: (radius / distance)^(order + 1).
    error: f64,
    /// So clusters may be this large, in units of their distance.
    opening: f64,
}

/// A cluster of emitters or a single one, as a receiver sees it.
#[derive(Clone, Copy)]
struct Item {
    source: Source,
    /// What it brings if nothing is in the way.
    irradiance: DVec3,
}

/// Facets and emitters by their numbers.
#[derive(Clone, Copy)]
enum Source {
    Cluster(u32),
    Emitter(usize),
}

/// A place on an emitter to which a segment goes.
struct Drawn {
    emitter: u32,
    /// Light that the segment stands for.
    light: DVec3,
}

/// A surfel that takes light.
struct Receiver {
    index: usize,
    items: Vec<Item>,
    random: Pcg64Mcg,
    unoccluded: DVec3,
    tested: DVec3,
    seen: DVec3,
    /// Whether these are of all emitters.
    is_exact: bool,
}

impl Receiver {
    fn count(&mut self, drawn: &Drawn, seen: bool) {
        self.tested += drawn.light;
        if seen {
            self.seen += drawn.light;
        }
    }

    /// The visible part, channel by channel.
    fn visible(&self) -> DVec3 {
        self.seen / self.tested.max(DVec3::splat(f64::MIN_POSITIVE))
    }
}

impl Emitters {
    fn new(surfels: &Surfels, shining: &[u32], error: f64) -> Self {
        let subset = surfels.reordered(shining);
        let (octree, sorted) = Octree::build(&subset, LEAF_SIZE);
        // `points` follows every reordering, so it finds the way back.
        let place: std::collections::HashMap<u32, u32> = shining
            .iter()
            .map(|&i| (surfels.points[i as usize], i))
            .collect();
        let brightest = sorted.emission.iter().map(|e| e.max_element());
        let unit = brightest.fold(f32::MIN_POSITIVE, f32::max);
        let relative: Vec<Vec3> = sorted.emission.iter().map(|e| *e / unit).collect();
        let mut moments = p2m(ORDER, &octree, &Surface::<f32>::new(&sorted), &relative);
        m2m(&octree, &mut moments);
        let emission: Vec<DVec3> = sorted.emission.iter().map(|e| e.as_dvec3()).collect();
        let power = |e: usize| emission[e].element_sum() * f64::from(sorted.areas[e]);
        let power_of = |f: u32| f64::from(moments.of(f as usize)[0].element_sum());
        let mut emitter_shares = vec![Share::default(); sorted.len()];
        let mut facet_shares = vec![Share::default(); octree.facets.len()];
        for facet in &octree.facets {
            let of_children = facet.children();
            for (f, share) in of_children.clone().zip(shares(of_children.map(power_of))) {
                facet_shares[f as usize] = share;
            }
            if facet.is_leaf() {
                let emitters = facet.surfels();
                for (e, share) in emitters.clone().zip(shares(emitters.map(power))) {
                    emitter_shares[e] = share;
                }
            }
        }
        Emitters {
            octree,
            shares: emitter_shares,
            facet_shares,
            index: sorted.points.iter().map(|p| place[p]).collect(),
            emission,
            all: Surface::new(surfels),
            moments,
            unit: unit.into(),
            error,
            opening: error.powf(1.0 / (ORDER + 1) as f64).min(LARGEST_OPENING),
        }
    }

    /// The clusters that light surfel `i`.
    fn receiver(&self, i: usize, seed: u64, workspace: &mut Workspace<f32>) -> Receiver {
        let mut items = Vec::new();
        let mut stack = vec![0_u32];
        while let Some(f) = stack.pop() {
            let facet = &self.octree.facets[f as usize];
            let (x, n) = (self.all.positions[i], self.all.normals[i]);
            let way = x - facet.centre.as_dvec3();
            let distance = way.length();
            let radius = f64::from(facet.radius);
            // Heights of the emitters above the receiver and of the receiver above them.
            let above = -n.dot(way);
            let axis = facet.axis.as_dvec3();
            let height = axis.dot(way);
            let slack = f64::from(facet.spread) * (distance + radius);
            // A cell may rise above a horizon that its surfel lies below.
            let reach = f64::from(facet.reach);
            if above + radius + reach <= 0.0 || height - f64::from(facet.slab[0]) + slack <= 0.0 {
                continue;
            }
            let faces = above >= radius && height - f64::from(facet.slab[1]) >= slack;
            let spacing = self.all.areas[i].sqrt().max(f64::from(facet.spacing));
            let far = distance - radius >= NEAR_SPACINGS * spacing;
            if faces && far && radius <= self.opening * distance {
                let source = self.moments.of(f as usize);
                let size = radius / distance;
                let fits = |&p: &usize| size.powi(p as i32 + 1) <= self.error;
                let order = (0..ORDER).find(fits).unwrap_or(ORDER);
                let way = way.as_vec3();
                let light = workspace.m2p(order, source, facet.scale(), way, n.as_vec3());
                items.push(Item {
                    source: Source::Cluster(f),
                    irradiance: self.unit * light.max(Vec3A::ZERO).as_dvec3(),
                });
            } else if facet.is_leaf() {
                items.extend(facet.surfels().filter_map(|e| self.single(i, e)));
            } else {
                stack.extend(facet.children().rev());
            }
        }
        Receiver {
            index: i,
            unoccluded: items.iter().map(|item| item.irradiance).sum(),
            items,
            random: stream(seed, Purpose::Emitters, i as u64),
            tested: DVec3::ZERO,
            seen: DVec3::ZERO,
            is_exact: false,
        }
    }

    fn single(&self, i: usize, e: usize) -> Option<Item> {
        let form_factor = self.all.form_factor(i, self.index[e] as usize);
        let irradiance = self.emission[e] * form_factor;
        (form_factor > 0.0).then_some(Item {
            source: Source::Emitter(e),
            irradiance,
        })
    }

    /// Draws emitters in proportion to their light, one from each of `count` equal parts of it; all of
    /// them once where there are no more than `count`.
    fn draw(&self, r: &mut Receiver, count: usize) -> Vec<Drawn> {
        if r.unoccluded == DVec3::ZERO {
            return Vec::new();
        }
        // Every colour counts alike, however weak: each has its own shadows.
        let whole = r.unoccluded.max(DVec3::splat(f64::MIN_POSITIVE));
        let inverse = whole.recip();
        let share = |item: &Item| item.irradiance.dot(inverse);
        let total: f64 = r.items.iter().map(share).sum();
        let single = |item: &Item| match item.source {
            Source::Emitter(e) => Some(Drawn {
                emitter: self.index[e],
                light: item.irradiance,
            }),
            Source::Cluster(_) => None,
        };
        if r.items.len() <= count
            && let Some(all) = r.items.iter().map(single).collect()
        {
            if r.is_exact {
                return Vec::new();
            }
            (r.tested, r.seen, r.is_exact) = (DVec3::ZERO, DVec3::ZERO, true);
            return all;
        }
        let step = total / count as f64;
        let mut next = step * r.random.random::<f64>();
        let mut before = 0.0;
        let mut drawn = Vec::with_capacity(count);
        for item in &r.items {
            let share = share(item);
            while next < before + share && drawn.len() < count {
                let Some((e, part)) = self.member(item.source, (next - before) / share) else {
                    break;
                };
                let emitter = self.index[e];
                let form_factor = self.all.form_factor(r.index, emitter as usize);
                drawn.push(Drawn {
                    emitter,
                    light: self.emission[e] * (form_factor / (part * share)),
                });
                next = step * (drawn.len() as f64 + r.random.random::<f64>());
            }
            before += share;
        }
        drawn
    }

    /// The emitter at a place, from 0 to 1, in the power of a source, and its part of that power.
    fn member(&self, source: Source, mut place: f64) -> Option<(usize, f64)> {
        let mut part = 1.0;
        let mut at = match source {
            Source::Emitter(e) => return Some((e, 1.0)),
            Source::Cluster(f) => f,
        };
        let facets = &self.octree.facets;
        while !facets[at as usize].is_leaf() {
            let children = facets[at as usize].children();
            let slice = children.start as usize..children.end as usize;
            let (child, inside, share) = find(&self.facet_shares[slice], place)?;
            (at, place) = (children.start + child as u32, inside);
            part *= share;
        }
        let emitters = facets[at as usize].surfels();
        let (emitter, _, share) = find(&self.shares[emitters.clone()], place)?;
        Some((emitters.start + emitter, part * share))
    }
}

/// Part of something whole.
#[derive(Clone, Copy, Default)]
struct Share {
    /// The parts before it.
    before: f64,
    part: f64,
}

/// The shares of some weights in their sum; zero if there is no weight.
fn shares(weights: impl Iterator<Item = f64> + Clone) -> impl Iterator<Item = Share> {
    let total: f64 = weights.clone().sum();
    let inverse = if total > 0.0 { 1.0 / total } else { 0.0 };
    weights.scan(0.0, move |before, weight| {
        let share = Share {
            before: *before,
            part: weight * inverse,
        };
        *before += share.part;
        Some(share)
    })
}

/// The share at a place, from 0 to 1, if there is any: which, the place in it, and its part.
fn find(shares: &[Share], place: f64) -> Option<(usize, f64, f64)> {
    let some = |(_, share): &(usize, &Share)| share.part > 0.0;
    let mut found = None;
    for (k, share) in shares.iter().enumerate().filter(some) {
        found = Some((k, share));
        if place < share.before + share.part {
            break;
        }
    }
    let (k, share) = found?;
    let inside = (place - share.before) / share.part;
    Some((k, inside.clamp(0.0, 1.0), share.part))
}
