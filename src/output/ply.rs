//! Lit point clouds as PLY files.

use std::io;
use std::path::Path;

use glam::{DVec3, Vec3};

use super::columns::Columns;
use super::rows::{Lit, Paint, fill_rows, write_rows};
use super::{Format, write_atomic};
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::{Grid, PointCloud};
use crate::scan::attributes::Kind;

/// Largest rounding of a coordinate, relative to the cloud's extent, that f32 may cause.
const MAX_ROUNDING: f64 = 1e-6;

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
    let lit = Lit::new(cloud, map, Paint::Lit)?;
    write_columns(path, Columns::plain(lit, Format::Ply))
}

/// Writes all points with the columns as their properties.
pub fn write_columns(path: &Path, columns: Columns) -> Result<()> {
    let colours = match columns.lit.paint {
        Paint::Lit => "; red green blue: radiosity tone-mapped",
        Paint::Irradiance => "; red green blue: irradiance tone-mapped",
        Paint::Keep => "",
    };
    let comment = format!("irradiance and radiosity: linear RGB{colours}");
    let properties: Vec<(&str, &str)> = (columns.all.iter())
        .map(|column| (name_of(column.kind), column.name.as_str()))
        .collect();
    let header = header(columns.lit.len(), &comment, &properties);
    let stride = columns.all.iter().map(|column| column.kind.size()).sum();
    write_atomic(path, |writer| {
        writer.write_all(header.as_bytes())?;
        let mut bytes = Vec::new();
        let written = columns.read(&mut |rows| {
            bytes.clear();
            bytes.resize(rows.count * stride, 0);
            fill_rows(&mut bytes, stride, |row, k| {
                for column in rows.columns {
                    row.number(column.kind, rows.value(column, k));
                }
            });
            writer
                .write_all(&bytes)
                .map_err(|e| Error::io(path, "cannot be written", e))
        });
        written.map_err(io::Error::other)
    })
}

fn name_of(kind: Kind) -> &'static str {
    match kind {
        Kind::I8 => "char",
        Kind::U8 => "uchar",
        Kind::I16 => "short",
        Kind::U16 => "ushort",
        Kind::I32 => "int",
        Kind::U32 => "uint",
        Kind::I64 => "int64",
        Kind::U64 => "uint64",
        Kind::F32 => "float",
        Kind::F64 => "double",
    }
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
    let n = cloud.len();
    let double = cloud_needs_double(cloud);
    let position = if double { "double" } else { "float" };
    let properties: Vec<(&str, &str)> = (["x", "y", "z"].map(|name| (position, name)).into_iter())
        .chain(["nx", "ny", "nz"].map(|name| ("float", name)))
        .chain(["red", "green", "blue", property].map(|name| ("uchar", name)))
        .collect();
    let header = header(n, "painted", &properties);
    let stride = if double { 24 } else { 12 } + 12 + 4;
    write_rows(path, header.as_bytes(), n, stride, |row, i| {
        let position = cloud.positions[i];
        match double {
            true => row.double_vector(position),
            false => row.vector(position.as_vec3()),
        }
        row.vector(cloud.normals.get(i).copied().unwrap_or(Vec3::ZERO));
        row.put(&colours[i]);
        row.put(&[u8::from(marks[i])]);
    })
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

/// Whether f32 would round coordinates by more than the cloud's detail allows.
pub fn needs_double(positions: &[DVec3]) -> bool {
    let (min, max) = super::finite_box(positions);
    let largest = min.abs().max(max.abs()).max_element();
    let extent = (max - min).length();
    // Also true for extents of 0 and coordinates beyond f32; an empty box is ±infinity.
    largest.is_finite()
        && (largest * 2f64.powi(-24) > MAX_ROUNDING * extent || largest > f64::from(f32::MAX))
}

/// Whether f32 is not enough for the places of a cloud: see [`needs_double`], or it would move them to another
/// place on their grid.
pub fn cloud_needs_double(cloud: &PointCloud) -> bool {
    let (min, max) = super::finite_box(&cloud.positions);
    let rounding = min.abs().max(max.abs()) * 2f64.powi(-24);
    let moves = |grid: &Grid| rounding.cmpgt(0.5 * grid.scale.abs()).any();
    needs_double(&cloud.positions) || cloud.grid.as_ref().is_some_and(moves)
}
