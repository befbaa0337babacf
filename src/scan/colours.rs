//! From the colours of a file to reflectances: one rule for all formats.
//!
//! Colours are sRGB, and white reflects 0.9. Bytes go from 0 to 255. What else there is, the largest
//! value of the whole file tells: fractions up to 1, 8 bits up to 255, in the upper half of 16 bits where
//! the lower is empty, or else 16 bits.

use glam::Vec3;
use rayon::prelude::*;

use crate::colour::srgb_to_linear;
use crate::points::MAX_COLOUR_REFLECTANCE;

/// Colours for one thread at a time.
const GRAIN: usize = 4096;
/// Fractions may be so large, as some programs brighten them.
const BRIGHTEST_FRACTION: f32 = 2.0;

/// What colours are said to be, instead of what their values tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourSpace {
    /// sRGB, white is 255.
    Srgb8,
    /// sRGB, white is 65535.
    Srgb16,
    /// Linear light, white as the values tell.
    Linear,
}

/// How a file stores colours, as far as it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stored {
    Bytes,
    /// Whole numbers of more than 8 bits, with sign or without.
    Whole,
    Floats,
    /// As words, of which nobody says what they hold.
    Words,
}

/// What the values of a whole file are like.
#[derive(Clone, Copy)]
struct Range {
    min: f32,
    max: f32,
    whole: bool,
    /// Whether all are multiples of 256.
    upper: bool,
}

impl Range {
    const NONE: Range = Range {
        min: f32::INFINITY,
        max: f32::NEG_INFINITY,
        whole: true,
        upper: true,
    };

    fn of(values: &[Vec3]) -> Self {
        let channels = values.par_iter().with_min_len(GRAIN);
        let fold = |range: Range, colour: &Vec3| {
            let finite = colour.to_array().into_iter().filter(|c| c.is_finite());
            finite.fold(range, |range, c| Range {
                min: range.min.min(c),
                max: range.max.max(c),
                whole: range.whole && c.fract() == 0.0,
                upper: range.upper && c % 256.0 == 0.0,
            })
        };
        let join = |a: Range, b: Range| Range {
            min: a.min.min(b.min),
            max: a.max.max(b.max),
            whole: a.whole && b.whole,
            upper: a.upper && b.upper,
        };
        channels
            .fold(|| Range::NONE, fold)
            .reduce(|| Range::NONE, join)
    }
}

/// Turns stored colours to reflectances, and says how they were taken; `None`, with the reason in
/// `repairs`, if they say nothing. Values outside the range stay outside of 0 to 1.
pub fn to_reflectances(
    values: &mut [Vec3],
    stored: Stored,
    told: Option<ColourSpace>,
    repairs: &mut Vec<String>,
) -> Option<String> {
    let mut range = Range::of(values);
    if range.max < range.min {
        return None; // no number at all
    }
    if let Some(levels) = signed(stored, range) {
        let unsigned = |c: f32| if c < 0.0 { c + levels } else { c };
        map(values, |c| c.map(unsigned));
        range = Range::of(values);
    }
    if range.max <= 0.0 {
        let count = values.len();
        repairs.push(format!("{count} colours left out: all are black"));
        return None;
    }
    let (white, name) = match told {
        Some(ColourSpace::Srgb8) => (255.0, "8 bits"),
        Some(ColourSpace::Srgb16) => (65535.0, "16 bits"),
        Some(ColourSpace::Linear) | None => {
            let Some(depth) = depth(stored, range) else {
                let (count, max) = (values.len(), range.max);
                repairs.push(format!(
                    "{count} colours left out: values up to {max} are of no known depth; --colours \
                     says what they are"
                ));
                return None;
            };
            depth
        }
    };
    let count = values.len();
    if stored == Stored::Whole && white <= 255.0 && told.is_none() {
        repairs.push(format!("{count} colours of 8 bit found in wider numbers"));
    } else if name.contains("upper") && told.is_none() {
        repairs.push(format!(
            "{count} colours of 8 bit found in the upper half of 16"
        ));
    }
    if told == Some(ColourSpace::Linear) {
        map(values, |c| c / white);
        return Some(format!("linear, {name}, as told"));
    }
    let linear = |c: f32| match c / white {
        c @ 0.0..=1.0 => srgb_to_linear(c).min(MAX_COLOUR_REFLECTANCE),
        c => c,
    };
    if range.whole && white >= 255.0 {
        let table: Vec<f32> = (0..=white as u32).map(|c| linear(c as f32)).collect();
        map(values, |c| {
            c.map(|c| match table.get(c as usize) {
                Some(&reflectance) if c >= 0.0 => reflectance,
                _ => c / white,
            })
        });
    } else {
        map(values, |c| c.map(linear));
    }
    let doubt = match (told, stored, range) {
        (Some(_), ..) => " as told",
        (_, Stored::Floats | Stored::Words, _) if white == 1.0 => {
            " (if they are linear: --colours linear)"
        }
        // Dark colours of 8 bits, or fractions that are too bright.
        (_, Stored::Floats | Stored::Words, Range { max: ..31.0, .. }) => {
            " (dark; if white is not 255: --colours)"
        }
        _ => "",
    };
    Some(format!("sRGB, {name}{doubt}"))
}

