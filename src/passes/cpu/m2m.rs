use rayon::prelude::*;

use crate::expansion::Moments;
use crate::math::{Real, Vector};
use crate::octree::Octree;

/// M2M: moments of the inner facets from those of their children, from the leaves up.
pub fn m2m<T: Real>(octree: &Octree, moments: &mut [Moments<T>]) {
    for level in (0..octree.depth()).rev() {
        let range = octree.level(level);
        let (upper, below) = moments.split_at_mut(range.end);
        upper[range.clone()]
            .par_iter_mut()
            .zip(&octree.facets[range.clone()])
            .filter(|(_, facet)| !facet.is_leaf())
            .for_each(|(parent, facet)| {
                let centre = T::Vec3::from_f32(facet.centre);
                let inverse_scale = T::ONE / T::from_f32(facet.scale());
                for c in facet.children() {
                    let child = &octree.facets[c as usize];
                    let place = (T::Vec3::from_f32(child.centre) - centre) * inverse_scale;
                    parent.add_child(
                        &below[c as usize - range.end],
                        T::from_f32(child.scale()) * inverse_scale,
                        place,
                    );
                }
            });
    }
}
