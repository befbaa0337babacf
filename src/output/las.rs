//! Lit point clouds as LAS files, also compressed (LAZ).

use std::fs::File;
use std::io::{self, BufWriter};
use std::mem::ManuallyDrop;
use std::path::Path;

use glam::DVec3;
use las::point::Format;
use las::{Builder, PointDataBuilder, Transform, Vector, Vlr, Writer};

use super::rows::{Lit, Row, fill_rows};
use super::{finite_box, write_atomic_file};
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::{Grid, PointCloud};

/// Points that are encoded and written at a time: some chunks of compression for each thread.
const BLOCK: usize = 1 << 19;
/// Bytes of a point of format 2.
const FIXED: usize = 26;
/// Extra dimensions; their types are those of the standard.
const EXTRA: [(&str, u8, usize); 7] = [
    ("irradiance_r", FLOAT, 4),
    ("irradiance_g", FLOAT, 4),
    ("irradiance_b", FLOAT, 4),
    ("radiosity_r", FLOAT, 4),
    ("radiosity_g", FLOAT, 4),
    ("radiosity_b", FLOAT, 4),
    ("in_transport", UNSIGNED_CHAR, 1),
];
const UNSIGNED_CHAR: u8 = 1;
const FLOAT: u8 = 9;
/// The first of one return.
const ONE_RETURN: u8 = 0b001_001;
/// Marks points that have no place.
const WITHHELD: u8 = 0x80;
/// Number of the record with a coordinate system as well-known text.
const WKT: u16 = 2112;

/// Writes all points of a cloud with their light, in the cloud's order, as LAS 1.4, point format 2,
/// `compressed` or not.
///
/// Red, green and blue are the radiosity as a display shows it. Extra dimensions: `irradiance_r/g/b`,
/// `radiosity_r/g/b`, and `in_transport` (1, or 0 for points that send no light). Coordinates are on
/// the grid of the source and keep its reference system; without a grid their steps are less than
/// 10⁻⁸ of the extent. LAS has no way to say that a coordinate is no number: such points are at the
/// lowest corner of the cloud, and marked as withheld.
///
/// # Errors
/// [`Error::Invalid`] if cloud and map differ in length or coordinates are too large for a grid,
/// [`Error::Io`] if writing fails.
pub fn write_las(
    path: &Path,
    cloud: &PointCloud,
    map: &IlluminationMap,
    compressed: bool,
) -> Result<()> {
    let lit = Lit::new(cloud, map)?;
    let (min, max) = finite_box(&cloud.positions);
    let (min, max) = if min.is_finite() {
        (min, max)
    } else {
        (DVec3::ZERO, DVec3::ZERO)
    };
    let grid = grid(cloud.grid.as_ref(), min, max)
        .ok_or_else(|| Error::Invalid("the coordinates are too large for a LAS file".to_owned()))?;
    write_atomic_file(path, |file| {
        write(file, lit, &grid, min, compressed).map_err(|e| match e {
            las::Error::Io(e) => e,
            e => io::Error::other(e),
        })
    })
}

fn write(file: &File, lit: Lit, grid: &Grid, nowhere: DVec3, compressed: bool) -> las::Result<()> {
    let header = header(grid, compressed)?.into_header()?;
    let records = PointDataBuilder::new().for_header(&header);
    let buffer = BufWriter::with_capacity(1 << 16, file.try_clone()?);
    // Dropped after an error it would write once more, and panic: it is left as it is.
    let mut writer = ManuallyDrop::new(Writer::new(buffer, header)?);
    let stride = FIXED + EXTRA.iter().map(|(.., size)| size).sum::<usize>();
    let n = lit.len();
    for begin in (0..n).step_by(BLOCK) {
        let mut bytes = vec![0; BLOCK.min(n - begin) * stride];
        fill_rows(&mut bytes, stride, |row, k| {
            fill(row, &lit, begin + k, grid, nowhere);
        });
        writer.write_points(&records.clone().build_from_bytes(bytes)?)?;
    }
    writer.close()?;
    let buffer = ManuallyDrop::into_inner(writer).into_inner()?;
    buffer.into_inner().map_err(io::Error::from)?;
    Ok(())
}

