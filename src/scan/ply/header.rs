//! The header of a PLY file: its text is read and checked here, its model made by ply-rs.
//!
//! ply-rs alone would wait for ever on an endless line, panic at numbers above 2⁶⁴, lose the first
//! of two properties with the same name, and refuse comments that are not UTF-8 and names with
//! signs like `#`, which CloudCompare writes.

use std::collections::{HashMap, HashSet};
use std::io::{BufRead, Read};

use crate::scan::BOM;
use ply_rs::parser::Parser;
use ply_rs::ply::{DefaultElement, ElementDef, Encoding, KeyMap};

/// Longest header that is read, in bytes.
const MAX_HEADER: u64 = 1 << 20;

pub struct Header {
    pub encoding: Encoding,
    /// In the order of the file, as are the properties of each.
    pub elements: KeyMap<ElementDef>,
    /// Length of the header in bytes, and so where the values begin.
    pub bytes: u64,
    pub lines: u64,
    /// The byte that ends a line: `\n` or, in very old files, `\r`.
    pub line_end: u8,
    /// Names of properties that are whole numbers of 64 bits, in the model doubles, and whether they have a
    /// sign.
    pub wide: HashMap<String, bool>,
}

/// Reads a header up to and with its line `end_header`; fails with what is wrong and where.
pub fn read(input: &mut impl BufRead) -> Result<Header, String> {
    let mut input = input.take(MAX_HEADER);
    let head = input.fill_buf().unwrap_or_default();
    let line_end = match head.strip_prefix(BOM).unwrap_or(head) {
        [b'p', b'l', b'y', b'\r', next, ..] if *next != b'\n' => b'\r',
        _ => b'\n',
    };
    let (mut bytes, mut lines) = (0, 0);
    let mut text = String::new();
    let mut seen = Seen::default();
    let mut line = Vec::new();
    while !text.ends_with("\nend_header\n") {
        line.clear();
        bytes += input
            .read_until(line_end, &mut line)
            .map_err(|e| format!("reading the header: {e}"))? as u64;
        lines += 1;
        if line.last() != Some(&line_end) && line.trim_ascii() != b"end_header" {
            return Err(if input.limit() == 0 {
                format!("the header has no end_header within {MAX_HEADER} bytes")
            } else {
                "the file ends inside the header (no end_header)".to_owned()
            });
        }
        let line = line.trim_ascii();
        let line = match lines {
            1 => line.strip_prefix(BOM).unwrap_or(line),
            _ => line,
        };
        let plain = match (lines, line) {
            (1, b"ply") => Ok("ply".to_owned()),
            (1, _) => Err("a PLY file begins with a line \"ply\""),
            _ => plain_line(line, &mut seen),
        };
        text += &plain.map_err(|what| {
            let line: String = String::from_utf8_lossy(line).chars().take(80).collect();
            format!("header line {lines} ({line:?}): {what}")
        })?;
        text.push('\n');
    }
    let header = Parser::<DefaultElement>::new()
        .read_header(&mut text.as_bytes())
        .map_err(|e| format!("header: {e}"))?;
    Ok(Header {
        encoding: header.encoding,
        elements: header.elements,
        bytes,
        lines,
        line_end,
        wide: seen.wide,
    })
}

/// What came so far.
#[derive(Default)]
struct Seen {
    format: bool,
    elements: HashSet<String>,
    /// Of the last element.
    properties: HashSet<String>,
    wide: HashMap<String, bool>,
}

/// A line as ply-rs reads it, or what is wrong with it.
fn plain_line(line: &[u8], seen: &mut Seen) -> Result<String, &'static str> {
    if line.starts_with(b"comment") || line.starts_with(b"obj_info") {
        return Ok("comment".to_owned()); // these may be in any encoding
    }
    let line = std::str::from_utf8(line).map_err(|_| "not UTF-8")?;
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    let (line, rule) = match words[..] {
        [] => return Ok("comment".to_owned()),
        ["end_header"] => return Ok("end_header".to_owned()),
        ["format", .., version] if version != "1.0" => {
            return Err("only version 1.0 is understood");
        }
        ["format", ..] if std::mem::replace(&mut seen.format, true) => {
            return Err("a second format");
        }
        ["format", encoding, version] => (
            format!("format {encoding} {version}"),
            "must be ascii, binary_little_endian or binary_big_endian",
        ),
        ["element", name, count] => {
            let count: usize = count
                .parse()
                .map_err(|_| "the count must be a whole number from 0 on")?;
            seen.properties.clear();
            let name = plain_name(&name.to_lowercase(), &mut seen.elements)?;
            return Ok(format!("element {name} {count}"));
        }
        ["property", ..] if seen.elements.is_empty() => {
            return Err("a property before any element");
        }
        [
            "property",
            "list",
            "float" | "float32" | "double" | "float64",
            ..,
        ] => {
            return Err("the count of a list must be of an integer type");
        }
        [
            "property",
            kind @ ("int64" | "uint64" | "long" | "ulong"),
            name,
        ] => {
            let name = plain_name(name, &mut seen.properties)?;
            seen.wide.insert(name.clone(), !kind.starts_with('u'));
            // Of the same length.
            return Ok(format!("property double {name}"));
        }
        ["property", ref kind @ .., name] => (
            format!(
                "property {} {}",
                kind.join(" ").to_lowercase(),
                plain_name(name, &mut seen.properties)?
            ),
            "must be \"property TYPE NAME\" or \"property list TYPE TYPE NAME\", with types like \
             uchar, int, float or double",
        ),
        _ => return Err("not understood"),
    };
    match Parser::<DefaultElement>::new().read_header_line(&line) {
        Ok(_) => Ok(line),
        Err(_) => Err(rule),
    }
}

/// A name in the letters that ply-rs takes, the others by number (`a#` is `a_-23-`), so that
/// different names stay different.
fn plain_name(name: &str, taken: &mut HashSet<String>) -> Result<String, &'static str> {
    let plain: String = name
        .chars()
        .enumerate()
        .map(|(i, c)| match c {
            'a'..='z' | 'A'..='Z' | '_' => c.to_string(),
            '0'..='9' if i > 0 => c.to_string(),
            _ => format!("_-{:x}-", u32::from(c)),
        })
        .collect();
    if taken.insert(plain.clone()) {
        Ok(plain)
    } else {
        Err("this name came before")
    }
}

/// The name in the letters of the file, from that in those that ply-rs takes.
pub fn written(plain: &str) -> String {
    let mut name = String::new();
    let mut rest = plain;
    while let Some(begin) = rest.find("_-") {
        let Some((number, after)) = rest[begin + 2..].split_once('-') else {
            break;
        };
        let letter = u32::from_str_radix(number, 16)
            .ok()
            .and_then(char::from_u32);
        name.push_str(&rest[..begin]);
        name.extend(letter);
        rest = after;
    }
    name + rest
}