/// White, and what that is called.
fn depth(stored: Stored, range: Range) -> Option<(f32, &'static str)> {
    let brightest_fraction = match (stored, range.whole) {
        (Stored::Bytes | Stored::Whole, _) => 0.0,
        (_, true) => 1.0,
        (_, false) => BRIGHTEST_FRACTION,
    };
    match range.max {
        max if max <= brightest_fraction => Some((1.0, "0 to 1")),
        ..=255.0 => Some((255.0, "8 bits")),
        ..=65535.0 if range.upper => Some((65280.0, "8 bits in the upper half of 16")),
        ..=65535.0 => Some((65535.0, "16 bits")),
        _ => None,
    }
}

/// The levels of unsigned numbers that were written as signed ones, if that is so.
fn signed(stored: Stored, range: Range) -> Option<f32> {
    let is_signed = stored == Stored::Whole && range.min < 0.0;
    match (range.min, range.max) {
        (-128.0.., ..=127.0) if is_signed => Some(256.0),
        (-32768.0.., ..=32767.0) if is_signed => Some(65536.0),
        _ => None,
    }
}

fn map(values: &mut [Vec3], to: impl Fn(Vec3) -> Vec3 + Sync) {
    let values = values.par_iter_mut().with_min_len(GRAIN);
    values.for_each(|value| *value = to(*value));
}

/// Red, green and blue of a value that packs them as 0xAARRGGBB: a whole number, with sign or without, or
/// the bits of a float. Whole floats are taken as whole numbers: as bits they would be of an alpha around 75.
pub fn unpacked(value: f64) -> Vec3 {
    let is_whole = value.fract() == 0.0 && value.abs() < 2f64.powi(32);
    let bits = match is_whole {
        true => value as i64 as u32,
        false => (value as f32).to_bits(),
    };
    match value.is_nan() {
        true => Vec3::NAN,
        false => of_bits(bits),
    }
}

fn of_bits(bits: u32) -> Vec3 {
    let [blue, green, red, _] = bits.to_le_bytes();
    Vec3::from([red, green, blue].map(f32::from))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(values: &[f32], stored: Stored) -> (Vec<f32>, Option<String>) {
        let mut values: Vec<Vec3> = values.iter().map(|&v| Vec3::splat(v)).collect();
        let said = to_reflectances(&mut values, stored, None, &mut Vec::new());
        (values.iter().map(|v| v.x).collect(), said)
    }

    #[test]
    fn the_whole_file_tells_the_depth() {
        use Stored::{Bytes, Floats, Whole, Words};
        let half = 0.502_886; // of 188 of 255
        for (values, stored, name) in [
            (&[0.0, 188.0][..], Bytes, "8 bits"),
            (&[0.0, 188.0], Whole, "8 bits"),
            (&[0.0, -68.0], Whole, "8 bits"),
            (&[0.0, 188.0], Floats, "8 bits"),
            (&[0.0, 188.0, 2.5], Words, "8 bits"),
            (&[0.0, 188.0 * 256.0], Whole, "upper half"),
            (&[0.0, 188.0 * 257.0, 1.0], Whole, "16 bits"),
            (&[0.0, 188.0 * 257.0 - 65536.0, 1.0], Whole, "16 bits"),
            (&[0.0, 188.0 / 255.0], Floats, "0 to 1"),
            (&[0.0, 188.0 / 255.0, 1.01], Words, "0 to 1"),
        ] {
            let (linear, said) = taken(values, stored);
            assert!((linear[1] - half).abs() < 1e-5, "{values:?}: {linear:?}");
            assert!(said.is_some_and(|said| said.contains(name)), "{values:?}");
        }
        assert_eq!(taken(&[0.0, 0.0], Bytes).1, None);
        assert_eq!(taken(&[0.0, 1e6], Floats).1, None);
    }

    #[test]
    fn packed_colours_are_read_in_every_way() {
        let expected = Vec3::new(200.0, 100.0, 50.0);
        let bits = 0x00c8_6432u32;
        for value in [
            f64::from(bits),
            f64::from(bits | 0xff00_0000),
            f64::from((bits | 0xff00_0000) as i32),
            f64::from(f32::from_bits(bits)),
        ] {
            assert_eq!(unpacked(value), expected, "{value}");
        }
        // A word for it has lost the bits.
        assert!(unpacked(f64::NAN).is_nan());
    }
}
