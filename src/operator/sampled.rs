//! Unbiased estimates of the exact irradiance at single surfels: what the error of any other way is
//! measured against where exact sums cost too much.
//!
//! A receiver parts the octree into clusters that it can tell apart and draws sources from them in
//! proportion to what they may bring: by bounds from afar, by exact form factors in the leaves. Every
//! source that can bring anything can be drawn, so that the mean over all draws is the exact sum,
//! whatever the bounds are worth; they decide on the noise only.

use glam::DVec3;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::error::Result;
use crate::expansion::Surface;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::visibility::{Segment, Visibility};

/// Clusters may be this large, in units of their distance.
const OPENING: f32 = 0.35;
/// Part of the largest possible cosine that a cluster counts with at least: parts of it may lie
/// higher than its middle.
const LEAST_COSINE: f32 = 0.25;
/// Segments tested in one batch, about.
const BATCH: usize = 1 << 18;

/// Draws sources of a field of radiosity.
pub struct Sampler<'a> {
    octree: &'a Octree,
    surfels: &'a Surfels,
    surface: &'a Surface<f32>,
    radiosity: &'a [DVec3],
    /// Of each facet, all colours together.
    power: Vec<f32>,
}

/// Two estimates that are wanted.
#[derive(Clone, Copy, Debug)]
pub struct Draw {
    pub receiver: u32,
    /// Sources to draw for each of the two.
    pub count: u32,
}

/// A source that was drawn, and the light that it stands for if nothing is in the way.
struct Drawn {
    source: u32,
    light: DVec3,
}

impl<'a> Sampler<'a> {
    /// `surfels` are those in the octree's order, `radiosity` is nowhere negative.
    pub fn new(
        octree: &'a Octree,
        surfels: &'a Surfels,
        surface: &'a Surface<f32>,
        radiosity: &'a [DVec3],
    ) -> Self {
        let facets = &octree.facets;
        let mut power = vec![0.0; facets.len()];
        // Children come after their parents.
        for (f, facet) in facets.iter().enumerate().rev() {
            power[f] = match facet.is_leaf() {
                true => facet
                    .surfels()
                    .map(|j| surfels.areas[j] * radiosity[j].element_sum() as f32)
                    .sum(),
                false => facet.children().map(|c| power[c as usize]).sum(),
            };
        }
        Sampler {
            octree,
            surfels,
            surface,
            radiosity,
            power,
        }
    }

    /// Two independent estimates for each of `draws`, by the random numbers of `random(k)` for the
    /// k-th. Their noise falls with the number of sources drawn as number^(-3/4) or so.
    pub fn estimate(
        &self,
        draws: &[Draw],
        random: impl Fn(usize) -> Pcg64Mcg + Sync,
        visibility: &dyn Visibility,
    ) -> Result<Vec<[DVec3; 2]>> {
        let mut estimates = Vec::with_capacity(draws.len());
        while estimates.len() < draws.len() {
            let first = estimates.len();
            let mut wanted = 0;
            let fits = |d: &&Draw| {
                wanted += 2 * d.count as usize;
                wanted <= BATCH
            };
            let batch = draws[first..].iter().take_while(fits).count().max(1);
            let drawn: Vec<[Vec<Drawn>; 2]> = draws[first..first + batch]
                .par_iter()
                .enumerate()
                .map_init(Vec::new, |items, (k, draw)| {
                    self.draw(draw, &mut random(first + k), items)
                })
                .collect();
            let pairs = draws[first..first + batch].par_iter().zip(&drawn);
            let segments: Vec<Segment> = pairs
                .flat_map_iter(|(draw, drawn)| {
                    let i = draw.receiver;
                    drawn.iter().flatten().map(move |d| {
                        let (low, high) = (i.min(d.source), i.max(d.source));
                        self.surfels.segment(low as usize, high as usize)
                    })
                })
                .collect();
            let mut visible = visibility.visible(&segments)?.into_iter();
            let mut light = |drawn: &Vec<Drawn>| {
                let seen = drawn.iter().zip(visible.by_ref()).filter(|&(_, v)| v);
                seen.map(|(d, _)| d.light).sum::<DVec3>()
            };
            estimates.extend(drawn.iter().map(|both| both.each_ref().map(&mut light)));
        }
        Ok(estimates)
    }

    /// Draws sources twice, one from each of `count` equal parts of what may arrive.
    fn draw(
        &self,
        draw: &Draw,
        random: &mut Pcg64Mcg,
        items: &mut Vec<(u32, f64)>,
    ) -> [Vec<Drawn>; 2] {
        let i = draw.receiver as usize;
        self.clusters(i, items);
        let total: f64 = items.iter().map(|&(_, weight)| weight).sum();
        let parts = f64::from(draw.count);
        [(); 2].map(|()| {
            let mut drawn = Vec::with_capacity(draw.count as usize);
            if total > 0.0 {
                let mut places: Vec<f64> = (0..draw.count)
                    .map(|k| (f64::from(k) + random.random::<f64>()) * total / parts)
                    .collect();
                self.share(i, 0, &mut places, parts / total, items, &mut drawn);
            }
            drawn
        })
    }

