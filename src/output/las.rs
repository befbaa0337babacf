//! Lit point clouds as LAS files, also compressed (LAZ).

use std::io::{self, BufWriter};
use std::mem::ManuallyDrop;
use std::path::Path;

use glam::DVec3;
use las::point::Format as PointFormat;
use las::{Builder, PointDataBuilder, Transform, Vector, Vlr, Writer};

use super::columns::{COLOUR, Column, Columns};
use super::rows::{Lit, Paint, Row, fill_rows};
use super::{Format, finite_box, write_atomic_file};
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::{Grid, PointCloud};
use crate::scan::attributes::Kind;
use crate::scan::las::{DESCRIPTION, EXTRA_BYTES, PROJECTION};

/// Points that are encoded and written at a time: some chunks of compression for each thread.
const BLOCK: usize = 1 << 19;
/// Bytes of a point of format 2.
const FIXED: usize = 26;
/// Letters of the name of an extra dimension.
const LONGEST_NAME: usize = 32;
pub const SOFTWARE: &str = concat!("fmmgi-gpu ", env!("CARGO_PKG_VERSION"));
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
    let lit = Lit::new(cloud, map, Paint::Lit)?;
    write_columns(path, Columns::plain(lit, Format::Las), compressed)
}

/// Writes all points in format 2, with the columns besides the colours as extra dimensions.
pub fn write_columns(path: &Path, columns: Columns, compressed: bool) -> Result<()> {
    let places = Places::of(columns.lit.cloud)?;
    let is_extra = |column: &&Column| !COLOUR.contains(&column.name.as_str());
    let extra: Vec<Column> = columns.all.iter().filter(is_extra).cloned().collect();
    let colour = COLOUR.map(|name| {
        let mut all = columns.all.iter();
        all.find(|column| column.name == name).cloned()
    });
    let mut builder = Builder::from((1, 4));
    builder.generating_software = SOFTWARE.to_owned();
    builder.point_format = PointFormat::new(2).map_err(|e| wrong(path, e))?;
    let descriptions = extra
        .iter()
        .map(|column| description(&column.name, column.kind));
    let descriptions: Vec<u8> = descriptions.flatten().collect();
    let bytes: usize = extra.iter().map(|column| column.kind.size()).sum();
    places.describe(&mut builder);
    write(path, builder, compressed, &descriptions, bytes, |write| {
        columns.read(&mut |rows| {
            let stride = FIXED + bytes;
            let mut points = vec![0; rows.count * stride];
            fill_rows(&mut points, stride, |row, k| {
                let is_known = places.put(row, rows.lit.cloud.positions[rows.begin + k]);
                let intensity = [0, 0];
                row.put(&intensity);
                row.put(&[ONE_RETURN, if is_known { 0 } else { WITHHELD }]);
                let (scan_angle, user_data, source) = (0, 0, [0, 0]);
                row.put(&[scan_angle, user_data]);
                row.put(&source);
                for column in &colour {
                    let value = column.as_ref().and_then(|c| rows.value(c, k));
                    let value = value.unwrap_or(0.0) as u16;
                    let is_byte = column.as_ref().is_some_and(|c| c.kind == Kind::U8);
                    let value = if is_byte { value * 257 } else { value };
                    row.put(&value.to_le_bytes());
                }
                for column in &extra {
                    row.number(column.kind, rows.value(column, k));
                }
            });
            write(points)
        })
    })
}

