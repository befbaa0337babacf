//! Exact form factor from a point to a polygon.

use crate::math::{Real, Vector};
use crate::points::MAX_EDGES;

/// Form factor from a surface element at the origin with unit `normal` to a convex polygon that is
/// seen from its front (corners counter-clockwise from there; repeated corners are allowed):
/// Lambert's formula 1/(2π) Σ angle_k · n · (a_k × b_k)/|a_k × b_k| over the edges (a_k, b_k) of the
/// polygon clipped at the element's horizon (Howell, catalogue of configuration factors, B-3).
pub fn polygon_form_factor<T: Real>(normal: T::Vec3, corners: &[T::Vec3; MAX_EDGES]) -> T {
    // Walking round, keep the part above the horizon. Where the walk dips below it, the clipped
    // polygon runs along the horizon, from the place of descent to that of ascent.
    let mut sum = T::ZERO;
    let mut descent = T::Vec3::default();
    let mut ascent = T::Vec3::default();
    let mut dips = false;
    for k in 0..MAX_EDGES {
        let (mut a, mut b) = (corners[k], corners[(k + 1) % MAX_EDGES]);
        let (ha, hb) = (normal.dot(a), normal.dot(b));
        if ha < T::ZERO && hb < T::ZERO {
            continue;
        }
        if ha < T::ZERO || hb < T::ZERO {
            let crossing = a + (b - a) * (ha / (ha - hb));
            dips = true;
            if ha < T::ZERO {
                ascent = crossing;
                a = crossing;
            } else {
                descent = crossing;
                b = crossing;
            }
        }
        sum += edge(normal, a, b);
    }
    if dips {
        sum += edge(normal, descent, ascent);
    }
    // Corners are counter-clockwise from the front, so clockwise seen along the way to them.
    (-sum / (T::PI + T::PI)).max(T::ZERO)
}

/// Angle under which the edge is seen, times the cosine between `normal` and the edge's plane.
#[inline(always)]
fn edge<T: Real>(normal: T::Vec3, a: T::Vec3, b: T::Vec3) -> T {
    let cross = a.cross(b);
    let sine = cross.length();
    if sine > T::ZERO {
        sine.atan2(a.dot(b)) * normal.dot(cross) / sine
    } else {
        T::ZERO
    }
}
