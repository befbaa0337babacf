//! LAS files, also compressed (LAZ, COPC).

mod chunks;
mod header;

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::colours::Stored;
use super::fields::{ORIGINAL, judge_colours};
use super::{ReadOptions, Scan, names};
use crate::error::{Error, Result};
use crate::points::{DEFAULT_REFLECTANCE, PointCloud};
use crate::progress::{Progress, Silent};
use chunks::{Chunk, Compression};
pub(crate) use header::{DESCRIPTION, EXTRA_BYTES, Extra, Header, PROJECTION};

/// Classes of points that are noise.
const NOISE: [u8; 2] = [7, 18];
/// Bytes that are read at a time; of a chunk that is longer, all.
const BLOCK: u64 = 4 << 20;

/// Reads a LAS or LAZ file of version 1.0 to 1.4.
///
/// Understood are the coordinates, on their grid, the colours, and which points are withheld or noise.
/// Intensities are no colours:
/// they fall with the distance.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let mut repairs = Vec::new();
    let (mut las, header) = Las::open(path, progress, &mut repairs)?;
    let bytes = las.bytes;
    if header.points == 0 {
        return Err(las.error("empty cloud: the file has no points"));
    }
    progress.stage("reading", bytes);
    progress.advance(header.begin);
    let record = Record::new(&header, options.keep_flagged);
    let normals = record
        .normal
        .map(|axes| axes.map(|extra| extra.name.as_str()).join(" "));
    let has_original = record.original.is_some();
    let mut points = Points::default();
    las.each(
        &header,
        false,
        |bytes, part| record.decode(bytes, part),
        &mut |part| {
            points.append(part);
            Ok(())
        },
    )?;

    let count = points.positions.len();
    let kind = if header.format.is_compressed {
        "LAZ"
    } else {
        "LAS"
    };
    let colours = &mut points.colours;
    let how = judge_colours(colours, Stored::Whole, options.colours, &mut repairs);
    let normals = normals.map_or(String::new(), |names| format!("; normals {names}"));
    let names = match has_original {
        true => ORIGINAL.join(" "),
        false => "red green blue".to_owned(),
    };
    let colours = match how {
        Some(how) => format!("colours {names}: {how}"),
        None => format!("no colours: reflectance {DEFAULT_REFLECTANCE}"),
    };
    let taken = format!("place x y z{normals}; {colours}");
    points
        .colours
        .resize(count, Vec3::splat(DEFAULT_REFLECTANCE));
    Ok(Scan {
        format: format!(
            "{kind} {}, point format {}",
            header.version, header.format_number
        ),
        fields: header.fields(),
        taken,
        cloud: PointCloud {
            emission: vec![Vec3::ZERO; count],
            positions: points.positions,
            reflectance: points.colours,
            normals: points.normals,
            flagged: match points.flagged.contains(&true) {
                true => points.flagged,
                false => Vec::new(),
            },
            grid: Some(header.grid),
            repairs,
            ..PointCloud::default()
        },
        ..Scan::default()
    })
}

/// A LAS or LAZ file whose points are copied as they are.
pub(crate) struct LasFile {
    path: PathBuf,
    pub header: Header,
}

impl LasFile {
    /// Reads the header; fails as [`read`] does.
    pub fn open(path: &Path) -> Result<Self> {
        let (_, header) = Las::open(path, &Silent, &mut Vec::new())?;
        Ok(LasFile {
            path: path.to_owned(),
            header,
        })
    }

    /// Hands the bytes of all points to `take`, block by block, each point as it is without compression.
    pub fn copy(&self, take: &mut dyn FnMut(&[u8]) -> Result<()>) -> Result<()> {
        let (mut las, header) = Las::open(&self.path, &Silent, &mut Vec::new())?;
        let keep = |bytes: &[u8], part: &mut Vec<u8>| part.extend_from_slice(bytes);
        las.each(&header, true, keep, &mut |part| take(&part))
    }
}

