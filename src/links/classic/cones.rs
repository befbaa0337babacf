//! Visibility cones (2.2.4.7 of the report).
//!
//! The cone of a facet is what lies below the horizons of all its surfels: whatever the surfels of
//! the cloud, nothing in it is visible from any of them. It follows from the facet's slab and the
//! spread of its normals, which are found from the leaves up, and the box of another facet is
//! tested against it ([`Facing::averted`]): both facets have a cone, and one of them is enough.
//!
//! What lies behind other surfels is in no cone. One point blocks with certainty only the lines that
//! pass within a fraction of its spacing: such pieces leave gaps, so that no bound in advance shows
//! that a facet is hidden as a whole. Tests of its points do.

use crate::links::{Facing, splits_target};
use crate::octree::Octree;

/// What a pair of facets comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Met {
    /// One lies in the cone of the other: nothing below is visible.
    Pruned,
    /// Two leaves, or one with itself.
    Leaves,
}

/// All pairs of leaves, each in one order, but for those that the cones prune; of them the largest
/// facets that lie in each other's cones.
pub(super) fn pairs(octree: &Octree) -> impl Iterator<Item = (u32, u32, Met)> {
    let facets = &octree.facets;
    let mut stack = vec![(0, 0)];
    std::iter::from_fn(move || {
        while let Some((i, j)) = stack.pop() {
            let (a, b) = (&facets[i as usize], &facets[j as usize]);
            if Facing::between(a, b).averted() {
                return Some((i, j, Met::Pruned));
            }
            if a.is_leaf() && b.is_leaf() {
                return Some((i, j, Met::Leaves));
            }
            if i == j {
                for k in a.children().rev() {
                    stack.extend((k..a.children().end).rev().map(|l| (k, l)));
                }
            } else if splits_target(a, b) {
                stack.extend(a.children().rev().map(|k| (k, j)));
            } else {
                stack.extend(b.children().rev().map(|k| (i, k)));
            }
        }
        None
    })
}
