use rayon::prelude::*;

use crate::expansion::{Moments, Surface};
use crate::math::{Real, Vector};
use crate::octree::Octree;

/// P2M: moments of the leaves from the radiosity of their surfels; other facets get zeros.
pub fn p2m<T: Real>(
    octree: &Octree,
    surface: &Surface<T>,
    radiosity: &[T::Vec3],
) -> Vec<Moments<T>> {
    let moments = |facet: &crate::octree::Facet| {
        let mut moments = Moments::default();
        if facet.is_leaf() {
            let centre = T::Vec3::from_f32(facet.centre);
            let inverse_scale = T::ONE / T::from_f32(facet.scale());
            for j in facet.surfels() {
                moments.add_surfel(
                    radiosity[j] * surface.areas[j],
                    surface.normals[j],
                    (surface.positions[j] - centre) * inverse_scale,
                );
            }
        }
        moments
    };
    octree.facets.par_iter().map(moments).collect()
}
