//! The header of a PCD file.

use std::io::{BufRead, Read};
use std::path::Path;

use glam::DVec3;

use crate::error::{Error, Result};
use crate::scan::BOM;
use crate::scan::lines::number;

type Parsed<T> = std::result::Result<T, String>;

/// Longest header that is read, in bytes.
const MAX_HEADER: u64 = 1 << 16;
/// Most values of a field (descriptors have hundreds).
const MAX_COUNT: usize = 1 << 16;

pub struct Header {
    pub fields: Vec<Field>,
    /// Width and height.
    pub size: [u64; 2],
    /// Place of the scanner; `None` if it is only the default.
    pub viewpoint: Option<DVec3>,
    pub points: usize,
    pub data: Data,
    /// Length of the header, in bytes and in lines.
    pub bytes: u64,
    pub lines: u64,
}

#[derive(Clone, Copy, PartialEq)]
pub enum Data {
    Ascii,
    Binary,
    Compressed,
}

pub struct Field {
    pub name: String,
    pub kind: Kind,
    /// Values of this kind.
    pub count: usize,
}

impl Field {
    pub fn size(&self) -> usize {
        self.kind.size() * self.count
    }
}

/// A type and its bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    I1,
    I2,
    I4,
    I8,
    U1,
    U2,
    U4,
    U8,
    F4,
    F8,
}

impl Kind {
    fn of(letter: &str, size: &str) -> Parsed<Self> {
        Ok(match (&*letter.to_uppercase(), size) {
            ("I", "1") => Kind::I1,
            ("I", "2") => Kind::I2,
            ("I", "4") => Kind::I4,
            ("I", "8") => Kind::I8,
            ("U", "1") => Kind::U1,
            ("U", "2") => Kind::U2,
            ("U", "4") => Kind::U4,
            ("U", "8") => Kind::U8,
            ("F", "4") => Kind::F4,
            ("F", "8") => Kind::F8,
            _ => return Err(format!("no type {letter:?} of {size:?} bytes is known")),
        })
    }

    pub fn size(self) -> usize {
        match self {
            Kind::I1 | Kind::U1 => 1,
            Kind::I2 | Kind::U2 => 2,
            Kind::I4 | Kind::U4 | Kind::F4 => 4,
            Kind::I8 | Kind::U8 | Kind::F8 => 8,
        }
    }

    /// The value at the start of `bytes`, which are little-endian.
    #[inline]
    pub fn decode(self, bytes: &[u8]) -> f64 {
        macro_rules! number {
            ($type:ty) => {{
                let mut own = [0; size_of::<$type>()];
                own.copy_from_slice(&bytes[..size_of::<$type>()]);
                <$type>::from_le_bytes(own) as f64
            }};
        }
        match self {
            Kind::I1 => number!(i8),
            Kind::I2 => number!(i16),
            Kind::I4 => number!(i32),
            Kind::I8 => number!(i64),
            Kind::U1 => number!(u8),
            Kind::U2 => number!(u16),
            Kind::U4 => number!(u32),
            Kind::U8 => number!(u64),
            Kind::F4 => number!(f32),
            Kind::F8 => number!(f64),
        }
    }

    /// Puts a number in words into `bytes`. Whole numbers that the type cannot hold become its
    /// nearest ones.
    pub fn encode(self, word: &[u8], bytes: &mut [u8; 8]) -> Option<()> {
        let value = number(word)?;
        macro_rules! put {
            ($type:ty) => {
                bytes[..size_of::<$type>()].copy_from_slice(&(value as $type).to_le_bytes())
            };
        }
        match self {
            Kind::I1 => put!(i8),
            Kind::I2 => put!(i16),
            Kind::I4 => put!(i32),
            Kind::I8 => put!(i64),
            Kind::U1 => put!(u8),
            Kind::U2 => put!(u16),
            Kind::U4 => put!(u32),
            Kind::U8 => put!(u64),
            Kind::F4 => put!(f32),
            Kind::F8 => put!(f64),
        }
        Some(())
    }
}

impl Header {
    /// Bytes of a point.
    pub fn stride(&self) -> usize {
        self.offset(self.fields.len())
    }

    /// Bytes of the fields before this one.
    pub fn offset(&self, field: usize) -> usize {
        self.fields[..field].iter().map(Field::size).sum()
    }

    /// Believes the number of points only if so many `bytes` can hold them: nothing is allocated
    /// before.
    pub fn check(&self, path: &Path, bytes: u64) -> Result<()> {
        let least = match self.data {
            // A digit and what parts it from the next; the last line may lack its end.
            Data::Ascii => 2 * self.fields.iter().map(|f| f.count).sum::<usize>() as u64,
            Data::Binary => self.stride() as u64,
            Data::Compressed => 0, // its sizes are checked where they are read
        };
        let room = match least {
            0 => u64::MAX,
            _ => (bytes + u64::from(self.data == Data::Ascii)) / least,
        };
        if self.points as u64 > room {
            return Err(Error::input(
                path,
                format!(
                    "the file is cut short: its header promises {} points, and there is room for \
                     at most {room}",
                    self.points
                ),
            ));
        }
        if self.points > u32::MAX as usize {
            return Err(Error::TooLarge(format!(
                "{}: {} points; at most {} are possible",
                path.display(),
                self.points,
                u32::MAX
            )));
        }
        Ok(())
    }
}

/// The words that begin the lines of a header.
const KEYS: [&str; 10] = [
    "VERSION",
    "FIELDS",
    "COLUMNS",
    "SIZE",
    "TYPE",
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
];