/// Writes a file of points to which `each` hands their bytes, in order: the fields of the builder's format and
/// then `extra` bytes that `descriptions` describe.
pub fn write(
    path: &Path,
    mut builder: Builder,
    compressed: bool,
    descriptions: &[u8],
    extra: usize,
    each: impl FnOnce(&mut dyn FnMut(Vec<u8>) -> Result<()>) -> Result<()>,
) -> Result<()> {
    builder.point_format.extra_bytes = u16::try_from(extra)
        .map_err(|_| Error::Invalid(format!("{extra} extra bytes are too many for a LAS file")))?;
    builder.point_format.is_compressed = compressed;
    let (user, number) = EXTRA_BYTES;
    builder.vlrs.push(Vlr {
        user_id: user.to_owned(),
        record_id: number,
        description: "extra dimensions".to_owned(),
        data: descriptions.to_vec(),
    });
    let header = builder.into_header().map_err(|e| wrong(path, e))?;
    let stride = usize::from(header.point_format().len());
    write_atomic_file(path, |file| {
        let written = (|| {
            let records = PointDataBuilder::new().for_header(&header);
            let buffer = BufWriter::with_capacity(1 << 16, file.try_clone()?);
            // Dropped after an error it would write once more, and panic: it is left as it is.
            let mut writer = ManuallyDrop::new(Writer::new(buffer, header)?);
            let mut gathered: Vec<u8> = Vec::new();
            let mut flush = |bytes: Vec<u8>| -> Result<()> {
                let points = records.clone().build_from_bytes(bytes);
                let written = points.and_then(|points| writer.write_points(&points));
                written.map_err(|e| wrong(path, e))
            };
            let read = each(&mut |bytes| {
                gathered.extend(bytes);
                match gathered.len() >= BLOCK * stride {
                    true => flush(std::mem::take(&mut gathered)),
                    false => Ok(()),
                }
            });
            read.and_then(|()| flush(gathered))
                .map_err(io::Error::other)?;
            writer.close()?;
            let buffer = ManuallyDrop::into_inner(writer).into_inner()?;
            buffer.into_inner().map_err(io::Error::from)?;
            Ok(())
        })();
        written.map_err(|e| match e {
            las::Error::Io(e) => e,
            e => io::Error::other(e),
        })
    })
}

fn wrong(path: &Path, error: las::Error) -> Error {
    let error = match error {
        las::Error::Io(e) => e,
        e => io::Error::other(e),
    };
    Error::io(path, "cannot be written", error)
}

/// Description of an extra dimension, table 24 of the LAS 1.4 standard: type at 2, name at 4.
pub fn description(name: &str, kind: Kind) -> [u8; DESCRIPTION] {
    let mut bytes = [0; DESCRIPTION];
    bytes[2] = match kind {
        Kind::U8 => 1,
        Kind::I8 => 2,
        Kind::U16 => 3,
        Kind::I16 => 4,
        Kind::U32 => 5,
        Kind::I32 => 6,
        Kind::U64 => 7,
        Kind::I64 => 8,
        Kind::F32 => 9,
        Kind::F64 => 10,
    };
    let mut end = name.len().min(LONGEST_NAME);
    while !name.is_char_boundary(end) {
        end -= 1;
    }
    bytes[4..][..end].copy_from_slice(&name.as_bytes()[..end]);
    bytes
}

/// Where points are, in a file.
pub struct Places {
    grid: Grid,
    /// Of points that have no place.
    nowhere: DVec3,
}

impl Places {
    pub fn of(cloud: &PointCloud) -> Result<Self> {
        let (min, max) = finite_box(&cloud.positions);
        let (min, max) = if min.is_finite() {
            (min, max)
        } else {
            (DVec3::ZERO, DVec3::ZERO)
        };
        let too_large =
            || Error::Invalid("the coordinates are too large for a LAS file".to_owned());
        Ok(Places {
            grid: grid(cloud.grid.as_ref(), min, max).ok_or_else(too_large)?,
            nowhere: min,
        })
    }

    /// Tells the grid, and what it refers to.
    pub fn describe(&self, builder: &mut Builder) {
        let transform = |k: usize| Transform {
            scale: self.grid.scale[k],
            offset: self.grid.offset[k],
        };
        builder.transforms = Vector {
            x: transform(0),
            y: transform(1),
            z: transform(2),
        };
        let reference = &self.grid.reference;
        builder.has_wkt_crs = reference.iter().any(|&(number, _)| number == WKT);
        builder
            .vlrs
            .extend(reference.iter().map(|(number, data)| Vlr {
                user_id: PROJECTION.to_owned(),
                record_id: *number,
                description: String::new(),
                data: data.clone(),
            }));
    }

    /// Puts the place of a point, and tells whether it has one.
    pub fn put(&self, row: &mut Row, position: DVec3) -> bool {
        let is_known = position.is_finite();
        let position = if is_known { position } else { self.nowhere };
        let place = (position - self.grid.offset) / self.grid.scale;
        for x in place.round().as_ivec3().to_array() {
            row.put(&x.to_le_bytes());
        }
        is_known
    }
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
