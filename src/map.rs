//! The result: light at every point.

use glam::Vec3;

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
