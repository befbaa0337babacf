//! What is seen from one surfel (figures 2.8 and 2.9 of the report).

use super::PointVisibility;
use crate::error::Result;
use crate::octree::{Facet, Octree};
use crate::progress::Progress;

/// Pairs tested between two looks at whether the work should stop.
const BLOCK: usize = 1 << 16;

/// The surfels and the leaves of an octree that one surfel sees.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Entry i says whether surfel i is visible.
    pub surfels: Vec<bool>,
    /// Leaves, by their number among the facets, and whether each is visible as a whole: more than
    /// the part t2 of its surfels are (2.2.4.3).
    pub leaves: Vec<(usize, bool)>,
}

impl Seen {
    /// Tests the surfel `from` with all others, in the octree's order.
    pub fn from(
        octree: &Octree,
        from: u32,
        threshold: f32,
        visibility: &dyn PointVisibility,
        progress: &dyn Progress,
    ) -> Result<Seen> {
        let n = octree.facets.first().map_or(0, Facet::len);
        progress.stage("visibility", n as u64);
        let mut surfels = Vec::with_capacity(n);
        while surfels.len() < n {
            progress.check()?;
            let block = surfels.len()..(surfels.len() + BLOCK).min(n);
            let pairs: Vec<[u32; 2]> = block.map(|i| [from, i as u32]).collect();
            surfels.extend(visibility.visible(&pairs)?);
            progress.advance(pairs.len() as u64);
        }
        let is_seen = |leaf: &Facet| {
            let seen = surfels[leaf.surfels()].iter().filter(|&&seen| seen).count();
            seen as f32 > threshold * leaf.len() as f32
        };
        let facets = octree.facets.iter().enumerate();
        let leaves = facets
            .filter(|(_, facet)| facet.is_leaf())
            .map(|(f, leaf)| (f, is_seen(leaf)))
            .collect();
        Ok(Seen { surfels, leaves })
    }
}
