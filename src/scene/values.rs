//! The values of a scene file, each checked where it is read, so that a bad one is reported with
//! its line.

use std::fmt;
use std::ops::RangeInclusive;

use glam::{DQuat, DVec3, EulerRot, Vec3};
use serde::Deserialize;
use serde::de::{Deserializer, Error, SeqAccess, Visitor};

/// Largest coordinate or length, so that areas and volumes stay finite.
pub const LARGEST: f64 = 1e12;
/// Most light, which leaves its sums and squares room in an f32.
pub const BRIGHTEST: f32 = 1e15;
/// Relative errors that can be asked for.
pub const TOLERANCES: RangeInclusive<f64> = 1e-6..=0.5;
/// Smallest length.
pub(super) const SMALLEST: f64 = 1e-12;

/// A position or direction.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(try_from = "Vec<f64>")]
pub(super) struct Vector(pub DVec3);

impl TryFrom<Vec<f64>> for Vector {
    type Error = String;

    fn try_from(v: Vec<f64>) -> Result<Self, String> {
        let [x, y, z] = v[..] else {
            return Err(format!("expected three numbers [x, y, z], got {}", v.len()));
        };
        if v.iter().all(|c| c.abs() <= LARGEST) {
            Ok(Self(DVec3::new(x, y, z)))
        } else {
            Err(format!(
                "{v:?}: each must be a number between -{LARGEST:e} and {LARGEST:e}"
            ))
        }
    }
}

/// A length above zero.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "f64")]
pub(super) struct Length(pub f64);

impl TryFrom<f64> for Length {
    type Error = String;

    fn try_from(x: f64) -> Result<Self, String> {
        if (SMALLEST..=LARGEST).contains(&x) {
            Ok(Self(x))
        } else {
            Err(format!(
                "{x}: must be above 0 (between {SMALLEST:e} and {LARGEST:e})"
            ))
        }
    }
}

/// Three lengths above zero.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "Vector")]
pub(super) struct Size(pub DVec3);

impl TryFrom<Vector> for Size {
    type Error = String;

    fn try_from(v: Vector) -> Result<Self, String> {
        for x in v.0.to_array() {
            Length::try_from(x)?;
        }
        Ok(Self(v.0))
    }
}

/// A rotation: [x, y, z] in degrees about the fixed axes, first x, then y, then z.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(from = "Vector")]
pub(super) struct Rotation(pub DQuat);

impl From<Vector> for Rotation {
    fn from(v: Vector) -> Self {
        let (x, y, z) = (v.0.x, v.0.y, v.0.z);
        Self(DQuat::from_euler(
            EulerRot::ZYX,
            z.to_radians(),
            y.to_radians(),
            x.to_radians(),
        ))
    }
}

/// An interval of lengths that is not empty.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "Vec<f64>")]
pub(super) struct Interval(pub [f64; 2]);

impl TryFrom<Vec<f64>> for Interval {
    type Error = String;

    fn try_from(v: Vec<f64>) -> Result<Self, String> {
        match v[..] {
            [a, b] if a >= 0.0 && a < b && b <= LARGEST => Ok(Self([a, b])),
            _ => Err(format!("{v:?}: must be [from, to] with 0 <= from < to")),
        }
    }
}

/// A number of points.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "i64")]
pub(super) struct Count(pub usize);

impl TryFrom<i64> for Count {
    type Error = String;

    fn try_from(n: i64) -> Result<Self, String> {
        match usize::try_from(n) {
            Ok(n) if n > 0 => Ok(Self(n)),
            _ => Err(format!("{n}: must be at least 1")),
        }
    }
}

/// A relative error.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "f64")]
pub(super) struct Tolerance(pub f64);

impl TryFrom<f64> for Tolerance {
    type Error = String;

    fn try_from(x: f64) -> Result<Self, String> {
        if TOLERANCES.contains(&x) {
            Ok(Self(x))
        } else {
            let (least, most) = (TOLERANCES.start(), TOLERANCES.end());
            Err(format!("{x:?}: must be between {least:?} and {most}"))
        }
    }
}

/// The part of the light that a surface sends back.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "Rgb")]
pub(super) struct Reflectance(pub Vec3);

impl TryFrom<Rgb> for Reflectance {
    type Error = String;

    fn try_from(Rgb(c): Rgb) -> Result<Self, String> {
        if c.iter().all(|x| (0.0..=1.0).contains(x)) {
            Ok(Self(Vec3::from_array(c.map(|x| x as f32))))
        } else {
            Err(format!("{c:?}: a reflectance is between 0 and 1"))
        }
    }
}

/// An amount of light: exitance, intensity or irradiance.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(try_from = "Rgb")]
pub(super) struct Light(pub Vec3);

impl TryFrom<Rgb> for Light {
    type Error = String;

    fn try_from(Rgb(c): Rgb) -> Result<Self, String> {
        if c.iter().all(|x| (0.0..=f64::from(BRIGHTEST)).contains(x)) {
            Ok(Self(Vec3::from_array(c.map(|x| x as f32))))
        } else {
            Err(format!(
                "{c:?}: light is a number from 0 on (and at most {BRIGHTEST:e})"
            ))
        }
    }
}

/// One number for all three channels, or [red, green, blue].
struct Rgb([f64; 3]);

impl<'de> Deserialize<'de> for Rgb {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(RgbVisitor)
    }
}

struct RgbVisitor;

impl<'de> Visitor<'de> for RgbVisitor {
    type Value = Rgb;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("a number or three numbers [red, green, blue]")
    }

    fn visit_i64<E: Error>(self, x: i64) -> Result<Rgb, E> {
        Ok(Rgb([x as f64; 3]))
    }

    fn visit_f64<E: Error>(self, x: f64) -> Result<Rgb, E> {
        Ok(Rgb([x; 3]))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Rgb, A::Error> {
        let mut channels = Vec::new();
        while let Some(x) = seq.next_element::<f64>()? {
            channels.push(x);
        }
        let got = channels.len();
        let channels = channels.try_into();
        channels
            .map(Rgb)
            .map_err(|_| A::Error::invalid_length(got, &self))
    }
}
