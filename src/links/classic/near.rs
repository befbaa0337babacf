//! Surfels of neighbouring leaves, linked one by one where they see each other.

use crate::error::Result;
use crate::links::Rows;
use crate::links::csr::Part;
use crate::links::near::form_factors;
use crate::memory::Budget;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::PointVisibility;

/// Links surfel by surfel where facets are linked by `parts`: those that see each other.
pub(in crate::links) fn seen(
    octree: &Octree,
    surfels: &Surfels,
    parts: &[Part],
    points: &dyn PointVisibility,
    budget: &Budget,
    progress: &dyn Progress,
) -> Result<Rows> {
    let all = form_factors(octree, surfels, parts, budget, |_, _, _| true)?;
    let mut seen = Vec::with_capacity(all.len());
    for part in all {
        progress.check()?;
        let pairs: Vec<[u32; 2]> = part
            .entries()
            .map(|(i, j, _)| [i.min(j), i.max(j)])
            .collect();
        let visible = points.visible(&pairs)?;
        let mut kept = Part::default();
        for ((i, j, weight), _) in part.entries().zip(visible).filter(|&(_, v)| v) {
            kept.push(i, j);
            kept.weights.push(weight);
        }
        seen.push(kept);
    }
    Rows::gather(surfels.len(), seen)
}
