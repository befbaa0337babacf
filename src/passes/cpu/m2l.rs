use rayon::prelude::*;

use super::{centre, scale};
use crate::expansion::{Expansions, Link, Workspace};
use crate::links::Links;
use crate::math::{Colour, Real};
use crate::octree::Octree;

/// M2L: each facet's local expansion from the moments of the facets that it is linked to, each link
/// by its order; and from their power by sampled links.
pub fn m2l<T: Real, C: Colour<T>>(
    octree: &Octree,
    links: &Links,
    moments: &Expansions<T, C>,
) -> Expansions<T, C> {
    let mut locals = Expansions::zeros(moments.order(), octree.facets.len());
    let stride = locals.stride();
    let (indices, coefficients) = locals.split_mut();
    coefficients
        .par_chunks_exact_mut(stride)
        .zip(&octree.facets)
        .enumerate()
        .for_each_init(
            || Workspace::<T, C>::new(indices),
            |workspace, (t, (local, target))| {
                for (order, rows) in links.m2l.iter().enumerate() {
                    let links = rows.row(t).map(|(s, fraction)| {
                        let source = &octree.facets[s];
                        Link {
                            moments: moments.of(s),
                            way: centre::<T>(target) - centre::<T>(source),
                            scale: scale(source),
                            fraction: T::from_f32(fraction),
                        }
                    });
                    workspace.m2l_of_all(order, links, scale(target), local);
                }
                for (s, kernel) in links.sampled.row(t) {
                    local[0] += moments.of(s)[0] * T::from_f32(kernel);
                }
            },
        );
    locals
}
