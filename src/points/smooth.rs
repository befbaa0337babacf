//! Normals and positions that scatter, averaged over their neighbours.

use glam::Vec3;
use rayon::prelude::*;

use super::neighbours::{Last, Neighbour, Neighbours};
use super::rule::SurfaceRule;

/// Neighbours that a normal is averaged with: enough to halve its noise, near enough to leave the
/// curvature.
const COUNT: usize = 8;
/// Normals that differ by this many times the roughness still belong together. (Normals with noise
/// differ by about three times the slope that is measured.)
const GATE: f64 = 4.0;

/// Normals that agree better with the positions than the given ones, and the rule for the surface
/// with them; `None` where averages over neighbours do not: the surface is clean, or it really is as
/// rough as its normals say.
///
/// Each normal is the mean of its neighbours', with weights exp(-|n_i - n_j|² / 2 s²) that keep creases
/// (bilateral filter; T. R. Jones, F. Durand and M. Zwicker, "Normal improvement for point
/// rendering", 2004), where s follows the roughness.
pub(super) fn smoothed(
    normals: &[Vec3],
    neighbours: &Neighbours,
    rule: &SurfaceRule,
) -> Option<(Vec<Vec3>, SurfaceRule)> {
    if rule.is_clean() {
        return None;
    }
    let scale = 0.5 / (GATE * rule.roughness).powi(2);
    let smooth: Vec<Vec3> = (0..normals.len())
        .into_par_iter()
        .map_init(
            || Vec::with_capacity(COUNT + 1),
            |near, i| {
                neighbours.find(i, COUNT, normals, &mut Last::default(), near);
                let own = normals[i].as_dvec3();
                let sum = near.iter().fold(own, |sum, n| {
                    sum + n.normal * (-scale * own.distance_squared(n.normal)).exp()
                });
                sum.normalize_or(own).as_vec3()
            },
        )
        .collect();
    let smoother = SurfaceRule::measure(&smooth, neighbours);
    (smoother.roughness < rule.roughness).then_some((smooth, smoother))
}

/// Noise, in spacings, above which points are moved. Below it cells come out right as they are.
const MOVED_FROM: f64 = 0.12;
/// Neighbours that a position is averaged with, if they are of the same side.
const SURFACE: usize = 32;
/// Fewer are no surface to lie on.
const FEWEST: u32 = 8;
/// Neighbours are of the same side if the cosine between the normals is larger.
const SAME_SIDE: f64 = 0.5;

/// Positions moved along their normals onto the surface of their neighbours; `None` where they lie on
/// it well enough. Noise as large as the spacing would make twice the area of a surface.
///
/// On a circular arc (n_i + n_j) · (x_j - x_i) = 0: the mean of its halves moves no point of a curved
/// surface.
pub(super) fn settled(
    positions: &[Vec3],
    normals: &[Vec3],
    neighbours: &Neighbours,
    rule: &SurfaceRule,
) -> Option<Vec<Vec3>> {
    if rule.noise <= MOVED_FROM {
        return None;
    }
    let move_point = |near: &mut Vec<Neighbour>, i: usize| {
        neighbours.find(i, SURFACE, normals, &mut Last::default(), near);
        let normal = normals[i].as_dvec3();
        let (sum, count) = near
            .iter()
            .filter(|n| n.normal.dot(normal) > SAME_SIDE)
            .fold((0.0, 0), |(sum, count), n| {
                (sum + 0.5 * (normal + n.normal).dot(n.offset), count + 1)
            });
        match count {
            ..FEWEST => positions[i],
            _ => positions[i] + (normal * (sum / f64::from(1 + count))).as_vec3(),
        }
    };
    let moved = (0..positions.len()).into_par_iter();
    Some(moved.map_init(Vec::new, move_point).collect())
}
