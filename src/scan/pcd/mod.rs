//! PCD files of the Point Cloud Library: ascii, binary and compressed.

mod header;
mod lzf;

use std::io::{BufReader, Read};
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::colours::Stored;
use super::fields::{Builder, Fields, Rows};
use super::lines::{Lines, not_a_number, number, words};
use super::{ReadOptions, Scan, names, scanner};
use crate::error::{Error, Result};
use crate::memory;
use crate::progress::Progress;
pub(super) use header::begins;
use header::{Data, Header, Kind};

/// Bytes that are read, decoded and handed on at a time.
const BLOCK: usize = 4 << 20;
/// Rows for one thread at a time.
const GRAIN: usize = 4096;

/// Reads a PCD file.
///
/// Understood are the [names](super::names) of PLY files, and colour as `rgb` or `rgba`, packed into one
/// value. Points that are no numbers, as organised clouds have them, stay in the cloud. Where VIEWPOINT tells it,
/// and is not the default, the scanner stands.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let (file, bytes) = super::open_sized(path)?;
    progress.stage("reading", bytes);
    let mut input = BufReader::with_capacity(1 << 16, file);
    let header = header::read(&mut input).map_err(|what| Error::input(path, what))?;
    progress.advance(header.bytes);
    let bytes = bytes.saturating_sub(header.bytes);
    header.check(path, bytes)?;
    if header.points == 0 {
        return Err(Error::input(path, "empty cloud: the header says 0 points"));
    }
    let mut repairs = Vec::new();
    let (names, columns) = columns(&header);
    let stored = |column: usize| match columns[column].kind {
        Kind::U1 => Stored::Bytes,
        Kind::F4 | Kind::F8 => Stored::Floats,
        _ => Stored::Whole,
    };
    let fields = Fields::find(&names, stored, &mut repairs);
    let fields = fields.ok_or_else(|| Error::input(path, "the fields lack x, y or z"))?;
    let chosen: Vec<Column> = fields.columns.iter().map(|&i| columns[i]).collect();
    let mut builder = Builder::new(fields, 0);
    let mut take = |rows: Rows| builder.append(rows);
    let body = Body {
        path,
        header: &header,
        columns: &chosen,
        progress,
    };
    match header.data {
        Data::Ascii => body.ascii(input, &mut take)?,
        Data::Binary => body.binary(input, &mut take)?,
        Data::Compressed => body.compressed(input, bytes, &mut take)?,
    }
    let (mut cloud, taken) = builder.finish(options.colours, repairs);
    // Directions without a return, as some drivers write them; one point may be at the origin.
    let is_origin = |p: &DVec3| *p == DVec3::ZERO;
    let without_return = cloud.positions.iter().filter(|p| is_origin(p)).count();
    if without_return > 1 {
        let nowhere = cloud.positions.iter_mut().filter(|p| is_origin(p));
        nowhere.for_each(|p| *p = DVec3::NAN);
        cloud.repairs.push(format!(
            "{without_return} points at the origin, as directions without a return are: without a place"
        ));
    }
    let place = header.viewpoint;
    let scanner = place.and_then(|place| scanner(&cloud, 0..cloud.len(), place));
    cloud.scanners.extend(scanner);
    let encoding = match header.data {
        Data::Ascii => "ascii",
        Data::Binary => "binary",
        Data::Compressed => "binary_compressed",
    };
    let [width, height] = header.size;
    let size = match height {
        0 | 1 => String::new(),
        _ => format!(", organised {width} x {height}"),
    };
    Ok(Scan {
        format: format!("PCD, {encoding}{size}"),
        fields: header.fields.into_iter().map(|field| field.name).collect(),
        taken,
        sampled: false,
        cloud,
    })
}

/// A value within the bytes of a point.
#[derive(Clone, Copy)]
struct Column {
    field: usize,
    kind: Kind,
    /// Whether it packs a colour.
    packed: bool,
}

impl Column {
    fn decode(self, bytes: &[u8]) -> f64 {
        match (self.packed, self.kind, self.kind.decode(bytes)) {
            // Many colours as bits are no number of which a float keeps the bits.
            (true, Kind::F4, value) if value.fract() != 0.0 || value.abs() >= 2f64.powi(32) => {
                Kind::U4.decode(bytes)
            }
            (.., value) => value,
        }
    }

    /// The value of a word; packed colours keep all digits.
    fn parse(self, word: &[u8]) -> Option<f64> {
        let mut bytes = [0; 8];
        match self.packed {
            true => number(word),
            false => {
                self.kind.encode(word, &mut bytes)?;
                Some(self.kind.decode(&bytes))
            }
        }
    }
}

/// All fields of a point, with their names.
fn columns(header: &Header) -> (Vec<&str>, Vec<Column>) {
    let fields = header.fields.iter().enumerate();
    let column = |(i, field): (usize, &header::Field)| {
        let column = Column {
            field: i,
            kind: field.kind,
            packed: names::meaning(&field.name) == Some("rgb"),
        };
        (header.fields[i].name.as_str(), column)
    };
    fields.map(column).unzip()
}

/// The points of a file, behind its header.
struct Body<'a> {
    path: &'a Path,
    header: &'a Header,
    columns: &'a [Column],
    progress: &'a dyn Progress,
}

