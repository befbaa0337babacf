//! Radiosity to display colours.

use glam::Vec3;

/// Scale that brings the mean luminance to a middle grey.
pub fn exposure(radiosity: &[Vec3]) -> f32 {
    let sum: f64 = radiosity
        .iter()
        .map(|b| f64::from(b.element_sum()) / 3.0)
        .sum();
    let mean = sum / radiosity.len().max(1) as f64;
    if mean > 0.0 {
        (0.25 / mean) as f32
    } else {
        1.0
    }
}

/// sRGB bytes of an exposed radiosity.
pub fn tone_map(radiosity: Vec3, exposure: f32) -> [u8; 3] {
    let x = radiosity * exposure;
    let x = x / (Vec3::ONE + x) * 1.3;
    x.to_array()
        .map(|c| (c.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0 + 0.5) as u8)
}
