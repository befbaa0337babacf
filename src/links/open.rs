//! Links where nothing is in the way: pure N-body sums, without any segment.

use rayon::prelude::*;

use super::{Accuracy, Entry, Links, MIXED_ORDER, Rows, build};
use crate::error::Result;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::NothingInTheWay;

/// Part of the expected error that is found at most. Measured in cornell, organic, the cave and at
/// random (`tests/open.rs`), for tolerances from 0.1 to 1e-4: 0.1 to 0.6.
const FOUND: f64 = 0.65;

/// Finds links whose errors are expected to be at most `accuracy.error` together, root mean square
/// over the surfels: that of each link, before the factors of the targets, follows from their number.
pub fn build_open(
    surfels: &Surfels,
    octree: &Octree,
    accuracy: &Accuracy,
    progress: &dyn Progress,
) -> Result<Links> {
    let allowed = f64::from(accuracy.error);
    let mut accuracy = Accuracy {
        error: 0.5 * accuracy.error,
        ..accuracy.clone()
    };
    loop {
        let links = build(surfels, octree, &accuracy, &NothingInTheWay, progress)?;
        let excess = FOUND * links.expected_error / allowed;
        // Numbers that are none, or too small, end it as well.
        if excess > 1.0 && accuracy.error.is_normal() {
            // Smaller errors take more links, which adds to their sum.
            accuracy.error /= (1.1 * excess.powf(1.3)) as f32;
        } else {
            return Ok(with_cheap_pairs(links, octree));
        }
    }
}

/// Part of all pairs of surfels that P2P takes at most where an expansion is accurate enough.
const DIRECT: f64 = 0.09;

/// The same links, but surfel by surfel where that is cheaper than the expansion.
fn with_cheap_pairs(mut links: Links, octree: &Octree) -> Links {
    let facets = &octree.facets;
    let pairs = |t: usize, s: usize| facets[t].len() * facets[s].len();
    let surfels = facets[0].len() as f64;
    let taken: usize = (0..facets.len())
        .flat_map(|t| links.p2p.row(t).map(move |(s, _)| pairs(t, s)))
        .sum();
    let most = (DIRECT * surfels * surfels) as usize;
    let mut left = most.saturating_sub(taken + links.near.len());
    let mut p2p = entries(&links.p2p);
    let mut take = |rows: &Rows, cost: &dyn Fn(usize, usize) -> usize| -> Rows {
        let (mut kept, mut moved) = (Vec::new(), Vec::new());
        let mut all = entries(rows);
        // Small facets gain most a pair.
        all.par_sort_by_key(|e| pairs(e.target as usize, e.source as usize));
        for entry in all {
            let (t, s) = (entry.target as usize, entry.source as usize);
            if pairs(t, s) <= left && PAIR * pairs(t, s) < cost(facets[t].len(), facets[s].len()) {
                left -= pairs(t, s);
                moved.push(entry);
            } else {
                kept.push(entry);
            }
        }
        p2p.append(&mut moved);
        Rows::new(facets.len(), kept)
    };
    links.mixed = take(&links.mixed, &|a, b| {
        SURFEL * (a + b) + M2L[MIXED_ORDER.min(links.order())]
    });
    for (order, rows) in links.m2l.iter_mut().enumerate().rev() {
        *rows = take(rows, &|_, _| M2L[order.min(M2L.len() - 1)]);
    }
    links.p2p = Rows::new(facets.len(), p2p);
    links.smooth = links.m2l.iter().map(|rows| rows.len() as u64).sum();
    links
}

// What things take on a CPU, in tenths of a nanosecond (a core of Zen 5): a pair of surfels, a surfel
// of a mixed link, M2L by order.
const PAIR: usize = 4;
const SURFEL: usize = 150;
const M2L: [usize; 7] = [150, 350, 920, 2350, 5400, 11_000, 21_000];

fn entries(rows: &Rows) -> Vec<Entry> {
    let of_target = |t: usize| {
        rows.row(t).map(move |(source, weight)| Entry {
            target: t as u32,
            source: source as u32,
            weight,
        })
    };
    (0..rows.offsets.len() - 1).flat_map(of_target).collect()
}

/// Largest order of the expansions for a tolerance: 3 down to 0.003, 4 to 0.0003, then 6. (By order 2 links
/// and solution take up to four times as long.)
pub fn order(tolerance: f64) -> usize {
    match tolerance {
        3e-3.. => 3,
        3e-4.. => 4,
        _ => 6,
    }
}

/// Surfels a leaf for expansions of an order: at least as many as make these pay. In small clouds
/// leaves are no larger than that, so that pairs of neighbouring leaves are few of all pairs.
pub fn leaf_size(order: usize, surfels: usize) -> usize {
    (surfels / 2500).min(32).max(4 << (order / 2))
}
