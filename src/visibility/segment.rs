//! One segment against the cells, on the CPU; `shaders/visibility.wgsl` does the same in the same
//! order.

use crate::math::{Real, Vector};
use crate::points::MAX_EDGES;

use super::{Node, Occluder, Occluders, Segment};

/// Smallest component of a direction that boxes are tested with: its inverse stays finite.
const SMALLEST: f64 = 1e-20;
/// The far side of a box moves out by this, so that rounding never loses a box that is met
/// (Ize 2013, "Robust BVH ray traversal").
const ROUNDING: f32 = 1.0 + 4.0 * f32::EPSILON;

/// Whether a cell, other than the two that the segment excludes, is met strictly between its ends.
pub fn blocked<T: Real>(occluders: &Occluders, segment: &Segment) -> bool {
    let from = vector::<T>(segment.from);
    let to = vector::<T>(segment.to);
    let start = from.to_array();
    let inverse = (to - from).to_array().map(inverse);
    let mut i = 0;
    while let Some(node) = occluders.nodes.get(i) {
        if !meets_box(node, start, inverse) {
            i += node.skip as usize;
            continue;
        }
        for occluder in &occluders.occluders[node.occluders()] {
            if meets_cell::<T>(occluder, from, to)
                && occluder.surfel != segment.skip_from
                && occluder.surfel != segment.skip_to
            {
                return true;
            }
        }
        i += 1;
    }
    false
}

/// Whether the open segment crosses the plane of a cell inside it or on its edge; a segment in the
/// plane does not cross it. Exchanging the ends does not change the answer, not even by rounding.
pub fn meets_cell<T: Real>(cell: &Occluder, from: T::Vec3, to: T::Vec3) -> bool {
    let position = vector::<T>(cell.position);
    let normal = vector::<T>(cell.normal);
    let p = from - position;
    let q = to - position;
    let a = p.dot(normal);
    let b = q.dot(normal);
    let crosses = (a < T::ZERO && b > T::ZERO) || (a > T::ZERO && b < T::ZERO);
    if !crosses {
        return false;
    }
    let hit = (p * b - q * a) * (T::ONE / (b - a));
    if hit.dot(hit) > T::from_f32(cell.radius_squared) {
        return false;
    }
    let tangent = vector::<T>(cell.tangent);
    let x = hit.dot(tangent);
    let y = hit.dot(normal.cross(tangent));
    let corner = |k: usize| cell.corners[k % MAX_EDGES].map(T::from_f32);
    (0..MAX_EDGES).all(|k| {
        let [cx, cy] = corner(k);
        let [dx, dy] = corner(k + 1);
        (dx - cx) * (y - cy) - (dy - cy) * (x - cx) >= T::ZERO
    })
}

/// Whether a segment meets a box, which may err on the side of yes.
#[inline(always)]
pub(super) fn meets_box<T: Real>(node: &Node, start: [T; 3], inverse: [T; 3]) -> bool {
    let mut near = T::ZERO;
    let mut far = T::ONE;
    for axis in 0..3 {
        let a = (T::from_f32(node.min[axis]) - start[axis]) * inverse[axis];
        let b = (T::from_f32(node.max[axis]) - start[axis]) * inverse[axis];
        near = greater(near, lesser(a, b));
        far = lesser(far, greater(a, b));
    }
    near <= far * T::from_f32(ROUNDING)
}

pub(super) fn inverse<T: Real>(x: T) -> T {
    let smallest = T::from_f64(SMALLEST);
    if x.abs() >= smallest {
        T::ONE / x
    } else if x < T::ZERO {
        -T::ONE / smallest
    } else {
        T::ONE / smallest
    }
}

// Nothing here is NaN, and a bare comparison is one instruction where `f32::min` is four.
#[inline(always)]
fn lesser<T: Real>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

#[inline(always)]
fn greater<T: Real>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

#[inline(always)]
pub(super) fn vector<T: Real>(v: [f32; 3]) -> T::Vec3 {
    T::Vec3::from_f32(v.into())
}
