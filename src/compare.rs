//! How far one illumination map is from another.

use std::fmt;
use std::path::Path;

use glam::{DVec3, Vec3};
use serde::Serialize;

use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scan::ply::PlyFile;

/// Darkest irradiance, relative to the mean, that errors are taken relative to.
const DARK: f64 = 0.01;
/// Largest difference of two coordinates that counts as the same place, relative to the largest
/// coordinate: two roundings to f32.
const SAME_PLACE: f64 = 2.0 * f32::EPSILON as f64;

/// Errors of a map `a` against a reference `b`, over vectors (RGB) a, b of the points.
///
/// The relative error of a point is |a - b| / max(|b|, 0.01 mean |b|): without the floor, a point
/// in the dark would count for any noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Points compared.
    pub points: usize,
    /// sqrt(Σ|a - b|² / Σ|b|²)
    pub rel_l2: f64,
    /// Median of the points' relative errors.
    pub median: f64,
    /// 95th percentile of the points' relative errors.
    pub p95: f64,
    /// 99th percentile of the points' relative errors.
    pub p99: f64,
    /// Largest relative error of a point.
    pub max: f64,
    /// Σa / Σb - 1, over all channels.
    pub bias: f64,
}

/// Compares a map with a reference.
///
/// # Errors
/// [`Error::Invalid`] if the lengths differ, nothing is there, a value is no finite number, or
/// the reference is zero everywhere.
pub fn compare(a: &[Vec3], b: &[Vec3]) -> Result<Comparison> {
    let invalid = |message: String| Err(Error::Invalid(message));
    if a.len() != b.len() {
        return invalid(format!("{} points against {}", a.len(), b.len()));
    }
    if a.is_empty() {
        return invalid("no points to compare".to_owned());
    }
    for (name, values) in [("map", a), ("reference", b)] {
        if let Some(i) = values.iter().position(|v| !v.is_finite()) {
            return invalid(format!("point {i} of the {name} is no finite number"));
        }
    }
    let pairs = || a.iter().zip(b).map(|(a, b)| (a.as_dvec3(), b.as_dvec3()));
    let square: f64 = pairs().map(|(_, b)| b.length_squared()).sum();
    if square == 0.0 {
        return invalid(
            "the reference is zero everywhere: no error can be relative to it".to_owned(),
        );
    }
    let error: f64 = pairs().map(|(a, b)| (a - b).length_squared()).sum();
    let sum = pairs()
        .fold(DVec3::ZERO, |sum, (_, b)| sum + b)
        .element_sum();
    let sum_a = pairs()
        .fold(DVec3::ZERO, |sum, (a, _)| sum + a)
        .element_sum();
    let mean = pairs().map(|(_, b)| b.length()).sum::<f64>() / b.len() as f64;
    let mut errors: Vec<f64> = pairs()
        .map(|(a, b)| (a - b).length() / b.length().max(DARK * mean))
        .collect();
    errors.sort_unstable_by(f64::total_cmp);
    let rank = |part: f64| errors[(part * (errors.len() - 1) as f64).round() as usize];
    Ok(Comparison {
        points: a.len(),
        rel_l2: (error / square).sqrt(),
        median: rank(0.5),
        p95: rank(0.95),
        p99: rank(0.99),
        max: rank(1.0),
        bias: sum_a / sum - 1.0,
    })
}

/// The signed relative difference of each point, by the sums of the channels:
/// (Σa - Σb) / max(Σb, 0.01 mean Σb).
pub fn differences(a: &[Vec3], b: &[Vec3]) -> Vec<f32> {
    let sums = b.iter().map(|b| f64::from(b.element_sum()));
    let floor = (DARK * sums.sum::<f64>() / b.len() as f64).max(f64::MIN_POSITIVE) as f32;
    let pairs = a
        .iter()
        .zip(b)
        .map(|(a, b)| (a.element_sum(), b.element_sum()));
    pairs.map(|(a, b)| (a - b) / b.max(floor)).collect()
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(
            f,
            "points  {}\nrel L2  {:.3e}\nmedian  {:.3e}\np95     {:.3e}\np99     {:.3e}\n\
             max     {:.3e}\nbias    {:+.3e}",
            self.points, self.rel_l2, self.median, self.p95, self.p99, self.max, self.bias
        )
    }
}

