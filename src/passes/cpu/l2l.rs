use rayon::prelude::*;

use crate::expansion::Local;
use crate::math::{Real, Vector};
use crate::octree::Octree;

/// L2L: adds each facet's local expansion to those of its children, from the root down.
pub fn l2l<T: Real>(octree: &Octree, locals: &mut [Local<T>]) {
    for level in 1..octree.depth() {
        let range = octree.level(level);
        let (above, rest) = locals.split_at_mut(range.start);
        rest[..range.len()]
            .par_iter_mut()
            .zip(&octree.facets[range])
            .for_each(|(local, facet)| {
                let parent = &octree.facets[facet.parent as usize];
                let inverse_scale = T::ONE / T::from_f32(parent.scale());
                let way = T::Vec3::from_f32(facet.centre) - T::Vec3::from_f32(parent.centre);
                local.add(&above[facet.parent as usize].at_child(
                    T::from_f32(facet.scale()) * inverse_scale,
                    way * inverse_scale,
                ));
            });
    }
}
