//! One segment against the cells, on the CPU; `shaders/visibility.wgsl` tests cells alike.

use glam::Vec3;

use crate::math::{Real, Vector};
use crate::points::MAX_EDGES;

use super::wide::{Line, walk};
use super::{NO_SURFEL, Occluder, Occluders, Segment};

/// Scale of the cells that a segment may have passed by at a gap.
pub const RIM: f32 = 2.0;
/// The same where there are cells on one side alone: a narrow gap, or the edge of a surface.
pub const EDGE: f32 = 1.4;
/// How far before a back, in radii of either cell, the gap may lie: as far as bodies are thick. What is
/// seen from behind farther off has nothing to do with the edges before it.
pub const BEHIND: f32 = 64.0;
/// Cells on two sides of one gap are passed by within so many rims of the smaller one of each other.
pub const TOGETHER: f32 = 3.0;

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
///
/// Where neighbours are not in one plane, there are gaps between their cells. A segment that comes to
/// the back of a surface may have slipped through one: then it meets the first cell that it passed by
/// on the front, within [`RIM`] and [`BEHIND`]; within [`EDGE`] if it passed by none on the other side, as
/// at the edge of a surface.
pub fn first_hit<T: Real>(occluders: &Occluders, segment: &Segment) -> Option<Hit> {
    let (from, to) = ends::<T>(segment);
    let mut first = (T::ONE, NO_SURFEL);
    let mut met = None;
    walk::<true>(
        &occluders.wide,
        &line(segment),
        &mut 1.0,
        &mut |limit, range| {
            for cell in &occluders.occluders[range] {
                let Some(crossing) = crossing::<T>(cell, from, to, T::ONE) else {
                    continue;
                };
                let here = (crossing.part(), cell.surfel);
                if here < first && covers(cell, crossing.at) && !excludes(segment, cell.surfel) {
                    first = here;
                    met = Some((cell, crossing.is_front()));
                    *limit = here.0.to_f64() as f32;
                }
            }
        },
    );
    let (cell, front) = met?;
    if !front && cell.back != NO_SURFEL {
        return Some(Hit {
            surfel: cell.back,
            front: true,
        });
    }
    let passed_by = match front {
        true => None,
        false => passed_by(occluders, segment, cell, first.0),
    };
    Some(Hit {
        surfel: passed_by.unwrap_or(cell.surfel),
        front: front || passed_by.is_some(),
    })
}

/// A front that a segment passed by.
struct Passed {
    /// Distance from the segment's beginning.
    at: f32,
    surfel: u32,
    /// Radius of its cell, or of the back's if that is smaller.
    size: f32,
    /// Whether that was closely.
    closely: bool,
    /// From the segment straight to its surfel.
    aside: Vec3,
}

/// The first front at a gap that a segment passed by, before it met this back at this part of its
/// length.
fn passed_by<T: Real>(
    occluders: &Occluders,
    segment: &Segment,
    back: &Occluder,
    part: T,
) -> Option<u32> {
    let (from, to) = ends::<T>(segment);
    let [rim, edge] = [RIM, EDGE].map(T::from_f32);
    let way = to - from;
    let length = way.length();
    let along = (way * (T::ONE / length)).to_f32();
    // The segment's last stretch before the back, and what is as near to it as a gap may be wide.
    let radius = back.radius_squared.sqrt();
    let place = (from + way * part).to_f32();
    let stretch = Vec3::from(segment.from) - place;
    let stretch = place + stretch.clamp_length_max(BEHIND * radius);
    let mut fronts: Vec<Passed> = Vec::new();
    walk::<false>(
        &occluders.wide,
        &Line::new(stretch, place, RIM * radius),
        &mut 1.0,
        &mut |_, range| {
            for cell in &occluders.occluders[range] {
                let Some(crossing) = crossing::<T>(cell, from, to, rim) else {
                    continue;
                };
                let here = crossing.part();
                if here >= part || !crossing.is_front() || excludes(segment, cell.surfel) {
                    continue;
                }
                let smaller = radius.min(cell.radius_squared.sqrt());
                let size = T::from_f32(smaller);
                let [x, y] = crossing.at;
                if x * x + y * y <= (size * rim) * (size * rim)
                    && (part - here) * length <= size * T::from_f32(BEHIND)
                    && covers(cell, crossing.at.map(|x| x / rim))
                {
                    let aside = Vec3::from(cell.position) - (from + way * here).to_f32();
                    fronts.push(Passed {
                        at: (here * length).to_f64() as f32,
                        surfel: cell.surfel,
                        size: smaller,
                        closely: covers(cell, crossing.at.map(|x| x / edge)),
                        aside: aside.reject_from_normalized(along),
                    });
                }
            }
        },
    );
    fronts.sort_unstable_by(|a, b| a.at.total_cmp(&b.at).then(a.surfel.cmp(&b.surfel)));
    let across = |a: &Passed, b: &Passed| {
        let apart = TOGETHER * RIM * a.size.min(b.size);
        (a.at - b.at).abs() <= apart && a.aside.dot(b.aside) < 0.0
    };
    let closed = |a: &&Passed| a.closely || fronts.iter().any(|b| across(a, b));
    fronts.iter().find(closed).map(|front| front.surfel)
}

