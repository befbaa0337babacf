use rayon::prelude::*;

use super::{centre, scale};
use crate::expansion::{Expansions, Surface, Workspace};
use crate::links::Rows;
use crate::math::{Colour, Real, Vector};
use crate::octree::Octree;

/// P2L: adds to each facet's local expansion the field of the surfels of the facets that it is
/// linked to. A surfel counts if the facet's centre lies in front of it.
pub fn p2l<T: Real, C: Colour<T>>(
    octree: &Octree,
    links: &Rows,
    surface: &Surface<T>,
    radiosity: &[C],
    locals: &mut Expansions<T, C::Wide>,
) {
    if links.is_empty() {
        return;
    }
    let stride = locals.stride();
    let (indices, coefficients) = locals.split_mut();
    coefficients
        .par_chunks_exact_mut(stride)
        .zip(&octree.facets)
        .enumerate()
        .for_each_init(
            || Workspace::<T, C::Wide>::new(indices),
            |workspace, (t, (local, target))| {
                for (s, fraction) in links.row(t) {
                    for j in octree.facets[s].surfels() {
                        let way = centre::<T>(target) - surface.positions[j];
                        let normal = surface.normals[j];
                        if normal.dot(way) > T::ZERO {
                            let weight = surface.areas[j] * T::from_f32(fraction);
                            let flux = C::Wide::from(radiosity[j]) * weight;
                            workspace.p2l(flux, normal, way, scale(target), local);
                        }
                    }
                }
            },
        );
}
