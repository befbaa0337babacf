use rayon::prelude::*;

use super::{centre, scale};
use crate::expansion::{Expansions, Surface, Workspace};
use crate::math::{Colour, Real};
use crate::octree::Octree;

/// P2M: moments of the leaves from the radiosity of their surfels; other facets get zeros.
pub fn p2m<T: Real, C: Colour<T>>(
    order: usize,
    octree: &Octree,
    surface: &Surface<T>,
    radiosity: &[C],
) -> Expansions<T, C::Wide> {
    let mut moments = Expansions::zeros(order, octree.facets.len());
    let stride = moments.stride();
    let (indices, coefficients) = moments.split_mut();
    coefficients
        .par_chunks_exact_mut(stride)
        .zip(&octree.facets)
        .filter(|(_, facet)| facet.is_leaf())
        .for_each_init(
            || Workspace::<T, C::Wide>::new(indices),
            |workspace, (moments, facet)| {
                let inverse_scale = T::ONE / scale::<T>(facet);
                for j in facet.surfels() {
                    let flux = C::Wide::from(radiosity[j]) * surface.areas[j];
                    let place = (surface.positions[j] - centre::<T>(facet)) * inverse_scale;
                    workspace.p2m(flux, surface.normals[j], place, moments);
                }
            },
        );
    moments
}