/// Where the open segment crosses the plane of a cell inside it or on its edge, as a part of its
/// length; a segment in the plane does not cross it. Exchanging the ends does not change whether it
/// does, not even by rounding.
pub fn meeting<T: Real>(cell: &Occluder, from: T::Vec3, to: T::Vec3) -> Option<T> {
    let crossing = crossing::<T>(cell, from, to, T::ONE)?;
    covers(cell, crossing.at).then(|| crossing.part())
}

/// Where an open segment crosses the plane of a cell.
struct Crossing<T> {
    /// Heights of its ends above the plane.
    heights: [T; 2],
    /// Along (tangent, normal × tangent) from the surfel.
    at: [T; 2],
}

impl<T: Real> Crossing<T> {
    /// As a part of the segment's length.
    #[inline(always)]
    fn part(&self) -> T {
        self.heights[0] / (self.heights[0] - self.heights[1])
    }

    #[inline(always)]
    fn is_front(&self) -> bool {
        self.heights[0] > T::ZERO
    }
}

/// `None` too where it lies outside of the cell's circle times `scale`.
#[inline(always)]
fn crossing<T: Real>(cell: &Occluder, from: T::Vec3, to: T::Vec3, scale: T) -> Option<Crossing<T>> {
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
    if hit.dot(hit) > T::from_f32(cell.radius_squared) * (scale * scale) {
        return None;
    }
    let tangent = vector::<T>(cell.tangent);
    Some(Crossing {
        heights: [a, b],
        at: [hit.dot(tangent), hit.dot(normal.cross(tangent))],
    })
}

/// Whether a place in the plane of a cell lies inside it or on its edge.
#[inline(always)]
fn covers<T: Real>(cell: &Occluder, [x, y]: [T; 2]) -> bool {
    let corner = |k: usize| cell.corners[k % MAX_EDGES].map(T::from_f32);
    (0..MAX_EDGES).all(|k| {
        let [cx, cy] = corner(k);
        let [dx, dy] = corner(k + 1);
        (dx - cx) * (y - cy) - (dy - cy) * (x - cx) >= T::ZERO
    })
}

pub(super) fn excludes(segment: &Segment, surfel: u32) -> bool {
    surfel == segment.skip_from || surfel == segment.skip_to
}

pub(super) fn ends<T: Real>(segment: &Segment) -> (T::Vec3, T::Vec3) {
    (vector::<T>(segment.from), vector::<T>(segment.to))
}

/// What boxes are tested with.
pub(super) fn line(segment: &Segment) -> Line {
    Line::new(segment.from.into(), segment.to.into(), 0.0)
}

#[inline(always)]
pub(super) fn vector<T: Real>(v: [f32; 3]) -> T::Vec3 {
    T::Vec3::from_f32(v.into())
}