/// Whether a text begins as a PCD file does: comments, then a line of its header.
pub fn begins(text: &[u8]) -> bool {
    let mut lines = text.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
    let line = lines.find(|line| !line.is_empty() && !line.starts_with(b"#"));
    let word = line.and_then(|line| line.split(u8::is_ascii_whitespace).next());
    let is_key = |word: &[u8]| {
        KEYS.iter()
            .any(|key| word.eq_ignore_ascii_case(key.as_bytes()))
    };
    text.starts_with(b"# .PCD") || word.is_some_and(is_key)
}

/// Reads a header up to and with its line DATA; fails with what is wrong and where.
pub fn read(input: &mut impl BufRead) -> Parsed<Header> {
    let mut input = input.take(MAX_HEADER);
    let mut lines = 0;
    let mut bytes = 0;
    let mut raw = Raw::default();
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = input
            .read_until(b'\n', &mut line)
            .map_err(|e| format!("reading the header: {e}"))?;
        bytes += read as u64;
        lines += 1;
        if line.last() != Some(&b'\n') {
            return Err(if input.limit() == 0 {
                format!("the header has no line DATA within {MAX_HEADER} bytes")
            } else {
                "the file ends inside the header (no line DATA)".to_owned()
            });
        }
        let about = |what: String| {
            let line: String = String::from_utf8_lossy(&line)
                .trim()
                .chars()
                .take(80)
                .collect();
            format!("header line {lines} ({line:?}): {what}")
        };
        let bare = line.strip_prefix(BOM).unwrap_or(&line);
        let text = String::from_utf8_lossy(bare);
        let text = text.split('#').next().unwrap_or_default();
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let Some((key, values)) = words.split_first() else {
            continue;
        };
        let key = &*key.to_uppercase();
        if key == "DATA" {
            let encoding = values.join(" ").to_lowercase();
            let data = match &*encoding {
                "ascii" => Data::Ascii,
                "binary" => Data::Binary,
                "binary_compressed" => Data::Compressed,
                _ => return Err(about("must be ascii, binary or binary_compressed".into())),
            };
            return raw.header(data, bytes, lines);
        }
        raw.add(key, values).map_err(about)?;
    }
}

/// What came so far.
#[derive(Default)]
struct Raw {
    names: Vec<String>,
    sizes: Vec<String>,
    types: Vec<String>,
    counts: Vec<usize>,
    width: Option<u64>,
    height: Option<u64>,
    points: Option<u64>,
    viewpoint: Option<DVec3>,
}

impl Raw {
    fn add(&mut self, key: &str, values: &[&str]) -> Parsed<()> {
        let owned = || values.iter().map(|&value| value.to_owned()).collect();
        let whole = || match values {
            [value] => match value.parse::<u64>() {
                Ok(number) => Ok(Some(number)),
                Err(_) => Err("must be a whole number from 0 on".to_owned()),
            },
            _ => Err("one number is expected".to_owned()),
        };
        match key {
            "VERSION" => {}
            "FIELDS" | "COLUMNS" => self.names = owned(),
            "SIZE" => self.sizes = owned(),
            "TYPE" => self.types = owned(),
            "COUNT" => {
                let count = |value: &&str| match value.parse::<usize>() {
                    Ok(count) if (1..=MAX_COUNT).contains(&count) => Ok(count),
                    _ => Err(format!("counts are whole numbers from 1 to {MAX_COUNT}")),
                };
                self.counts = values.iter().map(count).collect::<Parsed<_>>()?;
            }
            "WIDTH" => self.width = whole()?,
            "HEIGHT" => self.height = whole()?,
            "POINTS" => self.points = whole()?,
            "VIEWPOINT" => {
                let numbers: Option<Vec<f64>> = values
                    .iter()
                    .map(|value| number(value.as_bytes()))
                    .collect();
                match numbers.as_deref() {
                    Some(numbers @ &[x, y, z, ..]) => {
                        let is_default = numbers == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
                        self.viewpoint = (!is_default).then_some(DVec3::new(x, y, z));
                    }
                    _ => return Err("numbers are expected: a place and a rotation".to_owned()),
                }
            }
            _ => return Err("not understood".to_owned()),
        }
        Ok(())
    }

    fn header(self, data: Data, bytes: u64, lines: u64) -> Parsed<Header> {
        let n = self.names.len();
        let counts = match self.counts.len() {
            0 => vec![1; n],
            _ => self.counts,
        };
        for (key, length) in [
            ("SIZE", self.sizes.len()),
            ("TYPE", self.types.len()),
            ("COUNT", counts.len()),
        ] {
            if length != n {
                return Err(format!("header: {n} FIELDS, but {length} values of {key}"));
            }
        }
        let kinds = self.types.iter().zip(&self.sizes);
        let kinds = kinds.map(|(letter, size)| Kind::of(letter, size));
        let fields = self.names.into_iter().zip(kinds).zip(counts);
        let fields = fields
            .map(|((name, kind), count)| {
                let kind = kind.map_err(|what| format!("header: field {name:?}: {what}"))?;
                Ok(Field { name, kind, count })
            })
            .collect::<Parsed<Vec<_>>>()?;
        let size = [self.width.unwrap_or(0), self.height.unwrap_or(1)];
        let of_size = size[0].checked_mul(size[1]);
        let points = match (self.points, self.width.and(of_size)) {
            (Some(points), Some(product)) if points != product => {
                return Err(format!(
                    "header: {points} POINTS, but WIDTH and HEIGHT make {product}"
                ));
            }
            (Some(points), _) | (None, Some(points)) => points,
            (None, None) => return Err("header: neither POINTS nor WIDTH".to_owned()),
        };
        Ok(Header {
            fields,
            size,
            viewpoint: self.viewpoint,
            points: usize::try_from(points).map_err(|_| format!("header: {points} POINTS"))?,
            data,
            bytes,
            lines,
        })
    }
}
