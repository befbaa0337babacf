//! Which points of a cloud become surfels.

use std::collections::HashMap;

use glam::{DVec3, Vec3};

use super::{PointCloud, Surfels};
use crate::error::{Error, Result};

/// Usable points as surfels without cells, one a place and side; unknown areas are 0.
pub(super) fn select(
    cloud: &PointCloud,
    repairs: &mut Vec<String>,
) -> Result<(Surfels, Vec<Option<u32>>)> {
    let usable = |i: usize| {
        let normal = cloud.normals[i];
        cloud.is_placed(i) && normal.is_finite() && normal != Vec3::ZERO
    };
    let Some(origin) = middle(cloud, usable) else {
        return Err(Error::Invalid(format!(
            "none of the {} points has finite coordinates and a normal",
            cloud.len()
        )));
    };
    let mut surfels = Surfels {
        origin,
        ..Surfels::default()
    };
    let mut surfel_of_point = vec![None; cloud.len()];
    let mut places: HashMap<[u32; 3], [Option<u32>; 2]> = HashMap::with_capacity(cloud.len());
    let (mut positions_left_out, mut normals_left_out, mut merged) = (0, 0, 0);
    let mut flagged = 0;
    for i in 0..cloud.len() {
        if !usable(i) {
            if cloud.is_flagged(i) {
                flagged += 1;
            } else if cloud.is_placed(i) {
                normals_left_out += 1;
            } else {
                positions_left_out += 1;
            }
            continue;
        }
        let position = (cloud.positions[i] - origin).as_vec3();
        let normal = cloud.normals[i].as_dvec3().normalize().as_vec3();
        let area = cloud.areas.get(i).map_or(0.0, |a| a.max(0.0)); // NaN is no area either
        // + 0.0 makes one of both zeros.
        let place = places
            .entry((position + 0.0).to_array().map(f32::to_bits))
            .or_default();
        let twin = place
            .iter()
            .flatten()
            .find(|&&s| surfels.normals[s as usize].dot(normal) > 0.0);
        if let Some(&s) = twin {
            surfels.areas[s as usize] += area;
            surfel_of_point[i] = Some(s);
            merged += 1;
            continue;
        }
        let s = surfels.len() as u32;
        place[usize::from(place[0].is_some())] = Some(s);
        surfel_of_point[i] = Some(s);
        surfels.positions.push(position);
        surfels.normals.push(normal);
        surfels.areas.push(area);
        surfels.reflectance.push(cloud.reflectance[i]);
        surfels.emission.push(cloud.emission[i]);
        surfels.points.push(i as u32);
    }
    for (count, what) in [
        (
            positions_left_out,
            "points with coordinates that are not finite or beyond 1e12: left out, no light",
        ),
        (
            normals_left_out,
            "points whose normal is zero or not finite: left out, no light",
        ),
        (
            flagged,
            "points that the file flags as withheld or noise: left out, no light (--keep-flagged takes them)",
        ),
        (merged, "points at the place of another one: merged with it"),
    ] {
        if count > 0 {
            repairs.push(format!("{count} {what}"));
        }
    }
    if places.len() < 2 && surfels.areas.iter().any(|&a| a <= 0.0) {
        return Err(Error::Invalid(format!(
            "all {} usable points lie at one place: without neighbours and without areas nothing \
             tells how much surface they stand for",
            surfels.len() + merged
        )));
    }
    Ok((surfels, surfel_of_point))
}

/// Component-wise median of the usable points: near it f32 is most precise, and single points far
/// away do not move it.
pub(super) fn middle(cloud: &PointCloud, usable: impl Fn(usize) -> bool) -> Option<DVec3> {
    let positions = (0..cloud.len())
        .filter(|&i| usable(i))
        .map(|i| cloud.positions[i]);
    let mut axes: [Vec<f64>; 3] = Default::default();
    for p in positions {
        for (axis, x) in axes.iter_mut().zip(p.to_array()) {
            axis.push(x);
        }
    }
    let median = |mut axis: Vec<f64>| {
        let half = axis.len() / 2;
        (!axis.is_empty()).then(|| *axis.select_nth_unstable_by(half, f64::total_cmp).1)
    };
    let [x, y, z] = axes.map(median);
    Some(DVec3::new(x?, y?, z?))
}
