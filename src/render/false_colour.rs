//! Signed numbers in false colours.

use glam::Vec3;

use super::image::{Image, encode};
use crate::error::Result;

/// From blue (less) over white (none) to red (more), at equal steps: the scheme RdBu of C. A. Brewer's
/// ColorBrewer, whose two halves are told apart by the colour-blind too.
const COLOURS: [[u8; 3]; 5] = [
    [5, 48, 97],
    [67, 147, 195],
    [247, 247, 247],
    [214, 96, 77],
    [103, 0, 31],
];

/// sRGB bytes of a number from -1 to 1; what is beyond is taken for that. No number is black.
pub fn false_colour(value: f32) -> [u8; 3] {
    if value.is_nan() {
        return [0; 3];
    }
    let place = 2.0 * (value.clamp(-1.0, 1.0) + 1.0);
    let step = (place as usize).min(COLOURS.len() - 2);
    let part = place - step as f32;
    std::array::from_fn(|k| {
        let [from, to] = [step, step + 1].map(|s| f32::from(COLOURS[s][k]));
        (from + part * (to - from)).round() as u8
    })
}

/// What stands for a number from -1 to 1 as a radiosity, where [`picture`](super::picture) paints.
pub fn as_radiosity(value: f32) -> Vec3 {
    Vec3::splat(0.5 * (value.clamp(-1.0, 1.0) + 1.0))
}

/// A picture of numbers [`as_radiosity`] as the bytes of a PNG file in false colours.
pub fn encode_false_colour(image: &Image) -> Result<Vec<u8>> {
    encode(image, |radiosity| false_colour(2.0 * radiosity.x - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_are_told_apart() {
        assert_eq!(false_colour(0.0), [247, 247, 247]);
        assert_eq!(false_colour(-9.0), COLOURS[0]);
        assert_eq!(false_colour(f32::INFINITY), COLOURS[4]);
        assert_eq!(false_colour(f32::NAN), [0; 3]);
        for i in 1..100 {
            let value = i as f32 / 100.0;
            let [[red, _, blue], [less_red, _, more_blue]] = [value, -value].map(false_colour);
            assert!(red > blue && more_blue > less_red, "{value}");
            let back = 2.0 * as_radiosity(value).x - 1.0;
            assert!((back - value).abs() < 1e-6);
        }
    }
}
