use rayon::prelude::*;

use super::within;
use crate::expansion::{Expansions, Workspace};
use crate::math::{Colour, Real};
use crate::octree::Octree;

/// M2M: moments of the inner facets from those of their children, from the leaves up.
pub fn m2m<T: Real, C: Colour<T>>(octree: &Octree, moments: &mut Expansions<T, C>) {
    let stride = moments.stride();
    let (indices, coefficients) = moments.split_mut();
    for level in (0..octree.depth()).rev() {
        let range = octree.level(level);
        let (upper, below) = coefficients.split_at_mut(range.end * stride);
        upper[range.start * stride..]
            .par_chunks_exact_mut(stride)
            .zip(&octree.facets[range.clone()])
            .filter(|(_, facet)| !facet.is_leaf())
            .for_each_init(
                || Workspace::<T, C>::new(indices),
                |workspace, (parent, facet)| {
                    for c in facet.children().map(|c| c as usize) {
                        let (ratio, place) = within::<T>(&octree.facets[c], facet);
                        let child = &below[(c - range.end) * stride..][..stride];
                        workspace.m2m(child, ratio, place, parent);
                    }
                },
            );
    }
}
