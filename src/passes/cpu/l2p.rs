use rayon::prelude::*;

use crate::expansion::{Local, Surface};
use crate::math::{Real, Vector};
use crate::octree::Octree;

/// L2P: irradiance of each surfel from the local expansion of its leaf.
pub fn l2p<T: Real>(octree: &Octree, surface: &Surface<T>, locals: &[Local<T>]) -> Vec<T::Vec3> {
    let mut leaves: Vec<usize> = (0..octree.facets.len())
        .filter(|&f| octree.facets[f].is_leaf())
        .collect();
    leaves.sort_unstable_by_key(|&f| octree.facets[f].begin);
    leaves
        .par_iter()
        .flat_map_iter(|&f| {
            let facet = &octree.facets[f];
            let centre = T::Vec3::from_f32(facet.centre);
            let inverse_scale = T::ONE / T::from_f32(facet.scale());
            facet.surfels().map(move |i| {
                let place = (surface.positions[i] - centre) * inverse_scale;
                locals[f].irradiance(surface.normals[i], place)
            })
        })
        .collect()
}
