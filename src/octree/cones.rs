//! Parts of a cloud whose normals keep to a cone, found before anything is sorted by place.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::MAX_HALF_ANGLE;
use crate::points::Surfels;

/// Surfels that are summed up one after the other: sums do not depend on the number of threads.
const BLOCK: usize = 1 << 14;
/// Sines that differ by no more than this are equal: rounding decides between them.
const SLACK: f64 = 1e-6;

/// Surfels whose normals keep to a cone, or a union of such parts.
pub(super) struct Part {
    pub len: usize,
    /// Parts that it consists of; none of a part that keeps to a cone.
    pub children: Range<u32>,
}

/// A tree of parts.
pub(super) struct Cones {
    /// The root first. Parts may be empty, except the root.
    pub parts: Vec<Part>,
    /// The part without children that each surfel belongs to.
    pub part_of: Vec<u32>,
}

/// How an open part is cut.
#[derive(Clone, Copy)]
enum Cut {
    None,
    /// Very different normals part by the face of the cube that they point to.
    Faces,
    /// Others part where the widest extent of their components has its middle.
    Middle {
        axis: usize,
        at: f32,
    },
}

/// Sums over the normals of a part.
#[derive(Clone, Copy)]
struct Sums {
    axis: DVec3,
    low: Vec3,
    high: Vec3,
    len: usize,
}

impl Cones {
    pub fn of(surfels: &Surfels) -> Cones {
        let mut part_of = vec![0; surfels.len()];
        let mut parts = Vec::new();
        let mut open = 0..1;
        while !open.is_empty() {
            let sums = sums(surfels, &part_of, &open);
            let spreads = spreads(surfels, &part_of, &open, &sums);
            let (first, mut end) = (open.start, open.end);
            let mut cuts = Vec::with_capacity(sums.len());
            for (sums, spread) in sums.iter().zip(spreads) {
                let wide = sums.len > 0 && spread > MAX_HALF_ANGLE.sin() + SLACK;
                let cut = if wide { sums.cut() } else { Cut::None };
                let children = end..end + cut.children();
                end = children.end;
                cuts.push((cut, children.start));
                parts.push(Part {
                    len: sums.len,
                    children,
                });
            }
            open = open.end..end;
            if open.is_empty() {
                break;
            }
            let normals = surfels.normals.par_iter();
            part_of.par_iter_mut().zip(normals).for_each(|(part, &n)| {
                if *part >= first {
                    let (cut, child) = cuts[(*part - first) as usize];
                    *part = match cut {
                        Cut::None => *part,
                        Cut::Faces => child + cube_face(n),
                        Cut::Middle { axis, at } => child + u32::from(n[axis] > at),
                    };
                }
            });
        }
        Cones { parts, part_of }
    }
}

impl Sums {
    const NONE: Sums = Sums {
        axis: DVec3::ZERO,
        low: Vec3::INFINITY,
        high: Vec3::NEG_INFINITY,
        len: 0,
    };

    fn add(&mut self, other: &Sums) {
        self.axis += other.axis;
        self.low = self.low.min(other.low);
        self.high = self.high.max(other.high);
        self.len += other.len;
    }

    fn cut(&self) -> Cut {
        let extent = self.high - self.low;
        if extent.max_element() > 1.8 {
            return Cut::Faces;
        }
        let axis = extent.max_position();
        let at = 0.5 * (self.low + self.high)[axis];
        match at < self.high[axis] {
            true => Cut::Middle { axis, at },
            false => Cut::None,
        }
    }
}

impl Cut {
    fn children(self) -> u32 {
        match self {
            Cut::None => 0,
            Cut::Faces => 6,
            Cut::Middle { .. } => 2,
        }
    }
}

/// Sums over the normals of each open part.
fn sums(surfels: &Surfels, part_of: &[u32], open: &Range<u32>) -> Vec<Sums> {
    fold(
        part_of,
        open,
        Sums::NONE,
        |sums: &mut Sums, i| {
            let n = surfels.normals[i];
            sums.add(&Sums {
                axis: n.as_dvec3() * f64::from(surfels.areas[i]),
                low: n,
                high: n,
                len: 1,
            });
        },
        Sums::add,
    )
}

/// Sine of the largest angle between a normal and the mean normal of its open part, 1 from a right
/// angle on.
fn spreads(surfels: &Surfels, part_of: &[u32], open: &Range<u32>, sums: &[Sums]) -> Vec<f64> {
    let axes: Vec<DVec3> = sums.iter().map(|s| s.axis.normalize_or_zero()).collect();
    fold(
        part_of,
        open,
        0.0,
        |spread: &mut f64, i| {
            let n = surfels.normals[i].as_dvec3();
            let axis = axes[(part_of[i] - open.start) as usize];
            *spread = spread.max(sine(axis, n));
        },
        |a, b| *a = a.max(*b),
    )
}

/// Sine of the angle between two directions, 1 from a right angle on. By a cross product: that of
/// equal directions is zero, not the root of a rounding.
#[inline(always)]
pub(super) fn sine(a: DVec3, b: DVec3) -> f64 {
    match a.dot(b) > 0.0 {
        true => a.cross(b).length().min(1.0),
        false => 1.0,
    }
}

/// Folds the surfels of each open part, block by block in parallel, and then the blocks in order.
fn fold<T: Copy + Send + Sync>(
    part_of: &[u32],
    open: &Range<u32>,
    nothing: T,
    add: impl Fn(&mut T, usize) + Sync,
    join: impl Fn(&mut T, &T),
) -> Vec<T> {
    let blocks: Vec<Vec<T>> = part_of
        .par_chunks(BLOCK)
        .enumerate()
        .map(|(block, part_of)| {
            let mut folded = vec![nothing; open.len()];
            for (k, part) in part_of.iter().enumerate() {
                if open.contains(part) {
                    add(&mut folded[(part - open.start) as usize], block * BLOCK + k);
                }
            }
            folded
        })
        .collect();
    let mut all = vec![nothing; open.len()];
    for block in &blocks {
        for (all, folded) in all.iter_mut().zip(block) {
            join(all, folded);
        }
    }
    all
}

/// Which face of a cube a direction points to.
fn cube_face(n: Vec3) -> u32 {
    let axis = n.abs().max_position();
    2 * axis as u32 + u32::from(n[axis] < 0.0)
}
