use rayon::prelude::*;

use super::{centre, scale};
use crate::expansion::{Indices, Surface, Workspace, coefficients};
use crate::links::Rows;
use crate::math::{Real, Vector};
use crate::octree::Octree;

/// P2M, M2L and L2P of one link at a time, for facets of which only some surfels face each other:
/// adds to the irradiance of the surfels that have the source's centre in front what comes from
/// those that have the target's centre in front.
pub fn mixed<T: Real>(
    order: usize,
    octree: &Octree,
    rows: &Rows,
    surface: &Surface<T>,
    radiosity: &[T::Vec3],
    irradiance: &mut [T::Vec3],
) {
    if rows.is_empty() {
        return;
    }
    let indices = Indices::new(order);
    let targets: Vec<usize> = (0..octree.facets.len())
        .filter(|&t| rows.row(t).next().is_some())
        .collect();
    let sums: Vec<Vec<T::Rgb>> = targets
        .par_iter()
        .map_init(
            || {
                let zeros = vec![T::Rgb::default(); coefficients(order)];
                (Workspace::<T>::new(&indices), zeros.clone(), zeros)
            },
            |(workspace, moments, local), &t| {
                let target = &octree.facets[t];
                let (to, to_scale) = (centre::<T>(target), scale::<T>(target));
                let mut sums = vec![T::Rgb::default(); target.len()];
                for (s, fraction) in rows.row(t) {
                    let source = &octree.facets[s];
                    let (from, from_scale) = (centre::<T>(source), scale::<T>(source));
                    moments.fill(T::Rgb::default());
                    local.fill(T::Rgb::default());
                    for j in source.surfels() {
                        let (place, normal) = (surface.positions[j], surface.normals[j]);
                        if normal.dot(to - place) > T::ZERO {
                            let flux = T::Rgb::from(radiosity[j]) * surface.areas[j];
                            let place = (place - from) * (T::ONE / from_scale);
                            workspace.p2m(flux, normal, place, moments);
                        }
                    }
                    workspace.m2l(
                        order,
                        moments,
                        to - from,
                        [from_scale, to_scale],
                        T::from_f32(fraction),
                        local,
                    );
                    for (sum, i) in sums.iter_mut().zip(target.surfels()) {
                        let (place, normal) = (surface.positions[i], surface.normals[i]);
                        if normal.dot(from - place) > T::ZERO {
                            let place = (place - to) * (T::ONE / to_scale);
                            *sum += workspace.l2p(local, normal, place);
                        }
                    }
                }
                sums
            },
        )
        .collect();
    // One by one: a facet and a part of it may both be targets.
    for (&t, sums) in targets.iter().zip(sums) {
        let own = &mut irradiance[octree.facets[t].surfels()];
        for (h, sum) in own.iter_mut().zip(sums) {
            *h += sum.into();
        }
    }
}