impl Body<'_> {
    /// One line a point. Its words are made the bytes that a binary file has.
    fn ascii(&self, input: impl Read, take: &mut dyn FnMut(Rows)) -> Result<()> {
        let header = self.header;
        let mut lines = Lines::new(self.path, input, b'\n', header.lines + 1, self.progress);
        let parse = |line: &[u8], row: &mut [f64]| {
            let mut words = words(line);
            for (i, field) in header.fields.iter().enumerate() {
                let missing = || format!("the line ends before the value of {:?}", field.name);
                let word = words.next().ok_or_else(missing)?;
                let wrong = || not_a_number(word, &format!("field {:?}", field.name));
                number(word).ok_or_else(wrong)?;
                for _ in 1..field.count {
                    words.next().ok_or_else(missing)?;
                }
                for (value, column) in row.iter_mut().zip(self.columns) {
                    if column.field == i {
                        *value = column.parse(word).ok_or_else(wrong)?;
                    }
                }
            }
            match words.next() {
                None => Ok(()),
                Some(_) => Err("more values than the header has fields".to_owned()),
            }
        };
        match lines.rows(header.points, self.columns.len(), parse, take)? {
            done if done < header.points => Err(self.cut_short(done)),
            _ => Ok(()),
        }
    }

    /// Points of equal length.
    fn binary(&self, mut input: impl Read, take: &mut dyn FnMut(Rows)) -> Result<()> {
        let stride = self.header.stride();
        let places = self.places(|field| self.header.offset(field));
        let block = (BLOCK / stride).clamp(1, self.header.points);
        let mut bytes = vec![0; block * stride];
        let mut done = 0;
        while done < self.header.points {
            let rows = block.min(self.header.points - done);
            let bytes = &mut bytes[..rows * stride];
            input.read_exact(bytes).map_err(|e| match e.kind() {
                std::io::ErrorKind::UnexpectedEof => self.cut_short(done),
                _ => Error::io(self.path, "cannot be read", e),
            })?;
            let value = |row: usize, (place, column): (usize, Column)| {
                column.decode(&bytes[row * stride + place..])
            };
            self.take_rows(rows, &places, value, take)?;
            self.progress.advance(bytes.len() as u64);
            done += rows;
        }
        Ok(())
    }

    /// All values of a field, then all of the next, compressed together.
    fn compressed(
        &self,
        mut input: impl Read,
        bytes: u64,
        take: &mut dyn FnMut(Rows),
    ) -> Result<()> {
        let error = |what: String| Error::input(self.path, what);
        let cannot = |e| Error::io(self.path, "cannot be read", e);
        let points = self.header.points;
        let mut sizes = [[0; 4]; 2];
        for size in &mut sizes {
            input.read_exact(size).map_err(|_| self.cut_short(0))?;
        }
        let [packed, unpacked] = sizes.map(|size| u64::from(u32::from_le_bytes(size)));
        let expected = points as u128 * self.header.stride() as u128;
        if u128::from(unpacked) != expected {
            return Err(error(format!(
                "{points} points take {expected} bytes, but the compressed ones are said to have \
                 {unpacked}"
            )));
        }
        if packed + 8 > bytes {
            return Err(error(format!(
                "the file is cut short: it has {} of {packed} bytes of compressed points",
                bytes.saturating_sub(8)
            )));
        }
        lzf::check(packed, unpacked).map_err(error)?;
        memory::check_points(points as u64)
            .map_err(|e| Error::TooLarge(format!("{}: {e}", self.path.display())))?;
        let mut compressed = Vec::new();
        input
            .take(packed)
            .read_to_end(&mut compressed)
            .map_err(cannot)?;
        self.progress.advance(packed);
        self.progress.check()?;
        let mut bytes = vec![0; unpacked as usize];
        lzf::decompress(&compressed, &mut bytes).map_err(error)?;
        drop(compressed);
        let fields = self.places(|field| points * self.header.offset(field));
        let size_of = |column: Column| self.header.fields[column.field].size();
        let block = BLOCK / self.header.stride().min(BLOCK);
        for done in (0..points).step_by(block.max(1)) {
            let value = |row: usize, (place, column): (usize, Column)| {
                column.decode(&bytes[place + (done + row) * size_of(column)..])
            };
            let rows = block.max(1).min(points - done);
            self.take_rows(rows, &fields, value, take)?;
        }
        Ok(())
    }

    /// Each column with the place where its field begins.
    fn places(&self, begin: impl Fn(usize) -> usize) -> Vec<(usize, Column)> {
        let place = |column: &Column| (begin(column.field), *column);
        self.columns.iter().map(place).collect()
    }

    /// Hands on some rows, whose values are found on all threads.
    fn take_rows(
        &self,
        rows: usize,
        places: &[(usize, Column)],
        value: impl Fn(usize, (usize, Column)) -> f64 + Sync,
        take: &mut dyn FnMut(Rows),
    ) -> Result<()> {
        self.progress.check()?;
        let mut values = vec![0.0; rows * places.len()];
        values
            .par_chunks_exact_mut(places.len())
            .enumerate()
            .with_min_len(GRAIN)
            .for_each(|(row, values)| {
                for (to, &place) in values.iter_mut().zip(places) {
                    *to = value(row, place);
                }
            });
        take(&values);
        Ok(())
    }

    fn cut_short(&self, done: usize) -> Error {
        Error::input(
            self.path,
            format!(
                "the file is cut short: it ends after {done} of {} points",
                self.header.points
            ),
        )
    }
}
