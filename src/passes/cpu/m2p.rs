use rayon::prelude::*;

use super::{centre, leaves, scale};
use crate::expansion::{Expansions, Surface, Workspace};
use crate::links::Rows;
use crate::math::{Colour, Real, Vector};
use crate::octree::Octree;

/// M2P: adds to the irradiance of each surfel the field of the moments of the facets that its leaf,
/// or a facet that holds it, is linked to. A facet counts if its centre lies in front of the
/// surfel.
pub fn m2p<T: Real, C: Colour<T>>(
    octree: &Octree,
    links: &Rows,
    surface: &Surface<T>,
    moments: &Expansions<T, C::Wide>,
    irradiance: &mut [C],
) {
    if links.is_empty() {
        return;
    }
    let (indices, order) = (moments.indices(), moments.order());
    leaves(octree, irradiance).into_par_iter().for_each_init(
        || Workspace::<T, C::Wide>::new(indices),
        |workspace, (leaf, irradiance)| {
            let mut t = leaf;
            loop {
                for (s, fraction) in links.row(t) {
                    let source = &octree.facets[s];
                    for (h, i) in irradiance.iter_mut().zip(octree.facets[leaf].surfels()) {
                        let way = surface.positions[i] - centre::<T>(source);
                        let normal = surface.normals[i];
                        if normal.dot(way) < T::ZERO {
                            let light =
                                workspace.m2p(order, moments.of(s), scale(source), way, normal);
                            *h += (light * T::from_f32(fraction)).into();
                        }
                    }
                }
                let parent = octree.facets[t].parent as usize;
                if parent == t {
                    break;
                }
                t = parent;
            }
        },
    );
}
