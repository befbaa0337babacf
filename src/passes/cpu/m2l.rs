use rayon::prelude::*;

use crate::expansion::{Local, Moments};
use crate::links::Links;
use crate::math::{Real, Vector};
use crate::octree::Octree;

/// M2L: each facet's local expansion from the moments of the facets that it is linked to.
pub fn m2l<T: Real>(octree: &Octree, links: &Links, moments: &[Moments<T>]) -> Vec<Local<T>> {
    let gather = |(t, target): (usize, &crate::octree::Facet)| {
        let mut local = Local::default();
        for (s, fraction) in links.m2l.iter().flat_map(|rows| rows.row(t)) {
            let source = &octree.facets[s];
            let way = T::Vec3::from_f32(target.centre) - T::Vec3::from_f32(source.centre);
            let distance = way.length();
            let inverse = T::ONE / distance;
            local.add_moments(
                &moments[s],
                way * inverse,
                distance,
                T::from_f32(source.scale()) * inverse,
                T::from_f32(target.scale()) * inverse,
                T::from_f32(fraction),
            );
        }
        for (s, kernel) in links.sampled.row(t) {
            local.constant += moments[s].power * T::from_f32(kernel);
        }
        local
    };
    octree.facets.par_iter().enumerate().map(gather).collect()
}
