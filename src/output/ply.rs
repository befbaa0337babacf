//! Lit point clouds as PLY files.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::rows::{Lit, Row, write_rows};
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::{Grid, PointCloud};

/// Largest rounding of a coordinate, relative to the cloud's extent, that f32 may cause.
const MAX_ROUNDING: f64 = 1e-6;

const FLOATS: [&str; 7] = [
    "radius",
    "scalar_irradiance_r",
    "scalar_irradiance_g",
    "scalar_irradiance_b",
    "scalar_radiosity_r",
    "scalar_radiosity_g",
    "scalar_radiosity_b",
];

/// Writes all points of a cloud with their light, in the cloud's order, as binary little-endian
/// PLY.
///
/// Properties: `x y z` (double where float would lose detail), `nx ny nz` (0 without normals),
/// `red green blue` (radiosity as a display shows it), `radius`, `scalar_irradiance_r/g/b`,
/// `scalar_radiosity_r/g/b`, and `scalar_in_transport` (1, or 0 for points that send no light).
///
/// # Errors
/// [`Error::Invalid`] if cloud and map differ in length, [`Error::Io`] if writing fails.
pub fn write_ply(path: &Path, cloud: &PointCloud, map: &IlluminationMap) -> Result<()> {
    let lit = Lit::new(cloud, map)?;
    let comment = "irradiance and radiosity: linear RGB; red green blue: radiosity tone-mapped";
    let floats = FLOATS.iter().map(|&name| ("float", name));
    let rest: Vec<(&str, &str)> = floats.chain([("uchar", "scalar_in_transport")]).collect();
    write(path, cloud, comment, &rest, |row, i| lit.fill(row, i))
}

/// Writes all points of a cloud in other colours, with what is marked of them, in the cloud's
/// order, as binary little-endian PLY.
///
/// Properties: `x y z` (double where float would lose detail), `nx ny nz` (0 without normals),
/// `red green blue` (sRGB), and `property` (1 or 0).
///
/// # Errors
/// [`Error::Invalid`] if there is not one colour and mark a point, [`Error::Io`] if writing fails.
pub fn write_painted(
    path: &Path,
    cloud: &PointCloud,
    colours: &[[u8; 3]],
    property: &str,
    marks: &[bool],
) -> Result<()> {
    let lengths = [colours.len(), marks.len()];
    if lengths != [cloud.len(); 2] {
        return Err(Error::Invalid(format!(
            "{lengths:?} colours and marks for {} points",
            cloud.len()
        )));
    }
    write(path, cloud, "painted", &[("uchar", property)], |row, i| {
        row.vector(cloud.normals.get(i).copied().unwrap_or(Vec3::ZERO));
        row.put(&colours[i]);
        row.put(&[u8::from(marks[i])]);
    })
}

/// Writes a point a row: `x y z nx ny nz red green blue` and the `rest`, which are types and names.
/// `fill` fills a row from the normal on.
fn write(
    path: &Path,
    cloud: &PointCloud,
    comment: &str,
    rest: &[(&str, &str)],
    fill: impl Fn(&mut Row, usize) + Sync,
) -> Result<()> {
    let n = cloud.len();
    let double = needs_double(&cloud.positions, cloud.grid.as_ref());
    let position = if double { "double" } else { "float" };
    let properties: Vec<(&str, &str)> = ["x", "y", "z"]
        .map(|name| (position, name))
        .into_iter()
        .chain(["nx", "ny", "nz"].map(|name| ("float", name)))
        .chain(["red", "green", "blue"].map(|name| ("uchar", name)))
        .chain(rest.iter().copied())
        .collect();
    let header = header(n, comment, &properties);
    let stride = properties.iter().map(|&(kind, _)| bytes_of(kind)).sum();
    write_rows(path, header.as_bytes(), n, stride, |row, i| {
        let position = cloud.positions[i];
        if double {
            row.double_vector(position);
        } else {
            row.vector(position.as_vec3());
        }
        fill(row, i);
    })
}

fn bytes_of(kind: &str) -> usize {
    match kind {
        "double" => 8,
        "float" => 4,
        _ => 1,
    }
}

fn header(points: usize, comment: &str, properties: &[(&str, &str)]) -> String {
    let properties: String = properties
        .iter()
        .map(|(kind, name)| format!("property {kind} {name}\n"))
        .collect();
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment {comment}\n\
         element vertex {points}\n{properties}end_header\n"
    )
}

/// Whether f32 would round coordinates by more than the cloud's detail allows, or off their grid.
fn needs_double(positions: &[DVec3], grid: Option<&Grid>) -> bool {
    let (min, max) = super::finite_box(positions);
    let largest = min.abs().max(max.abs()).max_element();
    let extent = (max - min).length();
    let step = grid.map_or(f64::INFINITY, |grid| grid.scale.abs().min_element());
    let rounding = largest * 2f64.powi(-24);
    // Also true for extents of 0 and coordinates beyond f32; an empty box is ±infinity.
    largest.is_finite()
        && (rounding > MAX_ROUNDING * extent
            || rounding > 0.5 * step
            || largest > f64::from(f32::MAX))
}
