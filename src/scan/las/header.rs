//! The header of a LAS file and the records after it: read here, and checked against the file's
//! length before anything is believed.
//!
//! The reader of the crate `las` would go through a billion records where the header promises
//! that many, and allocate whatever an extended record claims; only its parsing of one header and
//! of one record is used.

use std::io::{BufRead, ErrorKind, Seek, SeekFrom};

use glam::DVec3;
use las::point::Format;
use las::{Version, Vlr, raw};

use crate::points::Grid;

/// Bytes of a record's header.
const VLR_HEADER: u64 = 54;
/// Bytes of the header of a record after the points.
const EVLR_HEADER: usize = 60;
/// Longer records after the points are not kept: no coordinate system is.
const LONGEST_RECORD: u64 = 1 << 20;
/// The user of the records that say in which reference system coordinates are.
pub const PROJECTION: &str = "LASF_Projection";
/// User and number of the record that describes what points have beside the fields of the format.
pub const EXTRA_BYTES: (&str, u16) = ("LASF_Spec", 4);
/// Bytes of the description of one such value, table 24 of the LAS 1.4 standard.
pub const DESCRIPTION: usize = 192;

pub struct Header {
    pub version: Version,
    pub points: u64,
    pub format: Format,
    /// Number of the format, without the bit for compression.
    pub format_number: u8,
    /// Bytes of a point, uncompressed.
    pub stride: usize,
    /// Where the points begin in the file.
    pub begin: u64,
    pub grid: Grid,
    /// Content of the record that describes the compression.
    pub laszip: Option<Vec<u8>>,
    /// What points have beside the fields of the format: all bytes, in their order.
    pub extra: Vec<Extra>,
    /// All else that the file says of itself, for a copy of it.
    pub raw: raw::Header,
    /// The records before the points, and those behind, but for the longest of these.
    pub records: [Vec<Vlr>; 2],
    /// Who made the records behind the points that are too long to be kept.
    pub long: Vec<String>,
}

impl Header {
    /// Reads the header of a file of `bytes` bytes; fails with what is wrong.
    pub fn read(
        input: &mut (impl BufRead + Seek),
        bytes: u64,
        repairs: &mut Vec<String>,
    ) -> Result<Header, String> {
        let raw = raw::Header::read_from(&mut *input).map_err(|e| match e {
            las::Error::Io(e) if e.kind() == ErrorKind::UnexpectedEof => {
                "the file is cut short: it ends inside the header".to_owned()
            }
            e => format!("header: {e}"),
        })?;
        let Version { major, minor } = raw.version;
        if major != 1 || minor > 4 {
            return Err(format!(
                "LAS version {major}.{minor}; understood are 1.0 to 1.4"
            ));
        }
        let (format_number, format, stride) = format(&raw)?;
        let begin = u64::from(raw.offset_to_point_data);
        if begin < u64::from(raw.header_size.max(raw.version.header_size())) {
            return Err(format!("the points begin inside the header, at {begin}"));
        }
        if begin > bytes {
            return Err(format!(
                "the file is cut short: its points begin at {begin}, but it has {bytes} bytes"
            ));
        }
        let mut header = Header {
            version: raw.version,
            points: points(&raw, format.is_extended, repairs),
            format,
            format_number,
            stride,
            begin,
            grid: grid(&raw)?,
            laszip: None,
            extra: Vec::new(),
            raw: raw.clone(),
            records: [Vec::new(), Vec::new()],
            long: Vec::new(),
        };
        header
            .read_records(input, &raw, repairs)
            .map_err(|e| format!("the records after the header: {e}"))?;
        header.read_extended_records(input, bytes, &raw, repairs);
        let length = usize::from(header.format.len());
        let descriptions = (header.records.iter().flatten())
            .filter(|record| (record.user_id.as_str(), record.record_id) == EXTRA_BYTES)
            .flat_map(|record| record.data.chunks_exact(DESCRIPTION));
        header.extra = extra(descriptions, length, header.stride);
        let references = (header.records.iter().flatten())
            .filter(|record| record.user_id == PROJECTION)
            .map(|record| (record.record_id, record.data.clone()));
        header.grid.reference = references.collect();
        Ok(header)
    }

