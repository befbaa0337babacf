//! Point lights.

use std::f32::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::BATCH;
use crate::error::Result;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::scene::PointLight;
use crate::visibility::{NO_SURFEL, Segment, Visibility};

/// Irradiance from point lights.
pub struct Illuminated {
    /// One entry a surfel.
    pub irradiance: Vec<DVec3>,
    /// Surfels that lie closer to a light than their own radius.
    pub too_close: usize,
    /// Lights that lay on a surfel.
    pub on_surface: usize,
}

/// Irradiance I cos θ / r² from every light that a surfel sees. Inside a surfel's own disc
/// (π r² < area) the distance is taken as the disc's radius: a light on a surface stays finite.
/// It is lifted off the surface, as the surfels' own ends of segments are.
pub fn point_lights(
    surfels: &Surfels,
    lights: &[PointLight],
    visibility: &dyn Visibility,
    progress: &dyn Progress,
) -> Result<Illuminated> {
    let mut irradiance = vec![DVec3::ZERO; surfels.len()];
    let (mut too_close, mut on_surface) = (0, 0);
    for light in lights {
        progress.stage("point lights", surfels.len() as u64);
        let mut place = (light.position - surfels.origin).as_vec3();
        if let Some(lifted) = lifted(surfels, place) {
            place = lifted;
            on_surface += 1;
        }
        for (k, batch) in irradiance.chunks_mut(BATCH).enumerate() {
            progress.check()?;
            let first = k * BATCH;
            // What each facing surfel would get.
            let unoccluded: Vec<(usize, f32, bool)> = (0..batch.len())
                .into_par_iter()
                .filter_map(|b| {
                    let i = first + b;
                    let way = place - surfels.positions[i];
                    let close = way.length_squared() < surfels.areas[i] / PI;
                    let form = form(way, surfels.normals[i], surfels.areas[i])?;
                    Some((b, form, close))
                })
                .collect();
            let segments: Vec<Segment> = unoccluded
                .iter()
                .map(|&(b, ..)| Segment {
                    from: surfels.above(first + b).to_array(),
                    skip_from: (first + b) as u32,
                    to: place.to_array(),
                    skip_to: NO_SURFEL,
                })
                .collect();
            let visible = visibility.visible(&segments)?;
            for (&(b, form, close), _) in unoccluded.iter().zip(visible).filter(|&(_, v)| v) {
                batch[b] += light.intensity.as_dvec3() * f64::from(form);
                too_close += usize::from(close);
            }
            progress.advance(batch.len() as u64);
        }
    }
    Ok(Illuminated {
        irradiance,
        too_close,
        on_surface,
    })
}

/// What a piece of surface of this area gets of a unit of intensity that comes along `way` from it, if it
/// faces it: cos θ / r².
pub(crate) fn form(way: Vec3, normal: Vec3, area: f32) -> Option<f32> {
    let distance2 = way.length_squared();
    let height = normal.dot(way);
    (height > 0.0).then(|| height / (distance2.max(area / PI) * distance2.sqrt()))
}

/// Where a light that lies on a surfel shines from: there, rounding would decide what it sees.
fn lifted(surfels: &Surfels, place: Vec3) -> Option<Vec3> {
    let on = (0..surfels.len()).into_par_iter().filter_map(|i| {
        let way = place - surfels.positions[i];
        let height = surfels.normals[i].dot(way);
        let aside2 = way.length_squared() - height * height;
        // Corners of a cell reach further than the disc of its area.
        let reach2 = 4.0 * surfels.areas[i] / std::f32::consts::PI;
        let lift = surfels.offsets[i] - height;
        (height.abs() < surfels.offsets[i] && aside2 < reach2).then_some((aside2, i, lift))
    });
    on.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
        .map(|(_, i, lift)| place + surfels.normals[i] * lift)
}