/// Where the bytes of a point have what.
struct Record<'a> {
    stride: usize,
    scale: DVec3,
    offset: DVec3,
    /// Begin of the colour.
    colour: Option<usize>,
    /// Where the class is, and its bits; the byte with the flag of withheld points, and its bit.
    class: (usize, u8),
    withheld: (usize, u8),
    keep_flagged: bool,
    normal: Option<[&'a Extra; 3]>,
    /// The colour that another one was painted over.
    original: Option<[&'a Extra; 3]>,
}

/// Points in the order of the file; without colours if the format has none.
#[derive(Default)]
struct Points {
    positions: Vec<DVec3>,
    colours: Vec<Vec3>,
    normals: Vec<Vec3>,
    flagged: Vec<bool>,
}

impl<'a> Record<'a> {
    fn new(header: &'a Header, keep_flagged: bool) -> Self {
        let format = &header.format;
        let fixed = if format.is_extended { 22 } else { 20 };
        let time = if format.has_gps_time { 8 } else { 0 };
        let names: Vec<&str> = header.extra.iter().map(Extra::known_name).collect();
        let three = |meanings: [&str; 3]| match meanings.map(|m| names::find(&names, m)) {
            [Some(a), Some(b), Some(c)] => Some([a, b, c].map(|i| &header.extra[i])),
            _ => None,
        };
        Record {
            stride: header.stride,
            scale: header.grid.scale,
            offset: header.grid.offset,
            colour: format.has_color.then_some(fixed + time),
            class: match format.is_extended {
                true => (16, 0xff),
                false => (15, 0x1f),
            },
            withheld: match format.is_extended {
                true => (15, 0x04),
                false => (15, 0x80),
            },
            keep_flagged,
            normal: three(["nx", "ny", "nz"]),
            original: three(ORIGINAL),
        }
    }

    /// Appends the points whose bytes are given.
    fn decode(&self, bytes: &[u8], points: &mut Points) {
        let rows = bytes.chunks_exact(self.stride);
        points.positions.extend(rows.clone().map(|row| {
            let integer = |at| i32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]);
            let integers = [0, 4, 8].map(|at| f64::from(integer(at)));
            DVec3::from(integers) * self.scale + self.offset
        }));
        if !self.keep_flagged {
            let has = |row: &[u8], (byte, bits): (usize, u8)| row[byte] & bits;
            let is_flagged =
                |row: &[u8]| has(row, self.withheld) != 0 || NOISE.contains(&has(row, self.class));
            points.flagged.extend(rows.clone().map(is_flagged));
        }
        if let Some(axes) = self.normal {
            let normal = |row| Vec3::from(axes.map(|axis| axis.value(row) as f32));
            points.normals.extend(rows.clone().map(normal));
        }
        if let Some(bands) = self.original {
            let colour = |row| Vec3::from(bands.map(|band| band.value(row) as f32));
            points.colours.extend(rows.map(colour));
        } else if let Some(colour) = self.colour {
            points.colours.extend(rows.map(|row| {
                let level = |at| u16::from_le_bytes([row[colour + at], row[colour + at + 1]]);
                Vec3::from([0, 2, 4].map(|at| f32::from(level(at))))
            }));
        }
    }
}

impl Points {
    fn append(&mut self, mut more: Points) {
        self.positions.append(&mut more.positions);
        self.colours.append(&mut more.colours);
        self.normals.append(&mut more.normals);
        self.flagged.append(&mut more.flagged);
    }
}

struct Las<'a> {
    path: &'a Path,
    input: BufReader<File>,
    bytes: u64,
    progress: &'a dyn Progress,
}

impl<'a> Las<'a> {
    fn open(
        path: &'a Path,
        progress: &'a dyn Progress,
        repairs: &mut Vec<String>,
    ) -> Result<(Self, Header)> {
        let (file, bytes) = super::open_sized(path)?;
        let mut las = Las {
            path,
            input: BufReader::with_capacity(1 << 16, file),
            bytes,
            progress,
        };
        let header = Header::read(&mut las.input, bytes, repairs);
        let header = header.map_err(|what| las.error(what))?;
        Ok((las, header))
    }

    fn error(&self, what: impl Into<String>) -> Error {
        Error::input(self.path, what)
    }