    /// What the file says of each point.
    pub fn fields(&self) -> Vec<String> {
        let format = &self.format;
        let fields = [
            (
                "x y z intensity returns classification scan_angle user_data source_id",
                true,
            ),
            ("gps_time", format.has_gps_time),
            ("red green blue", format.has_color),
            ("nir", format.has_nir),
            ("waveform", format.has_waveform),
        ];
        let present = fields.iter().filter(|(_, present)| *present);
        present
            .flat_map(|(names, _)| names.split(' ').map(str::to_owned))
            .chain(
                (self.extra.iter())
                    .filter(|extra| extra.is_known())
                    .map(|extra| extra.name.clone()),
            )
            .collect()
    }

    /// Keeps the records after the points, as far as they are there.
    fn read_extended_records(
        &mut self,
        input: &mut (impl BufRead + Seek),
        bytes: u64,
        raw: &raw::Header,
        repairs: &mut Vec<String>,
    ) {
        let Some(evlr) = raw.evlr else { return };
        let mut at = evlr.start_of_first_evlr;
        for found in 0..evlr.number_of_evlrs {
            let mut head = [0; EVLR_HEADER];
            let read = input
                .seek(SeekFrom::Start(at))
                .and_then(|_| input.read_exact(&mut head));
            let length = u64::from_le_bytes(std::array::from_fn(|i| head[20 + i]));
            let begin = at.saturating_add(EVLR_HEADER as u64);
            at = begin.saturating_add(length);
            if read.is_err() || at > bytes {
                repairs.push(format!(
                    "{} records promised after the points, but only {found} are there",
                    evlr.number_of_evlrs
                ));
                return;
            }
            let text = |bytes: &[u8]| {
                let end = bytes.iter().position(|&byte| byte == 0);
                String::from_utf8_lossy(&bytes[..end.unwrap_or(bytes.len())]).into_owned()
            };
            let user = text(&head[2..18]);
            if length > LONGEST_RECORD {
                self.long.push(user);
                continue;
            }
            let mut data = vec![0; length as usize];
            // It is there, as the file is long enough.
            if input.read_exact(&mut data).is_ok() {
                self.records[1].push(Vlr {
                    user_id: user,
                    record_id: u16::from_le_bytes([head[18], head[19]]),
                    description: text(&head[28..60]),
                    data,
                });
            }
        }
    }

    /// Keeps the records before the points.
    fn read_records(
        &mut self,
        input: &mut (impl BufRead + Seek),
        raw: &raw::Header,
        repairs: &mut Vec<String>,
    ) -> las::Result<()> {
        let promised = raw.number_of_variable_length_records;
        let mut at = u64::from(raw.header_size);
        input.seek(SeekFrom::Start(at))?;
        for found in 0..promised {
            let record = match at + VLR_HEADER <= self.begin {
                true => Vlr::new(raw::Vlr::read_from(&mut *input, false)?),
                false => Vlr::default(),
            };
            at += record.len(false) as u64;
            if at > self.begin {
                repairs.push(format!(
                    "{promised} records promised after the header, but only {found} fit before \
                     the points"
                ));
                break;
            }
            if las::laz::is_laszip_vlr(&record) {
                self.laszip = Some(record.data);
            } else {
                self.records[0].push(record);
            }
        }
        Ok(())
    }
}

/// Number of points. Point formats from 6 on count in 64 bits, the others in 32 where they can.
fn points(raw: &raw::Header, is_extended: bool, repairs: &mut Vec<String>) -> u64 {
    let legacy = u64::from(raw.number_of_point_records);
    match raw.large_file.map(|large| large.number_of_point_records) {
        Some(points) if is_extended && points > 0 || legacy == 0 => {
            if legacy != 0 && legacy != points {
                repairs.push(format!(
                    "{points} points, as the header counts in 64 bits; in 32 it counts {legacy}"
                ));
            }
            points
        }
        _ => legacy,
    }
}

/// A value that points have beside the fields of the format.
pub struct Extra {
    pub name: String,
    /// Type, by its number in the standard.
    pub kind: u8,
    /// Where it begins in a point, and its bytes.
    pub begin: usize,
    pub size: usize,
    pub scale: f64,
    pub offset: f64,
    /// As the file has it.
    pub description: [u8; DESCRIPTION],
}