/// Compares the irradiance in two files that [`crate::output::write_ply`] wrote; `b` is the
/// reference.
///
/// # Errors
/// Those of reading, and [`Error::Input`] if a file has no irradiance or the two do not hold the
/// same points in the same order.
pub fn compare_files(a: &Path, b: &Path, progress: &dyn Progress) -> Result<Comparison> {
    let (light_a, light_b) = read_pair(a, b, progress)?;
    compare(&light_a, &light_b)
        .map_err(|e| Error::Invalid(format!("{} against {}: {e}", a.display(), b.display())))
}

/// The irradiance in two files of the same points in the same order.
pub fn read_pair(a: &Path, b: &Path, progress: &dyn Progress) -> Result<(Vec<Vec3>, Vec<Vec3>)> {
    let (places_a, light_a) = read_irradiance(a, progress)?;
    let (places_b, light_b) = read_irradiance(b, progress)?;
    if places_a.len() != places_b.len() {
        return Err(Error::input(
            a,
            format!(
                "has {} points, but {} has {}: they must hold the same points",
                places_a.len(),
                b.display(),
                places_b.len()
            ),
        ));
    }
    let largest = places_b
        .iter()
        .filter(|p| p.is_finite())
        .fold(0.0, |largest: f64, p| largest.max(p.abs().max_element()));
    // A coordinate that is no number is the same as another such.
    let apart = |(p, q): (&DVec3, &DVec3)| {
        let same = (*p - *q).abs().cmple(DVec3::splat(SAME_PLACE * largest));
        !(same | !p.is_finite_mask() & !q.is_finite_mask()).all()
    };
    if let Some(i) = places_a.iter().zip(&places_b).position(apart) {
        return Err(Error::input(
            a,
            format!(
                "point {i} is at {}, but at {} in {}: they must hold the same points in the same \
                 order",
                places_a[i],
                places_b[i],
                b.display()
            ),
        ));
    }
    Ok((light_a, light_b))
}

/// Positions and irradiance of a file that [`crate::output::write_ply`] wrote.
pub fn read_irradiance(path: &Path, progress: &dyn Progress) -> Result<(Vec<DVec3>, Vec<Vec3>)> {
    let ply = PlyFile::open(path)?;
    let columns = [
        "x",
        "y",
        "z",
        "irradiance_r",
        "irradiance_g",
        "irradiance_b",
    ]
    .iter()
    .map(|name| {
        ply.column(name).ok_or_else(|| {
            Error::input(
                path,
                format!("has no property {name:?}: not an output of \"solve\""),
            )
        })
    })
    .collect::<Result<Vec<_>>>()?;
    let mut places = Vec::with_capacity(ply.len());
    let mut light = Vec::with_capacity(ply.len());
    ply.rows(&columns, progress, &mut |rows| {
        for row in rows.chunks_exact(6) {
            places.push(DVec3::from_slice(row));
            light.push(DVec3::from_slice(&row[3..]).as_vec3());
        }
    })?;
    Ok((places, light))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_by_hand() {
        // |b| = 1, 2, 0; mean 1; floor 0.01.
        let b = [Vec3::X, Vec3::Y * 2.0, Vec3::ZERO];
        let a = [Vec3::X * 1.5, Vec3::Y * 2.0, Vec3::Z * 0.02];
        let c = compare(&a, &b).unwrap();
        assert!((c.rel_l2 - ((0.25 + 0.0004) / 5.0f64).sqrt()).abs() < 1e-7);
        assert!((c.median - 0.5).abs() < 1e-7);
        assert!((c.max - 2.0).abs() < 1e-6);
        assert!((c.bias - (3.52 / 3.0 - 1.0)).abs() < 1e-7);
    }

    #[test]
    fn differences_have_signs() {
        // Sums 3, 6, 0: mean 3, floor 0.03.
        let b = [1.0, 2.0, 0.0].map(Vec3::splat);
        let a = [1.5, 1.0, 0.001].map(Vec3::splat);
        let found = differences(&a, &b);
        for (found, expected) in found.into_iter().zip([0.5, -0.5, 0.1]) {
            assert!((found - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn degenerate_cases_are_told() {
        let told = |a: &[Vec3], b: &[Vec3]| compare(a, b).unwrap_err().to_string();
        assert!(told(&[], &[]).contains("no points"));
        assert!(told(&[Vec3::X], &[Vec3::ZERO]).contains("zero everywhere"));
        assert!(told(&[Vec3::X], &[]).contains("1 points against 0"));
        assert!(told(&[Vec3::X], &[Vec3::NAN]).contains("point 0 of the reference"));
    }
}