    /// Decodes the bytes of all points, decompressed, into parts that go to `take` in order. `all` asks for
    /// every field, and not only for those that make a cloud.
    fn each<T: Default + Send>(
        &mut self,
        header: &Header,
        all: bool,
        decode: impl Fn(&[u8], &mut T) + Sync,
        take: &mut dyn FnMut(T) -> Result<()>,
    ) -> Result<()> {
        // The decompressor answers damaged data with errors as far as is known. Should it panic, this
        // is still an error of the file, and no reason to end the program.
        catch_unwind(AssertUnwindSafe(|| match header.format.is_compressed {
            true => self.compressed(header, all, decode, take),
            false => self.plain(header, decode, take),
        }))
        .unwrap_or_else(|_| Err(self.error("the compressed points are damaged")))
    }

    fn plain<T: Default + Send>(
        &mut self,
        header: &Header,
        decode: impl Fn(&[u8], &mut T) + Sync,
        take: &mut dyn FnMut(T) -> Result<()>,
    ) -> Result<()> {
        let stride = header.stride as u64;
        let room = (self.bytes - header.begin) / stride;
        if room < header.points {
            return Err(self.error(format!(
                "the file is cut short: its header promises {} points, and there is room for {room}",
                header.points
            )));
        }
        super::check_count(self.path, header.points)?;
        let count = (BLOCK / stride).max(1);
        let parts: Vec<Chunk> = (0..header.points)
            .step_by(count as usize)
            .map(|begin| count.min(header.points - begin))
            .map(|points| Chunk {
                points,
                bytes: points * stride,
            })
            .collect();
        let decode = |_, bytes: &[u8], part: &mut T| {
            decode(bytes, part);
            Ok(())
        };
        self.parts(header.begin, &parts, decode, take)
    }

    fn compressed<T: Default + Send>(
        &mut self,
        header: &Header,
        all: bool,
        decode: impl Fn(&[u8], &mut T) + Sync,
        take: &mut dyn FnMut(T) -> Result<()>,
    ) -> Result<()> {
        let compression = Compression::read(&mut self.input, self.bytes, header)
            .map_err(|what| self.error(what))?;
        super::check_count(self.path, header.points)?;
        self.parts(
            compression.begin,
            &compression.chunks,
            |chunk, bytes, part| {
                compression.decompress(chunk, bytes, all, |rows| decode(rows, part))
            },
            take,
        )
    }

    /// Decodes parts of the file that lie one after the other from `begin` on: as many as
    /// there are threads are read, and then decoded in parallel. Nothing is allocated for points
    /// before their bytes are there and decoded.
    fn parts<T: Default + Send>(
        &mut self,
        begin: u64,
        parts: &[Chunk],
        decode: impl Fn(Chunk, &[u8], &mut T) -> laz::Result<()> + Sync,
        take: &mut dyn FnMut(T) -> Result<()>,
    ) -> Result<()> {
        let cannot_be_read = |e| Error::io(self.path, "cannot be read", e);
        self.input
            .seek(SeekFrom::Start(begin))
            .map_err(cannot_be_read)?;
        let mut done = 0;
        for parts in parts.chunks(2 * rayon::current_num_threads()) {
            self.progress.check()?;
            let total = parts.iter().map(|part| part.bytes).sum();
            let mut bytes = vec![0; total as usize];
            self.input.read_exact(&mut bytes).map_err(cannot_be_read)?;
            let mut rest = &bytes[..];
            let parts: Vec<(Chunk, &[u8])> = parts
                .iter()
                .map(|&part| {
                    let (bytes, after) = rest.split_at(part.bytes as usize);
                    rest = after;
                    (part, bytes)
                })
                .collect();
            let decoded: Vec<laz::Result<(u64, T)>> = parts
                .into_par_iter()
                .map(|(part, bytes)| {
                    let mut decoded = T::default();
                    decode(part, bytes, &mut decoded)?;
                    Ok((part.points, decoded))
                })
                .collect();
            for part in decoded {
                let (points, part) = part.map_err(|e| {
                    Error::input(
                        self.path,
                        format!("the compressed points are damaged, after {done} of them: {e}"),
                    )
                })?;
                take(part)?;
                done += points;
            }
            self.progress.advance(total);
        }
        Ok(())
    }
}
