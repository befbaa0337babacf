//! The result: light at every point.

use glam::{DVec3, Vec3};

use crate::points::{PointCloud, Surfels};

/// The illumination map: one entry a point of the cloud, in its order.
#[derive(Clone, Debug, Default)]
pub struct IlluminationMap {
    /// Irradiance H, direct and after all bounces (linear RGB; unit of the emission).
    pub irradiance: Vec<Vec3>,
    /// Radiosity B = emission + reflectance * H.
    pub radiosity: Vec<Vec3>,
    /// Radius in the scan's unit of the disc with the point's area.
    pub radius: Vec<f32>,
    /// False for points that were left out of the transport (no usable position or normal, or a
    /// duplicate of another point): they send no light.
    pub in_transport: Vec<bool>,
}

impl IlluminationMap {
    /// Hands the irradiance of the surfels to the points of the cloud, whose places among the surfels
    /// are given.
    pub fn new(
        cloud: &PointCloud,
        places: &[Option<u32>],
        surfels: &Surfels,
        irradiance: &[DVec3],
    ) -> IlluminationMap {
        let mut map = IlluminationMap::default();
        for (i, place) in places.iter().enumerate() {
            let place = place.map(|k| k as usize);
            let (light, area) = place.map_or((Vec3::ZERO, 0.0), |k| {
                (irradiance[k].as_vec3(), surfels.areas[k])
            });
            map.irradiance.push(light);
            map.radiosity
                .push(cloud.emission[i] + cloud.reflectance[i] * light);
            map.radius.push((area / std::f32::consts::PI).sqrt());
            let own = place.is_some_and(|k| surfels.points[k] as usize == i);
            map.in_transport.push(own);
        }
        map
    }
}
