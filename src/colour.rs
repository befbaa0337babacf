//! sRGB and linear light.

use glam::Vec3;

/// Linear value of an sRGB one, both in [0, 1].
pub fn srgb_to_linear(value: f32) -> f32 {
    if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    }
}

/// sRGB value of a linear one, both in [0, 1].
pub fn linear_to_srgb(value: f32) -> f32 {
    if value <= 0.003_130_8 {
        value * 12.92
    } else {
        1.055 * value.powf(1.0 / 2.4) - 0.055
    }
}

/// Luminance of linear RGB with the primaries of sRGB (Rec. 709).
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_goes_there_and_back() {
        for byte in 0..=255u8 {
            let value = f32::from(byte) / 255.0;
            let back = linear_to_srgb(srgb_to_linear(value));
            assert!((back - value).abs() < 1e-6, "{byte}: {back} != {value}");
        }
        // Middle grey, IEC 61966-2-1.
        assert!((srgb_to_linear(0.5) - 0.214_041).abs() < 1e-6);
    }
}
