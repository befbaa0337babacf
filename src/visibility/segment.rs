//! One segment against the cells, on the CPU; `shaders/visibility.wgsl` tests cells alike.

use glam::Vec4;

use crate::math::{Real, Vector};
use crate::points::MAX_EDGES;

use super::wide::{Line, walk};
use super::{NO_SURFEL, Occluder, Occluders, Segment};

/// Smallest component of a direction that boxes are tested with: its inverse stays finite.
const SMALLEST: f32 = 1e-20;

/// Whether a cell, other than the two that the segment excludes, is met strictly between its ends.
pub fn blocked<T: Real>(occluders: &Occluders, segment: &Segment) -> bool {
    let (from, to) = ends::<T>(segment);
    let mut limit = 1.0;
    walk::<false>(
        &occluders.wide,
        &line(segment),
        &mut limit,
        &mut |limit, range| {
            let met = |cell: &Occluder| {
                meeting::<T>(cell, from, to).is_some() && !excludes(segment, cell.surfel)
            };
            if occluders.occluders[range].iter().any(met) {
                *limit = -1.0;
            }
        },
    );
    limit < 0.0
}

/// A cell that a segment meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hit {
    pub surfel: u32,
    /// Whether it is met on the side of its normal.
    pub front: bool,
}

/// The cell that a segment meets first, other than the two that it excludes.
pub fn first_hit<T: Real>(occluders: &Occluders, segment: &Segment) -> Option<Hit> {
    let (from, to) = ends::<T>(segment);
    let mut first = (T::ONE, NO_SURFEL);
    let mut hit = None;
    walk::<true>(
        &occluders.wide,
        &line(segment),
        &mut 1.0,
        &mut |limit, range| {
            for cell in &occluders.occluders[range] {
                let Some(part) = meeting::<T>(cell, from, to) else {
                    continue;
                };
                if (part, cell.surfel) < first && !excludes(segment, cell.surfel) {
                    first = (part, cell.surfel);
                    *limit = part.to_f64() as f32;
                    hit = Some(cell);
                }
            }
        },
    );
    hit.map(|cell| Hit {
        surfel: cell.surfel,
        front: (to - from).dot(vector::<T>(cell.normal)) < T::ZERO,
    })
}

/// Where the open segment crosses the plane of a cell inside it or on its edge, as a part of its
/// length; a segment in the plane does not cross it. Exchanging the ends does not change whether it
/// does, not even by rounding.
pub fn meeting<T: Real>(cell: &Occluder, from: T::Vec3, to: T::Vec3) -> Option<T> {
    let position = vector::<T>(cell.position);
    let normal = vector::<T>(cell.normal);
    let p = from - position;
    let q = to - position;
    let a = p.dot(normal);
    let b = q.dot(normal);
    let crosses = (a < T::ZERO && b > T::ZERO) || (a > T::ZERO && b < T::ZERO);
    if !crosses {
        return None;
    }
    let hit = (p * b - q * a) * (T::ONE / (b - a));
    if hit.dot(hit) > T::from_f32(cell.radius_squared) {
        return None;
    }
    let tangent = vector::<T>(cell.tangent);
    let x = hit.dot(tangent);
    let y = hit.dot(normal.cross(tangent));
    let corner = |k: usize| cell.corners[k % MAX_EDGES].map(T::from_f32);
    let inside = (0..MAX_EDGES).all(|k| {
        let [cx, cy] = corner(k);
        let [dx, dy] = corner(k + 1);
        (dx - cx) * (y - cy) - (dy - cy) * (x - cx) >= T::ZERO
    });
    inside.then(|| a / (a - b))
}

fn excludes(segment: &Segment, surfel: u32) -> bool {
    surfel == segment.skip_from || surfel == segment.skip_to
}

fn ends<T: Real>(segment: &Segment) -> (T::Vec3, T::Vec3) {
    (vector::<T>(segment.from), vector::<T>(segment.to))
}

/// What boxes are tested with.
fn line(segment: &Segment) -> Line {
    Line {
        start: segment.from.map(Vec4::splat),
        inverse: [0, 1, 2].map(|k| Vec4::splat(inverse(segment.to[k] - segment.from[k]))),
    }
}

fn inverse(x: f32) -> f32 {
    1.0 / if x.abs() >= SMALLEST {
        x
    } else {
        SMALLEST.copysign(x)
    }
}

#[inline(always)]
fn vector<T: Real>(v: [f32; 3]) -> T::Vec3 {
    T::Vec3::from_f32(v.into())
}
