//! The stages on the CPU, generic: f64 is the reference, f32 the product and the twin of WGSL.

mod l2l;
mod l2p;
mod m2l;
mod m2m;
mod m2p;
mod mixed;
mod near_field;
mod p2l;
mod p2m;
mod p2p;

pub use l2l::l2l;
pub use l2p::l2p;
pub use m2l::m2l;
pub use m2m::m2m;
pub use m2p::m2p;
pub use mixed::mixed;
pub use near_field::near_field;
pub use p2l::p2l;
pub use p2m::p2m;
pub use p2p::{all_pairs, p2p};

use crate::math::{Real, Vector};
use crate::octree::{Facet, Octree};

/// Place of a facet's expansions, in the reals of a pass.
fn centre<T: Real>(facet: &Facet) -> T::Vec3 {
    T::Vec3::from_f32(facet.centre)
}

fn scale<T: Real>(facet: &Facet) -> T {
    T::from_f32(facet.scale())
}

/// Of a child, relative to its parent: the ratio of the scales, and its centre in units of the
/// parent's scale.
fn within<T: Real>(child: &Facet, parent: &Facet) -> (T, T::Vec3) {
    let inverse = T::ONE / scale::<T>(parent);
    let way = centre::<T>(child) - centre::<T>(parent);
    (scale::<T>(child) * inverse, way * inverse)
}

/// The leaves, each with its part of a field.
fn leaves<'a, V>(octree: &Octree, field: &'a mut [V]) -> Vec<(usize, &'a mut [V])> {
    let mut rest = field;
    let leaves = octree.leaves.iter().map(|&f| f as usize);
    leaves
        .map(|f| {
            let (own, others) = std::mem::take(&mut rest).split_at_mut(octree.facets[f].len());
            rest = others;
            (f, own)
        })
        .collect()
}
