use rayon::prelude::*;

use super::{centre, leaves, scale};
use crate::expansion::{Expansions, Surface, Workspace};
use crate::math::{Colour, Real};
use crate::octree::Octree;

/// L2P: irradiance of each surfel from the local expansion of its leaf.
pub fn l2p<T: Real, C: Colour<T>>(
    octree: &Octree,
    surface: &Surface<T>,
    locals: &Expansions<T, C::Wide>,
) -> Vec<C> {
    let indices = locals.indices();
    let zeros = rayon::iter::repeat_n(C::default(), surface.len());
    let mut irradiance: Vec<C> = zeros.collect();
    leaves(octree, &mut irradiance)
        .into_par_iter()
        .for_each_init(
            || Workspace::<T, C::Wide>::new(indices),
            |workspace, (f, irradiance)| {
                let facet = &octree.facets[f];
                let inverse_scale = T::ONE / scale::<T>(facet);
                for (h, i) in irradiance.iter_mut().zip(facet.surfels()) {
                    let place = (surface.positions[i] - centre::<T>(facet)) * inverse_scale;
                    let own = locals.of(f);
                    *h = workspace.l2p(own, surface.normals[i], place).into();
                }
            },
        );
    irradiance
}