    /// The clusters that a receiver can tell apart, with what they may bring, in the octree's order.
    fn clusters(&self, i: usize, items: &mut Vec<(u32, f64)>) {
        items.clear();
        let mut stack = vec![0_u32];
        while let Some(f) = stack.pop() {
            let weight = self.weight(i, f);
            if weight <= 0.0 {
                continue;
            }
            let facet = &self.octree.facets[f as usize];
            let distance = facet.centre.distance(self.surface.positions[i]);
            if facet.radius <= OPENING * distance && facet.reach <= OPENING * distance {
                items.push((f, weight));
            } else if facet.is_leaf() {
                // Nearby, where bounds are worth little, what it does bring.
                let light = self.of_leaf(i, f).map(|(_, _, light)| light).sum();
                if light > 0.0 {
                    items.push((f, light));
                }
            } else {
                stack.extend(facet.children().rev());
            }
        }
    }

    /// Hands each of the facets in `items`, from the `first` one on, the places that lie in its weight, in
    /// increasing order; `rate` is the number of draws that are expected a unit of weight.
    fn share(
        &self,
        i: usize,
        first: usize,
        mut places: &mut [f64],
        rate: f64,
        items: &mut Vec<(u32, f64)>,
        drawn: &mut Vec<Drawn>,
    ) {
        let end = items.len();
        let mut before = 0.0;
        for k in first..end {
            let (f, weight) = items[k];
            let inside = match k + 1 == end {
                true => places.len(), // whatever rounding says
                false => places.partition_point(|&p| p < before + weight),
            };
            let (own, others) = places.split_at_mut(inside);
            for place in own.iter_mut() {
                *place = ((*place - before) / weight).clamp(0.0, 1.0);
            }
            if !own.is_empty() {
                self.descend(i, f, own, rate * weight, items, drawn);
            }
            places = others;
            before += weight;
            if places.is_empty() {
                break;
            }
        }
    }

    /// Draws from a facet at places from 0 to 1; `expected` is the number of draws expected in it. There is
    /// room for its children behind the `items`.
    fn descend(
        &self,
        i: usize,
        f: u32,
        places: &mut [f64],
        expected: f64,
        items: &mut Vec<(u32, f64)>,
        drawn: &mut Vec<Drawn>,
    ) {
        let facet = &self.octree.facets[f as usize];
        if facet.is_leaf() {
            return self.draw_in_leaf(i, f, places, expected, drawn);
        }
        let first = items.len();
        let children = facet.children().map(|c| (c, self.weight(i, c)));
        items.extend(children.filter(|&(_, weight)| weight > 0.0));
        let total: f64 = items[first..].iter().map(|&(_, weight)| weight).sum();
        for place in places.iter_mut() {
            *place *= total;
        }
        self.share(i, first, places, expected / total, items, drawn);
        items.truncate(first);
    }

    /// In a leaf sources are drawn in proportion to what they do bring if nothing is in the way.
    fn draw_in_leaf(
        &self,
        i: usize,
        f: u32,
        places: &[f64],
        expected: f64,
        drawn: &mut Vec<Drawn>,
    ) {
        let sources = self.of_leaf(i, f);
        let total: f64 = sources.clone().map(|(_, _, light)| light).sum();
        for place in places {
            let mut left = place * total;
            let mut picked = None;
            for (j, form_factor, light) in sources.clone() {
                picked = Some((j, form_factor, light));
                left -= light;
                if left < 0.0 {
                    break;
                }
            }
            if let Some((j, form_factor, light)) = picked {
                let times = expected * light / total;
                drawn.push(Drawn {
                    source: j as u32,
                    light: self.radiosity[j] * (form_factor / times),
                });
            }
        }
    }

    /// The surfels of a leaf that bring light, with their form factors and what they bring if nothing
    /// is in the way, all colours together.
    fn of_leaf(&self, i: usize, f: u32) -> impl Iterator<Item = (usize, f64, f64)> + Clone {
        let brings = move |j: usize| {
            let form_factor = f64::from(self.surface.form_factor(i, j));
            (
                j,
                form_factor,
                form_factor * self.radiosity[j].element_sum(),
            )
        };
        let sources = self.octree.facets[f as usize].surfels().map(brings);
        sources.filter(|&(_, _, light)| light > 0.0)
    }

    /// What a facet may bring to a receiver, about: its radiosity times the form factor of a disc as
    /// large. 0 only where it brings nothing.
    fn weight(&self, i: usize, f: u32) -> f64 {
        let power = self.power[f as usize];
        if power <= 0.0 {
            return 0.0;
        }
        let facet = &self.octree.facets[f as usize];
        let way = self.surface.positions[i] - facet.centre;
        let square = way.length_squared();
        let reach = square.sqrt() + facet.radius;
        // Heights of the source above the receiver's horizon and of the receiver above that of the
        // source: of the centres, and at most. A cell may rise above a horizon that its surfel lies
        // below.
        let above = -self.surface.normals[i].dot(way);
        let most_above = above + facet.radius + facet.reach;
        let height = facet.axis.dot(way);
        let most_height = height - facet.slab[0] + facet.spread * reach;
        let rounding = 1e-5 * reach;
        if most_above <= -rounding || most_height <= -rounding {
            return 0.0;
        }
        let cosine = |height: f32, most: f32| {
            let likely = height.max(LEAST_COSINE * most.max(rounding));
            likely / (square.sqrt() + LEAST_COSINE * (facet.radius + facet.reach))
        };
        let disc = std::f32::consts::PI * square + facet.area;
        f64::from(power * cosine(above, most_above) * cosine(height, most_height) / disc)
    }
}
