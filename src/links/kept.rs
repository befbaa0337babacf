//! Links that are kept for other lights.
//!
//! Nothing of a link depends on the light but how much trouble it was worth: the radiosity of its
//! source, in units of the error that is allowed at its target ([`Accuracy::demand`]). A link that was
//! made for some demand is good for every light that demands no more of it; others are opened again.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::build::build_from;
use super::{Accuracy, Entry, Links, Rows};
use crate::error::Result;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::Visibility;

/// What counts as no more, for another light. Rough solutions know a demand about that well. The light
/// of a lamp that moved is measured to be off no more than by links made for it (`cargo bench --bench
/// relight`, 128,000 points): in cornell's corner by 2.2% (2.3% afresh), behind a block by 1.4% (1.4%),
/// in the other room by 1.5% (1.6%).
pub const SLACK: f32 = 2.0;

/// Links with tested visibility, what each of them was made for, and what has none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    pub links: Links,
    /// Demands of the links in `links.m2l`, by order.
    pub(crate) m2l: Vec<Vec<f32>>,
    /// And of those in `links.sampled`. Form factors of single surfels meet all demands.
    pub(crate) sampled: Vec<f32>,
    /// Pairs of facets that are not linked, as they bring too little for the demand that is their
    /// weight here, or no sample of them saw anything.
    pub(crate) left_out: Rows,
}

impl Kept {
    /// Nothing is linked, as if there were no light yet.
    pub fn none(octree: &Octree, surfels: &Surfels) -> Kept {
        let all = Entry {
            target: 0,
            source: 0,
            weight: 0.0,
        };
        let facets = octree.facets.len();
        Kept {
            links: Links::none(facets, surfels.len()),
            m2l: Vec::new(),
            sampled: Vec::new(),
            left_out: Rows::new(facets, vec![all]),
        }
    }

    /// Whether no light has been there yet.
    pub fn is_none(&self) -> bool {
        self.left_out.sources == [0] && self.left_out.weights == [0.0]
    }

    /// Opens again what a light demands more of than `slack` times what it was made for, and finds the
    /// links below. Returns how many pairs of facets that were.
    pub fn refine(
        &mut self,
        surfels: &Surfels,
        octree: &Octree,
        accuracy: &Accuracy,
        slack: f32,
        visibility: &dyn Visibility,
        progress: &dyn Progress,
    ) -> Result<usize> {
        let demand = |pair| accuracy.demand(pair);
        let mut opened = Vec::new();
        for (rows, demands) in self.links.m2l.iter_mut().zip(&mut self.m2l) {
            take_out(rows, demands, &mut opened, slack, demand);
        }
        let Links { sampled, .. } = &mut self.links;
        take_out(sampled, &mut self.sampled, &mut opened, slack, demand);
        let mut demands = self.left_out.weights.clone();
        take_out(&mut self.left_out, &mut demands, &mut opened, slack, demand);
        if opened.is_empty() {
            return Ok(0);
        }
        match build_from(&opened, surfels, octree, accuracy, visibility, progress) {
            Ok(found) => {
                self.add(found.links, demand);
                self.leave_out(&found.left_out, demand);
                Ok(opened.len())
            }
            Err(error) => {
                // They have no links now, and wait for another try.
                self.leave_out(&opened, |_| 0.0);
                Err(error)
            }
        }
    }

    /// Remembers pairs of facets without a link.
    fn leave_out(&mut self, pairs: &[[u32; 2]], demand: impl Fn([u32; 2]) -> f32) {
        let entry = |&pair: &[u32; 2]| Entry {
            target: pair[0],
            source: pair[1],
            weight: demand(pair),
        };
        let facets = self.left_out.offsets.len() - 1;
        let more = Rows::new(facets, pairs.iter().map(entry).collect());
        self.left_out = joined(&self.left_out, &more);
    }

    /// Puts links beside those that there are.
    fn add(&mut self, more: Links, demand: impl Fn([u32; 2]) -> f32 + Copy) {
        let links = &mut self.links;
        let targets = links.sampled.offsets.len() - 1;
        let orders = links.m2l.len().max(more.m2l.len());
        links.m2l.resize_with(orders, || Rows::none(targets));
        self.m2l.resize_with(orders, Vec::new);
        let m2l = links.m2l.iter_mut().zip(&mut self.m2l).zip(&more.m2l);
        for ((rows, demands), more) in m2l {
            add(rows, demands, more, demand);
        }
        add(&mut links.sampled, &mut self.sampled, &more.sampled, demand);
        links.near = joined(&links.near, &more.near);
        // Which of those that were taken out were smooth, nobody knows any more.
        let all: usize = links.m2l.iter().map(Rows::len).sum();
        links.smooth = (links.smooth + more.smooth).min(all as u64);
        links.expected_error = links.expected_error.hypot(more.expected_error);
    }
}

/// Moves links that do not meet their demand to `opened`.
fn take_out(
    rows: &mut Rows,
    demands: &mut Vec<f32>,
    opened: &mut Vec<[u32; 2]>,
    slack: f32,
    demand: impl Fn([u32; 2]) -> f32 + Sync,
) {
    let pairs: Vec<[u32; 2]> = rows
        .targets()
        .zip(&rows.sources)
        .map(|(t, &s)| [t, s])
        .collect();
    let stays: Vec<bool> = (pairs.par_iter().zip(&*demands))
        .map(|(&pair, &made_for)| demand(pair) <= slack * made_for)
        .collect();
    let (staying, leaving): (Vec<usize>, Vec<usize>) = (0..pairs.len()).partition(|&k| stays[k]);
    if leaving.is_empty() {
        return;
    }
    opened.extend(leaving.into_iter().map(|k| pairs[k]));
    let mut offsets = vec![0; rows.offsets.len()];
    staying
        .iter()
        .for_each(|&k| offsets[pairs[k][0] as usize + 1] += 1);
    for t in 1..offsets.len() {
        offsets[t] += offsets[t - 1];
    }
    rows.offsets = offsets;
    rows.sources = staying.iter().map(|&k| rows.sources[k]).collect();
    rows.weights = staying.iter().map(|&k| rows.weights[k]).collect();
    *demands = staying.iter().map(|&k| demands[k]).collect();
}

/// Puts more links behind those of the same row.
fn add(rows: &mut Rows, demands: &mut Vec<f32>, more: &Rows, demand: impl Fn([u32; 2]) -> f32) {
    let pairs = more.targets().zip(&more.sources);
    let of_more: Vec<f32> = pairs.map(|(t, &s)| demand([t, s])).collect();
    *demands = row_by_row([&rows.offsets, &more.offsets], [demands, &of_more]);
    *rows = joined(rows, more);
}

fn joined(a: &Rows, b: &Rows) -> Rows {
    let offsets = [a.offsets.as_slice(), &b.offsets];
    Rows {
        offsets: a
            .offsets
            .iter()
            .zip(&b.offsets)
            .map(|(a, b)| a + b)
            .collect(),
        sources: row_by_row(offsets, [&a.sources, &b.sources]),
        weights: row_by_row(offsets, [&a.weights, &b.weights]),
    }
}

/// Values of two lists of the same targets, each row of the first followed by that of the second.
fn row_by_row<T: Copy>(offsets: [&[u32]; 2], values: [&[T]; 2]) -> Vec<T> {
    let mut all = Vec::with_capacity(values[0].len() + values[1].len());
    for t in 1..offsets[0].len() {
        for (offsets, values) in offsets.iter().zip(values) {
            all.extend_from_slice(&values[offsets[t - 1] as usize..offsets[t] as usize]);
        }
    }
    all
}
