//! Radiosity to display colours.

use glam::Vec3;
use rayon::prelude::*;

use crate::colour::{linear_to_srgb, luminance};

/// Part of the lit points that is at most as bright as the white point.
const WHITE_PERCENTILE: f64 = 0.95;
/// Linear display value of the white point; what is brighter shares the rest up to 1.
const WHITE: f32 = 0.8;

/// Factor for [`tone_map`] that brings the 95th percentile of the luminance of all lit points to
/// 0.8 (linear) on the display; 1 if nothing is lit.
pub fn exposure(radiosity: &[Vec3]) -> f32 {
    let mut lit: Vec<f32> = radiosity
        .par_iter()
        .map(|&b| luminance(b))
        .filter(|&l| l > 0.0 && l.is_finite())
        .collect();
    if lit.is_empty() {
        return 1.0;
    }
    let rank = (WHITE_PERCENTILE * (lit.len() - 1) as f64).round() as usize;
    let (_, white, _) = lit.select_nth_unstable_by(rank, f32::total_cmp);
    // Inverse of the curve of `tone_map`; the smallest luminances would overflow.
    (-(1.0 - WHITE).ln() / *white).min(f32::MAX)
}

/// sRGB bytes of a radiosity: a film-like shoulder, 1 - exp(-exposure * B), for each of red, green
/// and blue. Values that are negative or no number are black.
pub fn tone_map(radiosity: Vec3, exposure: f32) -> [u8; 3] {
    radiosity.to_array().map(|b| {
        let display = -(-(b * exposure).max(0.0)).exp_m1();
        (linear_to_srgb(display) * 255.0).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_brings_the_95th_percentile_to_white() {
        for scale in [1e-30, 1.0, 1e30] {
            let grey: Vec<Vec3> = (0..=1000).map(|i| Vec3::splat(i as f32 * scale)).collect();
            // Zero is not lit: ranks run over 1..=1000.
            let white = tone_map(grey[950], exposure(&grey));
            let expected = (linear_to_srgb(WHITE) * 255.0).round() as u8;
            assert_eq!(white, [expected; 3], "scale {scale}");
        }
    }

    #[test]
    fn tone_map_is_monotonic_and_survives_anything() {
        let mut last = 0;
        for i in 0..10_000 {
            let [grey, ..] = tone_map(Vec3::splat(i as f32 * 0.001), 1.0);
            assert!(grey >= last);
            last = grey;
        }
        assert_eq!(last, 255);
        let odd = Vec3::new(f32::NAN, f32::NEG_INFINITY, f32::INFINITY);
        assert_eq!(tone_map(odd, 1.0), [0, 0, 255]);
        assert_eq!(tone_map(Vec3::ZERO, f32::MAX), [0, 0, 0]);
        assert_eq!(exposure(&[Vec3::NAN, Vec3::ZERO]), 1.0);
    }
}
