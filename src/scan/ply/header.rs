//! The header of a PLY file.
//!
//! Read here rather than by a library, because real headers have comments in any encoding, names
//! with signs like `#` (CloudCompare writes them) and properties that come twice.

use std::io::{BufRead, Read};

use super::scalar::Scalar;

/// Longest header that is read, in bytes.
const MAX_HEADER: u64 = 1 << 20;

/// How the values after the header are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// What one property of an element holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Scalar(Scalar),
    /// A count, then as many values.
    List {
        count: Scalar,
        value: Scalar,
    },
}

#[derive(Clone, Debug)]
pub struct Property {
    pub name: String,
    pub kind: Kind,
}

#[derive(Clone, Debug)]
pub struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of one entry of a binary file; `None` if lists make it vary.
    pub fn stride(&self) -> Option<usize> {
        self.properties
            .iter()
            .map(|property| match property.kind {
                Kind::Scalar(scalar) => Some(scalar.size()),
                Kind::List { .. } => None,
            })
            .sum()
    }

    /// The least number of bytes that all entries can take.
    pub fn least_bytes(&self, encoding: Encoding) -> u128 {
        let least = |property: &Property| match (encoding, property.kind) {
            // A digit and what parts it from the next.
            (Encoding::Ascii, _) => 2,
            (_, Kind::Scalar(scalar) | Kind::List { count: scalar, .. }) => scalar.size(),
        };
        self.count as u128 * self.properties.iter().map(least).sum::<usize>() as u128
    }
}

#[derive(Clone, Debug)]
pub struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Length of the header in bytes, and so where the values begin.
    pub bytes: u64,
    pub lines: u64,
    /// The byte that ends a line: `\n` or, in very old files, `\r`.
    pub line_end: u8,
}

/// Reads a header up to and with its line `end_header`; fails with what is wrong and where.
pub fn read(input: &mut impl BufRead) -> Result<Header, String> {
    let mut input = input.take(MAX_HEADER);
    let (line_end, mut bytes) = read_magic(&mut input)?;
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut lines = 1;
    let mut line = Vec::new();
    loop {
        line.clear();
        let n = input
            .read_until(line_end, &mut line)
            .map_err(|e| format!("reading the header: {e}"))?;
        bytes += n as u64;
        lines += 1;
        if line.last() != Some(&line_end) && line.trim_ascii() != b"end_header" {
            return Err(if input.limit() == 0 {
                format!("the header has no end_header within {MAX_HEADER} bytes")
            } else {
                "the file ends inside the header (no end_header)".to_owned()
            });
        }
        let line = line.trim_ascii();
        if line.starts_with(b"comment") || line.starts_with(b"obj_info") {
            continue; // these may be in any encoding
        }
        let wrong = |what: &str| {
            let line: String = String::from_utf8_lossy(line).chars().take(80).collect();
            format!("header line {lines} ({line:?}): {what}")
        };
        let words = std::str::from_utf8(line).map_err(|_| wrong("not UTF-8"))?;
        let words: Vec<&str> = words.split_ascii_whitespace().collect();
        match words[..] {
            ["end_header"] => break,
            ["format", name, version] => {
                if version != "1.0" {
                    return Err(wrong("only version 1.0 is understood"));
                }
                let new = parse_encoding(name).ok_or_else(|| {
                    wrong("must be ascii, binary_little_endian or binary_big_endian")
                })?;
                if encoding.replace(new).is_some_and(|old| old != new) {
                    return Err(wrong("a second, different format"));
                }
            }
            ["element", name, count] => {
                let count = count
                    .parse()
                    .map_err(|_| wrong("the count must be a whole number from 0 on"))?;
                if elements.iter().any(|element| element.name == name) {
                    return Err(wrong("an element of this name came before"));
                }
                elements.push(Element {
                    name: name.to_owned(),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", ref kind @ .., name] => {
                let kind = parse_kind(kind).map_err(|what| wrong(&what))?;
                let element = elements
                    .last_mut()
                    .ok_or_else(|| wrong("a property before any element"))?;
                element.properties.push(Property {
                    name: name.to_owned(),
                    kind,
                });
            }
            _ => return Err(wrong("not understood")),
        }
    }
    Ok(Header {
        encoding: encoding.ok_or("the header has no format line")?,
        elements,
        bytes,
        lines,
        line_end,
    })
}

/// Reads the first line, "ply"; returns the byte that ends the file's lines, and the bytes read.
fn read_magic(input: &mut impl BufRead) -> Result<(u8, u64), String> {
    let wrong = || "not a PLY file (it does not begin with a line \"ply\")".to_owned();
    let mut magic = [0; 4];
    input.read_exact(&mut magic).map_err(|_| wrong())?;
    if &magic == b"ply\r" && !matches!(input.fill_buf(), Ok([b'\n', ..])) {
        return Ok((b'\r', 4));
    }
    let mut rest = vec![magic[3]];
    if magic[3] != b'\n' {
        input
            .read_until(b'\n', &mut rest)
            .map_err(|e| format!("reading the header: {e}"))?;
    }
    if !magic.starts_with(b"ply") || !rest.trim_ascii().is_empty() {
        return Err(wrong());
    }
    Ok((b'\n', 3 + rest.len() as u64))
}

fn parse_encoding(name: &str) -> Option<Encoding> {
    match name {
        "ascii" => Some(Encoding::Ascii),
        "binary_little_endian" => Some(Encoding::LittleEndian),
        "binary_big_endian" => Some(Encoding::BigEndian),
        _ => None,
    }
}

fn parse_kind(words: &[&str]) -> Result<Kind, String> {
    let scalar = |name: &str| Scalar::parse(name).ok_or_else(|| format!("unknown type {name:?}"));
    match *words {
        [value] => Ok(Kind::Scalar(scalar(value)?)),
        ["list", count, value] => {
            let (count, value) = (scalar(count)?, scalar(value)?);
            if count.is_float() {
                return Err("the count of a list must be of an integer type".to_owned());
            }
            Ok(Kind::List { count, value })
        }
        _ => Err("must be \"property TYPE NAME\" or \"property list TYPE TYPE NAME\"".to_owned()),
    }
}