impl Extra {
    /// Whether it is a number. Without a description it is none; types above 10 are outdated.
    pub fn is_known(&self) -> bool {
        (1..=10).contains(&self.kind)
    }

    /// The name of a number; none for other bytes.
    pub fn known_name(&self) -> &str {
        match self.is_known() {
            true => &self.name,
            false => "",
        }
    }

    pub fn value(&self, row: &[u8]) -> f64 {
        macro_rules! number {
            ($type:ty) => {{
                let bytes = std::array::from_fn(|i| row[self.begin + i]);
                <$type>::from_le_bytes(bytes) as f64
            }};
        }
        let value = match self.kind {
            1 => number!(u8),
            2 => number!(i8),
            3 => number!(u16),
            4 => number!(i16),
            5 => number!(u32),
            6 => number!(i32),
            7 => number!(u64),
            8 => number!(i64),
            9 => number!(f32),
            _ => number!(f64),
        };
        value * self.scale + self.offset
    }
}

/// What descriptions of extra bytes tell, as far as it fits into points of `stride` bytes, whose fixed fields
/// end at `begin`; what is left is described as bytes of an unknown kind.
fn extra<'a>(
    descriptions: impl Iterator<Item = &'a [u8]>,
    mut begin: usize,
    stride: usize,
) -> Vec<Extra> {
    let mut all = Vec::new();
    for bytes in descriptions {
        let mut description = [0; DESCRIPTION];
        description.copy_from_slice(bytes);
        let (kind, options) = (description[2], description[3]);
        let size = match kind {
            0 => options.into(),
            // The outdated ones are two or three numbers.
            1..=30 => usize::from((kind - 1) / 10 + 1) * SIZES[usize::from((kind - 1) % 10)],
            _ => break,
        };
        if begin + size > stride {
            break;
        }
        let name = &description[4..36];
        let end = name.iter().position(|&byte| byte == 0);
        let number = |bit: u8, at: usize, otherwise: f64| match options >> bit & 1 {
            1 if kind > 0 => f64::from_le_bytes(std::array::from_fn(|i| description[at + i])),
            _ => otherwise,
        };
        all.push(Extra {
            name: String::from_utf8_lossy(&name[..end.unwrap_or(name.len())]).into_owned(),
            kind,
            begin,
            size,
            scale: number(3, 112, 1.0),
            offset: number(4, 136, 0.0),
            description,
        });
        begin += size;
    }
    while begin < stride {
        let size = (stride - begin).min(u8::MAX.into());
        let mut description = [0; DESCRIPTION];
        description[3] = size as u8;
        all.push(Extra {
            name: String::new(),
            kind: 0,
            begin,
            size,
            scale: 1.0,
            offset: 0.0,
            description,
        });
        begin += size;
    }
    all
}

/// Bytes of the types 1 to 10 of extra bytes.
const SIZES: [usize; 10] = [1, 1, 2, 2, 4, 4, 8, 8, 4, 8];

/// Number, fields and length of a point.
fn format(raw: &raw::Header) -> Result<(u8, Format, usize), String> {
    // The highest bit says that points are compressed, the next was never used.
    let number = raw.point_data_record_format & 0x7f;
    let stride = raw.point_data_record_length;
    let format = Format::new(raw.point_data_record_format)
        .ok()
        .filter(|_| number <= 10)
        .ok_or_else(|| format!("point format {number}; understood are 0 to 10"))?;
    if stride < format.len() {
        return Err(format!(
            "points of {stride} bytes, but format {number} takes {}",
            format.len()
        ));
    }
    Ok((number, format, stride.into()))
}

fn grid(raw: &raw::Header) -> Result<Grid, String> {
    let grid = Grid {
        scale: DVec3::new(raw.x_scale_factor, raw.y_scale_factor, raw.z_scale_factor),
        offset: DVec3::new(raw.x_offset, raw.y_offset, raw.z_offset),
        reference: Vec::new(),
    };
    let usable = |scale: f64| scale != 0.0 && scale.is_finite();
    if grid.scale.to_array().into_iter().all(usable) && grid.offset.is_finite() {
        Ok(grid)
    } else {
        Err(format!(
            "coordinates cannot be counted in steps of {} from {}",
            grid.scale, grid.offset
        ))
    }
}
