//! All numbers that a file has of its points, for outputs that keep them.

use std::path::Path;

use ply_rs::ply::{Encoding, PropertyType, ScalarType};
use rayon::prelude::*;

use super::las::LasFile;
use super::ply::PlyFile;
use super::text::TextFile;
use super::{Format, names};
use crate::error::Result;
use crate::progress::Silent;

/// Rows for one thread at a time.
const GRAIN: usize = 512;

/// How a number is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    /// In rows of f64 the bits are these of the whole number.
    I64,
    U64,
    F32,
    F64,
}

impl Kind {
    /// The bytes of a value, little endian.
    pub fn bytes(self, value: f64) -> ([u8; 8], usize) {
        let mut bytes = [0; 8];
        macro_rules! number {
            ($value:expr) => {{
                let number = $value.to_le_bytes();
                bytes[..number.len()].copy_from_slice(&number);
                number.len()
            }};
        }
        let size = match self {
            Kind::I8 => number!((value as i8)),
            Kind::U8 => number!((value as u8)),
            Kind::I16 => number!((value as i16)),
            Kind::U16 => number!((value as u16)),
            Kind::I32 => number!((value as i32)),
            Kind::U32 => number!((value as u32)),
            Kind::F32 => number!((value as f32)),
            Kind::I64 | Kind::U64 | Kind::F64 => number!(value),
        };
        (bytes, size)
    }

    pub fn size(self) -> usize {
        self.bytes(0.0).1
    }
}

/// A number that a file has of each point.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Attribute {
    /// As in the file.
    pub name: String,
    pub kind: Kind,
}

/// A file whose points are read once more, with all that it has of them.
pub(crate) struct Attributes {
    pub all: Vec<Attribute>,
    /// What of it cannot be kept, in words.
    pub lost: Vec<String>,
    file: File,
}

enum File {
    Ply(PlyFile, Vec<usize>),
    Las(Box<LasFile>),
    /// With the places of the columns in rows, if these are numbers.
    Text(TextFile, Option<Vec<Option<usize>>>),
}

