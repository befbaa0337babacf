use rayon::prelude::*;

use super::within;
use crate::expansion::{Expansions, Workspace};
use crate::math::{Colour, Real};
use crate::octree::Octree;

/// L2L: adds each facet's local expansion to those of its children, from the root down.
pub fn l2l<T: Real, C: Colour<T>>(octree: &Octree, locals: &mut Expansions<T, C>) {
    let stride = locals.stride();
    let (indices, coefficients) = locals.split_mut();
    for level in 1..octree.depth() {
        let range = octree.level(level);
        let (above, rest) = coefficients.split_at_mut(range.start * stride);
        rest[..range.len() * stride]
            .par_chunks_exact_mut(stride)
            .zip(&octree.facets[range])
            .for_each_init(
                || Workspace::<T, C>::new(indices),
                |workspace, (local, facet)| {
                    let parent = facet.parent as usize;
                    let (ratio, place) = within::<T>(facet, &octree.facets[parent]);
                    let inherited = &above[parent * stride..][..stride];
                    workspace.l2l(inherited, ratio, place, local);
                },
            );
    }
}
