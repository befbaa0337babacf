//! Lit point clouds as PLY files.

use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::write_atomic;
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::PointCloud;
use crate::render::tone;

/// Rows that are encoded and written at a time.
const BLOCK: usize = 1 << 17;
/// Rows for one thread at a time.
const GRAIN: usize = 4096;
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
    let n = cloud.len();
    let lengths = [
        map.irradiance.len(),
        map.radiosity.len(),
        map.radius.len(),
        map.in_transport.len(),
    ];
    if lengths != [n; 4] {
        return Err(Error::Invalid(format!(
            "the map has {lengths:?} entries, the cloud {n} points"
        )));
    }
    let exposure = tone::exposure(&map.radiosity);
    let comment = "irradiance and radiosity: linear RGB; red green blue: radiosity tone-mapped";
    let rest: Vec<(&str, &str)> = FLOATS.iter().map(|&name| ("float", name)).collect();
    let rest = [&rest[..], &[("uchar", "scalar_in_transport")]].concat();
    write_rows(path, cloud, comment, &rest, |row, i| {
        row.put(&tone::tone_map(map.radiosity[i], exposure));
        row.put(&map.radius[i].to_le_bytes());
        row.vector(map.irradiance[i]);
        row.vector(map.radiosity[i]);
        row.put(&[u8::from(map.in_transport[i])]);
    })
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
    write_rows(path, cloud, "painted", &[("uchar", property)], |row, i| {
        row.put(&colours[i]);
        row.put(&[u8::from(marks[i])]);
    })
}

/// The bytes of a point that are still to be filled.
struct Row<'a>(&'a mut [u8]);

impl Row<'_> {
    fn put(&mut self, bytes: &[u8]) {
        self.0
            .write_all(bytes)
            .expect("a row has room for its values");
    }

    fn vector(&mut self, v: Vec3) {
        for x in v.to_array() {
            self.put(&x.to_le_bytes());
        }
    }
}

/// Writes a point a row: `x y z nx ny nz red green blue` and the `rest`, which are types and names.
/// `fill` fills a row from the colour on.
fn write_rows(
    path: &Path,
    cloud: &PointCloud,
    comment: &str,
    rest: &[(&str, &str)],
    fill: impl Fn(&mut Row, usize) + Sync,
) -> Result<()> {
    let n = cloud.len();
    let double = needs_double(&cloud.positions);
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
    write_atomic(path, |writer| {
        writer.write_all(header.as_bytes())?;
        let mut bytes = vec![0; n.min(BLOCK) * stride];
        for begin in (0..n).step_by(BLOCK) {
            let bytes = &mut bytes[..BLOCK.min(n - begin) * stride];
            bytes
                .par_chunks_exact_mut(stride)
                .enumerate()
                .with_min_len(GRAIN)
                .for_each(|(k, bytes)| {
                    let (mut row, i) = (Row(bytes), begin + k);
                    place(&mut row, cloud, i, double);
                    fill(&mut row, i);
                    debug_assert!(row.0.is_empty());
                });
            writer.write_all(bytes)?;
        }
        Ok(())
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

/// Position and normal of point `i`.
fn place(row: &mut Row, cloud: &PointCloud, i: usize, double: bool) {
    let position = cloud.positions[i];
    if double {
        for x in position.to_array() {
            row.put(&x.to_le_bytes());
        }
    } else {
        row.vector(position.as_vec3());
    }
    row.vector(cloud.normals.get(i).copied().unwrap_or(Vec3::ZERO));
}

/// Whether f32 would round coordinates by more than the cloud's detail allows.
pub fn needs_double(positions: &[DVec3]) -> bool {
    let (min, max) = positions
        .par_iter()
        .filter(|p| p.is_finite())
        .fold(
            || (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |(min, max), &p| (min.min(p), max.max(p)),
        )
        .reduce(
            || (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |a, b| (a.0.min(b.0), a.1.max(b.1)),
        );
    let largest = min.abs().max(max.abs()).max_element();
    let extent = (max - min).length();
    // Also true for extents of 0 and coordinates beyond f32; an empty box is ±infinity.
    largest.is_finite()
        && (largest * 2f64.powi(-24) > MAX_ROUNDING * extent || largest > f64::from(f32::MAX))
}
