//! Rows of facets as spans of surfels.

use super::Rows;
use crate::octree::Octree;

/// Surfels `begin..end`, in the octree's order, that act on a target with one weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    pub begin: u32,
    pub end: u32,
    pub weight: f32,
}

impl Span {
    pub fn len(&self) -> usize {
        (self.end - self.begin) as usize
    }

    pub fn is_empty(&self) -> bool {
        self.begin == self.end
    }
}

impl Rows {
    /// The surfels of the facets in a row, in the octree's order. Facets side by side that act with
    /// the same weight are one span.
    pub fn spans(&self, octree: &Octree, target: usize) -> Vec<Span> {
        let mut spans: Vec<Span> = self
            .row(target)
            .map(|(source, weight)| Span {
                begin: octree.facets[source].begin,
                end: octree.facets[source].end,
                weight,
            })
            .collect();
        spans.sort_unstable_by_key(|s| (s.begin, s.end));
        spans.dedup_by(|next, last| {
            let joined = next.begin == last.end && next.weight == last.weight;
            if joined {
                last.end = next.end;
            }
            joined
        });
        spans
    }
}