fn header(grid: &Grid, compressed: bool) -> las::Result<Builder> {
    let transform = |k: usize| Transform {
        scale: grid.scale[k],
        offset: grid.offset[k],
    };
    let extra_bytes = EXTRA.iter().map(|&(.., size)| size as u16).sum();
    let mut builder = Builder::from((1, 4));
    builder.generating_software = concat!("fmmgi-gpu ", env!("CARGO_PKG_VERSION")).to_owned();
    builder.transforms = Vector {
        x: transform(0),
        y: transform(1),
        z: transform(2),
    };
    builder.point_format = Format {
        extra_bytes,
        is_compressed: compressed,
        ..Format::new(2)?
    };
    builder.has_wkt_crs = grid.reference.iter().any(|&(number, _)| number == WKT);
    let reference = grid.reference.iter().map(|(number, data)| Vlr {
        user_id: "LASF_Projection".to_owned(),
        record_id: *number,
        description: String::new(),
        data: data.clone(),
    });
    builder.vlrs = reference.collect();
    builder.vlrs.push(Vlr {
        user_id: "LASF_Spec".to_owned(),
        record_id: 4,
        description: "extra dimensions".to_owned(),
        data: EXTRA.iter().flat_map(description).collect(),
    });
    Ok(builder)
}

/// Description of an extra dimension, table 24 of the LAS 1.4 standard: type at 2, name at 4.
fn description(&(name, kind, _): &(&str, u8, usize)) -> [u8; 192] {
    let mut bytes = [0; 192];
    bytes[2] = kind;
    bytes[4..][..name.len()].copy_from_slice(name.as_bytes());
    bytes
}

fn fill(row: &mut Row, lit: &Lit, i: usize, grid: &Grid, nowhere: DVec3) {
    let position = lit.cloud.positions[i];
    let known = position.is_finite();
    let place = (if known { position } else { nowhere } - grid.offset) / grid.scale;
    for x in place.round().as_ivec3().to_array() {
        row.put(&x.to_le_bytes());
    }
    let intensity = [0, 0];
    row.put(&intensity);
    row.put(&[ONE_RETURN, if known { 0 } else { WITHHELD }]);
    let (scan_angle, user_data, source) = (0, 0, [0, 0]);
    row.put(&[scan_angle, user_data]);
    row.put(&source);
    for byte in lit.colour(i) {
        row.put(&(u16::from(byte) * 257).to_le_bytes());
    }
    row.vector(lit.map.irradiance[i]);
    row.vector(lit.map.radiosity[i]);
    row.put(&[u8::from(lit.map.in_transport[i])]);
}

/// A grid whose integers reach the whole box: the source's, if need be moved by whole steps, or
/// else a decimal one.
fn grid(source: Option<&Grid>, min: DVec3, max: DVec3) -> Option<Grid> {
    let most = f64::from(i32::MAX - 1);
    let reaches = |grid: &Grid| {
        [min, max].iter().all(|&corner| {
            let place = (corner - grid.offset) / grid.scale;
            place.is_finite() && place.abs().max_element() < most
        })
    };
    let middle = 0.5 * min + 0.5 * max;
    let moved = |grid: &Grid| Grid {
        offset: grid.offset + ((middle - grid.offset) / grid.scale).round() * grid.scale,
        ..grid.clone()
    };
    let decimal = || {
        let extent = (max - min).max_element();
        // Steps that f64 tells apart.
        let least = middle.abs().max_element() * f64::EPSILON;
        let step = match (extent * 1e-8).max(least) {
            0.0 => 1e-3,
            step => 10f64.powf(step.log10().floor()),
        };
        let round = 1e6 * step;
        Grid {
            scale: DVec3::splat(step),
            offset: (middle / round).round() * round,
            reference: source.map_or(Vec::new(), |grid| grid.reference.clone()),
        }
    };
    let kept = source.and_then(|grid| {
        [grid.clone(), moved(grid)]
            .into_iter()
            .find(|grid| reaches(grid))
    });
    kept.or_else(|| Some(decimal()).filter(|grid| reaches(grid)))
}
