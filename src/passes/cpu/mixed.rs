use rayon::prelude::*;

use super::{centre, scale};
use crate::expansion::{Expansions, Indices, Surface, Workspace, coefficients};
use crate::links::Rows;
use crate::math::{Colour, Real, Vector};
use crate::octree::Octree;

/// P2M, M2L and L2P of one link at a time, for facets of which only some surfels face each other:
/// adds to the irradiance of the surfels that have the source's centre in front what comes from
/// those that have the target's centre in front. Where these are all of the source, its `moments`
/// serve, where they are all of the target, one local expansion for all such links.
pub fn mixed<T: Real, C: Colour<T>>(
    order: usize,
    octree: &Octree,
    rows: &Rows,
    surface: &Surface<T>,
    radiosity: &[C],
    moments: &Expansions<T, C::Wide>,
    irradiance: &mut [C],
) {
    if rows.is_empty() {
        return;
    }
    let indices = Indices::new(order);
    let (places, normals) = (&surface.positions, &surface.normals);
    let in_front = |i: usize, centre: T::Vec3| normals[i].dot(centre - places[i]) > T::ZERO;
    let gather = |room: &mut Room<T, C::Wide>, t: usize| {
        let Room {
            workspace,
            own,
            local,
            shared,
        } = room;
        let target = &octree.facets[t];
        let (to, to_scale) = (centre::<T>(target), scale::<T>(target));
        let place = |i: usize| (places[i] - to) * (T::ONE / to_scale);
        let mut sums = vec![C::Wide::default(); target.len()];
        shared.fill(C::Wide::default());
        let mut is_shared = false;
        for (s, fraction) in rows.row(t) {
            let source = &octree.facets[s];
            let (from, from_scale) = (centre::<T>(source), scale::<T>(source));
            let from_all = source.surfels().all(|j| in_front(j, to));
            let to_all = target.surfels().all(|i| in_front(i, from));
            if !from_all {
                own.fill(C::Wide::default());
                for j in source.surfels().filter(|&j| in_front(j, to)) {
                    let flux = C::Wide::from(radiosity[j]) * surface.areas[j];
                    let place = (places[j] - from) * (T::ONE / from_scale);
                    workspace.p2m(flux, normals[j], place, own);
                }
            }
            is_shared |= to_all;
            let into = if to_all { &mut *shared } else { &mut *local };
            if !to_all {
                into.fill(C::Wide::default());
            }
            workspace.m2l(
                order,
                if from_all { moments.of(s) } else { own },
                to - from,
                [from_scale, to_scale],
                T::from_f32(fraction),
                into,
            );
            if !to_all {
                for (sum, i) in sums.iter_mut().zip(target.surfels()) {
                    if in_front(i, from) {
                        *sum += workspace.l2p(local, normals[i], place(i));
                    }
                }
            }
        }
        if is_shared {
            for (sum, i) in sums.iter_mut().zip(target.surfels()) {
                *sum += workspace.l2p(shared, normals[i], place(i));
            }
        }
        sums
    };
    let targets: Vec<usize> = (0..octree.facets.len())
        .filter(|&t| rows.row(t).next().is_some())
        .collect();
    let sums: Vec<Vec<C::Wide>> = targets
        .par_iter()
        .map_init(|| Room::new(&indices), |room, &t| gather(room, t))
        .collect();
    // One by one: a facet and a part of it may both be targets.
    for (&t, sums) in targets.iter().zip(sums) {
        let own = &mut irradiance[octree.facets[t].surfels()];
        for (h, sum) in own.iter_mut().zip(sums) {
            *h += sum.into();
        }
    }
}

/// What one thread needs on the way.
struct Room<'a, T: Real, C> {
    workspace: Workspace<'a, T, C>,
    /// Moments of a part of a source.
    own: Vec<C>,
    /// For a part of the target, and for all of it.
    local: Vec<C>,
    shared: Vec<C>,
}

impl<'a, T: Real, C: Colour<T>> Room<'a, T, C> {
    fn new(indices: &'a Indices) -> Self {
        let zeros = vec![C::default(); coefficients(indices.order())];
        Room {
            workspace: Workspace::new(indices),
            own: zeros.clone(),
            local: zeros.clone(),
            shared: zeros,
        }
    }
}
