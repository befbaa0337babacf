//! Exact form factor from a point to a polygon.

use crate::math::{Real, Vector};
use crate::points::MAX_EDGES;

/// Form factor from a surface element at the origin with unit `normal` to a convex polygon that is
/// seen from its front (corners counter-clockwise from there; repeated corners are allowed):
/// Lambert's formula 1/(2π) Σ angle_k · n · (a_k × b_k)/|a_k × b_k| over the edges (a_k, b_k) of the
/// polygon clipped at the element's horizon (Howell, catalogue of configuration factors, B-3).
pub fn polygon_form_factor<T: Real>(normal: T::Vec3, corners: &[T::Vec3; MAX_EDGES]) -> T {
    // Walk round the polygon and past the corners of its part above the horizon, one by one. (An
    // edge that lies in the horizon may cross it several times by rounding.)
    let mut sum = T::ZERO;
    let mut ends: Option<(T::Vec3, T::Vec3)> = None;
    let mut pass = |p: T::Vec3| {
        ends = Some(match ends {
            None => (p, p),
            Some((first, last)) => {
                sum += edge(normal, last, p);
                (first, p)
            }
        });
    };
    for k in 0..MAX_EDGES {
        let (a, b) = (corners[k], corners[(k + 1) % MAX_EDGES]);
        let (height_a, height_b) = (normal.dot(a), normal.dot(b));
        if height_a >= T::ZERO {
            pass(a);
        }
        if (height_a >= T::ZERO) != (height_b >= T::ZERO) {
            pass(a + (b - a) * (height_a / (height_a - height_b)));
        }
    }
    if let Some((first, last)) = ends {
        sum += edge(normal, last, first);
    }
    // Corners go round counter-clockwise from the front, clockwise from where the light arrives.
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
