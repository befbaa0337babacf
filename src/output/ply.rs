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
    let double = needs_double(&cloud.positions);
    let header = header(n, double);
    let stride = 3 * if double { 8 } else { 4 } + 3 * 4 + 3 + FLOATS.len() * 4 + 1;
    write_atomic(path, |writer| {
        writer.write_all(header.as_bytes())?;
        let mut bytes = vec![0; n.min(BLOCK) * stride];
        for begin in (0..n).step_by(BLOCK) {
            let bytes = &mut bytes[..BLOCK.min(n - begin) * stride];
            bytes
                .par_chunks_exact_mut(stride)
                .enumerate()
                .with_min_len(GRAIN)
                .for_each(|(row, mut bytes)| {
                    encode(&mut bytes, cloud, map, begin + row, double, exposure);
                    debug_assert!(bytes.is_empty());
                });
            writer.write_all(bytes)?;
        }
        Ok(())
    })
}

fn header(points: usize, double: bool) -> String {
    let mut header = format!(
        "ply\nformat binary_little_endian 1.0\n\
         comment irradiance and radiosity: linear RGB; red green blue: radiosity tone-mapped\n\
         element vertex {points}\n"
    );
    let mut property = |kind: &str, name: &str| {
        header += &format!("property {kind} {name}\n");
    };
    for name in ["x", "y", "z"] {
        property(if double { "double" } else { "float" }, name);
    }
    for name in ["nx", "ny", "nz"] {
        property("float", name);
    }
    for name in ["red", "green", "blue"] {
        property("uchar", name);
    }
    for name in FLOATS {
        property("float", name);
    }
    property("uchar", "scalar_in_transport");
    header + "end_header\n"
}

/// Fills the bytes of point `i`.
fn encode(
    row: &mut &mut [u8],
    cloud: &PointCloud,
    map: &IlluminationMap,
    i: usize,
    double: bool,
    exposure: f32,
) {
    let mut put = |bytes: &[u8]| row.write_all(bytes).expect("a row has room for its values");
    for x in cloud.positions[i].to_array() {
        if double {
            put(&x.to_le_bytes());
        } else {
            put(&(x as f32).to_le_bytes());
        }
    }
    let normal = cloud.normals.get(i).copied().unwrap_or(Vec3::ZERO);
    for x in normal.to_array() {
        put(&x.to_le_bytes());
    }
    put(&tone::tone_map(map.radiosity[i], exposure));
    put(&map.radius[i].to_le_bytes());
    for vector in [map.irradiance[i], map.radiosity[i]] {
        for x in vector.to_array() {
            put(&x.to_le_bytes());
        }
    }
    put(&[u8::from(map.in_transport[i])]);
}

/// Whether f32 would round coordinates by more than the cloud's detail allows.
fn needs_double(positions: &[DVec3]) -> bool {
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
