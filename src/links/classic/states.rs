//! Whether two facets see each other (2.2.4.5 of the report).

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use super::Thresholds;
use super::bits::Bits;
use super::leaves::{self, Tally};
use crate::error::{Error, Result};
use crate::memory;
use crate::octree::Octree;
use crate::progress::Progress;
use crate::visibility::PointVisibility;

/// Visibility state of two facets, from those of the leaves below them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// All leaves see each other.
    Valid,
    /// No leaf sees any.
    Invalid,
    /// Some do. Never so for two leaves.
    Partial,
}

/// The states of all pairs of facets.
///
/// A facet keeps two bits a leaf: whether any leaf below it sees that one, and whether all do. So
/// each pair of leaves is tested once, facets follow from their children, and the state of a pair is
/// looked up in the bits of one facet for the leaves of the other.
pub struct States {
    /// Leaves below each facet: their places in the order of surfels.
    leaves: Vec<Range<u32>>,
    any: Bits,
    all: Bits,
    /// What was tested.
    pub tally: Tally,
    /// How often each state was the answer.
    asked: [AtomicU64; 3],
}

impl States {
    /// Tests all pairs of leaves, surfel by surfel, but for those that the cones prune.
    ///
    /// Fails with [`Error::TooLarge`] where the bits do not fit into memory.
    pub fn find(
        octree: &Octree,
        thresholds: &Thresholds,
        points: &dyn PointVisibility,
        progress: &dyn Progress,
    ) -> Result<States> {
        let facets = &octree.facets;
        let mut begins: Vec<u32> = facets
            .iter()
            .filter(|f| f.is_leaf())
            .map(|f| f.begin)
            .collect();
        begins.sort_unstable();
        check_memory(facets.len(), begins.len())?;
        let place = |surfel: u32| begins.partition_point(|&b| b < surfel) as u32;
        let leaves: Vec<Range<u32>> = facets
            .iter()
            .map(|f| place(f.begin)..place(f.end))
            .collect();

        let [mut any, mut all] = [(); 2].map(|_| Bits::new(facets.len(), begins.len()));
        let tally = leaves::find(octree, thresholds, points, progress, |a, b| {
            for (row, column) in [(a, b), (b, a)].map(|(a, b)| (a as usize, b as usize)) {
                any.set(row, leaves[column].start as usize);
                all.set(row, leaves[column].start as usize);
            }
        })?;
        for (f, facet) in facets
            .iter()
            .enumerate()
            .rev()
            .filter(|(_, f)| !f.is_leaf())
        {
            let children = facet.children().start as usize..facet.children().end as usize;
            any.fold(f, children.clone(), |a, b| a | b);
            all.fold(f, children, |a, b| a & b);
        }
        Ok(States {
            leaves,
            any,
            all,
            tally,
            asked: Default::default(),
        })
    }

    /// The state of two facets; it does not matter which is first.
    pub fn of(&self, a: u32, b: u32) -> State {
        let (a, leaves) = (a as usize, &self.leaves[b as usize]);
        let state = if self.all.all(a, leaves) {
            State::Valid
        } else if self.any.any(a, leaves) {
            State::Partial
        } else {
            State::Invalid
        };
        self.asked[state as usize].fetch_add(1, Ordering::Relaxed);
        state
    }

    /// Numbers of the tests and of the states asked for, as the stats show them.
    pub fn counts(&self) -> [(&'static str, u64); 8] {
        let [valid, invalid, partial] = [0, 1, 2].map(|s| self.asked[s].load(Ordering::Relaxed));
        [
            ("states_valid", valid),
            ("states_invalid", invalid),
            ("states_partial", partial),
            ("leaf_pairs", self.tally.pairs),
            ("leaf_pairs_pruned", self.tally.pruned),
            ("facet_pairs_pruned", self.tally.pruned_facets),
            ("leaf_pairs_visible", self.tally.visible),
            ("surfel_pairs_tested", self.tally.tested),
        ]
    }
}

fn check_memory(facets: usize, leaves: usize) -> Result<()> {
    let needed = 2 * Bits::bytes(facets, leaves);
    match memory::available() {
        Some(free) if needed > free => Err(Error::TooLarge(format!(
            "the classic method keeps two bits for each pair of {facets} facets and {leaves} \
             leaves, {} MiB, but {} MiB are free: use the fmm method, or take fewer points",
            needed >> 20,
            free >> 20
        ))),
        _ => Ok(()),
    }
}