/// The points of a file, block by block: rows of f64, or lines of text.
pub(crate) enum Block<'a> {
    Rows(&'a [f64]),
    Lines(&'a TextFile, &'a [&'a [u8]]),
}

impl Attributes {
    /// Opens a file that was read before with these `fields`; `None` for formats that have nothing to keep, or
    /// whose attributes are not kept. With `as_text` the columns of a text are kept as they are written.
    pub fn open(path: &Path, fields: &[String], as_text: bool) -> Result<Option<Self>> {
        match Format::of(path)? {
            Format::Ply => PlyFile::open(path).map(|ply| Some(of_ply(ply))),
            Format::Las => LasFile::open(path).map(|las| Some(of_las(las))),
            Format::Text => TextFile::open(path, fields).map(|text| Some(of_text(text, as_text))),
            _ => Ok(None),
        }
    }

    /// Whether colours and normals have the names and types that programs expect in a PLY file.
    pub fn is_ply(&self) -> bool {
        matches!(self.file, File::Ply(..))
    }

    /// Hands all points to `take` in order, block by block; stops where that fails.
    pub fn read(self, take: &mut dyn FnMut(Block) -> Result<()>) -> Result<()> {
        let width = self.all.len();
        match self.file {
            File::Ply(ply, columns) => {
                let is_ascii = ply.encoding() == Encoding::Ascii;
                let mut taken = Ok(());
                let mut whole = Vec::new();
                ply.rows(&columns, &Silent, &mut |rows| {
                    if taken.is_err() {
                        return;
                    }
                    taken = match is_ascii {
                        false => take(Block::Rows(rows)),
                        true => {
                            // Whole numbers of 64 bits are their bits.
                            whole.clear();
                            whole.extend_from_slice(rows);
                            for row in whole.chunks_exact_mut(width) {
                                for (value, attribute) in row.iter_mut().zip(&self.all) {
                                    match attribute.kind {
                                        Kind::I64 => *value = f64::from_bits(*value as i64 as u64),
                                        Kind::U64 => *value = f64::from_bits(*value as u64),
                                        _ => {}
                                    }
                                }
                            }
                            take(Block::Rows(&whole))
                        }
                    };
                })?;
                taken
            }
            File::Las(las) => {
                let stride = las.header.stride;
                las.copy(&mut |bytes| {
                    let parts = bytes.par_chunks(stride * GRAIN).map(|points| {
                        let mut rows = Vec::new();
                        for point in points.chunks_exact(stride) {
                            las_row(&las, point, &mut rows);
                        }
                        rows
                    });
                    take(Block::Rows(&parts.collect::<Vec<_>>().concat()))
                })
            }
            File::Text(text, None) => text.read(&mut |lines| take(Block::Lines(&text, lines))),
            File::Text(text, Some(slots)) => {
                let mut rows = Vec::new();
                text.read(&mut |lines| {
                    rows.clear();
                    rows.resize(lines.len() * width, 0.0);
                    rows.par_chunks_exact_mut(width)
                        .zip(lines)
                        .with_min_len(GRAIN)
                        .for_each(|(row, line)| text.numbers(line, &slots, row));
                    take(Block::Rows(&rows))
                })
            }
        }
    }
}

fn of_ply(ply: PlyFile) -> Attributes {
    let mut attributes = Vec::new();
    let mut columns = Vec::new();
    let mut lost = Vec::new();
    for (column, (name, property, is_wide)) in ply.properties().enumerate() {
        let kind = match property {
            PropertyType::List(..) => {
                lost.push(format!("list {name}"));
                continue;
            }
            PropertyType::Scalar(_) if is_wide == Some(true) => Kind::I64,
            PropertyType::Scalar(_) if is_wide == Some(false) => Kind::U64,
            PropertyType::Scalar(scalar) => match scalar {
                ScalarType::Char => Kind::I8,
                ScalarType::UChar => Kind::U8,
                ScalarType::Short => Kind::I16,
                ScalarType::UShort => Kind::U16,
                ScalarType::Int => Kind::I32,
                ScalarType::UInt => Kind::U32,
                ScalarType::Float => Kind::F32,
                ScalarType::Double => Kind::F64,
            },
        };
        attributes.push(Attribute { name, kind });
        columns.push(column);
    }
    lost.extend(ply.others().map(|name| format!("element {name}")));
    Attributes {
        all: attributes,
        lost,
        file: File::Ply(ply, columns),
    }
}

/// The fields of LAS points before the time, in the order of [`las_row`].
const LAS_FIELDS: [(&str, Kind); 14] = [
    ("intensity", Kind::U16),
    ("return_number", Kind::U8),
    ("number_of_returns", Kind::U8),
    ("synthetic", Kind::U8),
    ("key_point", Kind::U8),
    ("withheld", Kind::U8),
    ("overlap", Kind::U8),
    ("scanner_channel", Kind::U8),
    ("scan_direction", Kind::U8),
    ("edge_of_flight_line", Kind::U8),
    ("classification", Kind::U8),
    ("scan_angle", Kind::F32),
    ("user_data", Kind::U8),
    ("source_id", Kind::U16),
];
/// Degrees that a step of a scan angle is in the point formats from 6 on.
const ANGLE_STEP: f64 = 0.006;

fn of_las(las: LasFile) -> Attributes {
    let format = las.header.format;
    let attribute = |name: &str, kind| Attribute {
        name: name.to_owned(),
        kind,
    };
    let mut all: Vec<Attribute> = LAS_FIELDS
        .iter()
        .map(|&(name, kind)| attribute(name, kind))
        .collect();
    if format.has_gps_time {
        all.push(attribute("gps_time", Kind::F64));
    }
    if format.has_color {
        all.extend(["red", "green", "blue"].map(|name| attribute(name, Kind::U16)));
    }
    if format.has_nir {
        all.push(attribute("nir", Kind::U16));
    }
    let mut lost = Vec::new();
    if format.has_waveform {
        lost.push("waveforms".to_owned());
    }
    for extra in &las.header.extra {
        let is_raw = extra.scale == 1.0 && extra.offset == 0.0;
        let kind = match extra.kind {
            1..=9 if !is_raw => Kind::F64,
            1 => Kind::U8,
            2 => Kind::I8,
            3 => Kind::U16,
            4 => Kind::I16,
            5 => Kind::U32,
            6 => Kind::I32,
            7 => Kind::U64,
            8 => Kind::I64,
            9 => Kind::F32,
            10 => Kind::F64,
            _ => {
                lost.push(format!("extra bytes {:?} that are no number", extra.name));
                continue;
            }
        };
        all.push(attribute(&extra.name, kind));
    }
    Attributes {
        all,
        lost,
        file: File::Las(Box::new(las)),
    }
}

fn las_row(las: &LasFile, point: &[u8], rows: &mut Vec<f64>) {
    let format = &las.header.format;
    let u16_at = |at: usize| f64::from(u16::from_le_bytes([point[at], point[at + 1]]));
    let bit = |at: usize, bit: u8| f64::from(point[at] >> bit & 1);
    rows.push(u16_at(12));
    let time = if format.is_extended {
        let angle = i16::from_le_bytes([point[18], point[19]]);
        rows.extend([point[14] & 15, point[14] >> 4].map(f64::from));
        rows.extend([bit(15, 0), bit(15, 1), bit(15, 2), bit(15, 3)]);
        rows.push(f64::from(point[15] >> 4 & 3));
        rows.extend([bit(15, 6), bit(15, 7), f64::from(point[16])]);
        rows.extend([f64::from(angle) * ANGLE_STEP, f64::from(point[17])]);
        rows.push(u16_at(20));
        22
    } else {
        rows.extend([point[14] & 7, point[14] >> 3 & 7].map(f64::from));
        rows.extend([bit(15, 5), bit(15, 6), bit(15, 7), 0.0, 0.0]);
        rows.extend([bit(14, 6), bit(14, 7), f64::from(point[15] & 31)]);
        rows.extend([f64::from(point[16] as i8), f64::from(point[17])]);
        rows.push(u16_at(18));
        20
    };
    let mut at = time;
    if format.has_gps_time {
        rows.push(f64::from_le_bytes(std::array::from_fn(|i| point[at + i])));
        at += 8;
    }
    if format.has_color {
        rows.extend([0, 2, 4].map(|k| u16_at(at + k)));
        at += 6;
    }
    if format.has_nir {
        rows.push(u16_at(at));
    }
    for extra in las.header.extra.iter().filter(|extra| extra.is_known()) {
        let is_wide = matches!(extra.kind, 7 | 8) && extra.scale == 1.0 && extra.offset == 0.0;
        rows.push(match is_wide {
            true => f64::from_le_bytes(std::array::from_fn(|i| point[extra.begin + i])),
            false => extra.value(point),
        });
    }
}

fn of_text(text: TextFile, as_text: bool) -> Attributes {
    let mut all = Vec::new();
    let mut lost = Vec::new();
    let mut slots = Vec::new();
    for (column, name) in text.names().iter().enumerate() {
        let name = match name.as_str() {
            "_" | "" => format!("column_{}", column + 1),
            name => name.to_owned(),
        };
        let is_kept = as_text || text.is_number(column);
        slots.push(is_kept.then_some(all.len()));
        match is_kept {
            true => all.push(Attribute {
                name,
                kind: Kind::F64,
            }),
            false => lost.push(format!("column {name}, which is no number")),
        }
    }
    Attributes {
        all,
        lost,
        file: File::Text(text, (!as_text).then_some(slots)),
    }
}

/// Whether a file's values of this name give the place, the normal or the area of points.
pub(crate) fn is_geometry(name: &str) -> bool {
    let meaning = names::meaning(name);
    meaning.is_some_and(|meaning| GEOMETRY.contains(&meaning))
}

const GEOMETRY: [&str; 8] = ["x", "y", "z", "nx", "ny", "nz", "area", "radius"];
