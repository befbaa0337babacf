//! What is checked before the crate `e57` gets to see a file, and while it reads: it parses XML
//! without limits, and gathers values as long as packets come.

use std::cell::Cell;
use std::io::{self, Read, Seek, SeekFrom};
use std::rc::Rc;

use e57::{PointCloud, RecordDataType};

/// Bytes of a page, with its checksum.
const PAGE: u64 = 1024;
/// Longest description of what is in a file. A scan takes some 3 KiB of it.
const LONGEST_XML: usize = 16 << 20;
/// Deepest nesting in it; standard files have 7 levels.
const DEEPEST_XML: usize = 64;
/// Longest tag in it: the time that attributes take grows as their square.
const LONGEST_TAG: usize = 4096;
/// Most fields that a point may have; the standard knows 21, the extension for normals 3 more.
const MOST_FIELDS: usize = 64;
/// Most bytes that are read without a point coming out: a packet has 64 KiB.
const MOST_BYTES_A_POINT: i64 = 4 << 20;

/// Fails where the XML would take long to parse.
pub fn check_xml(xml: &[u8]) -> Result<(), String> {
    let mut depth = 0usize;
    let mut rest = xml;
    while let Some(begin) = rest.iter().position(|&byte| byte == b'<') {
        rest = &rest[begin..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")]
            .into_iter()
            .find(|(begin, _)| rest.starts_with(begin.as_bytes()));
        let tag = match skipped {
            Some((begin, end)) => {
                let text = &rest[begin.len()..];
                let end = end.as_bytes();
                let length = text.windows(end.len()).position(|bytes| bytes == end);
                begin.len() + length.unwrap_or(text.len())
            }
            None => tag_length(rest),
        };
        if skipped.is_none() {
            if tag > LONGEST_TAG {
                return Err(format!("its description has a tag of {tag} bytes"));
            }
            if rest.starts_with(b"</") {
                depth = depth.saturating_sub(1);
            } else if !rest[..tag].ends_with(b"/") {
                depth += 1;
            }
            if depth > DEEPEST_XML {
                return Err(format!(
                    "its description is nested more than {DEEPEST_XML} levels deep"
                ));
            }
        }
        rest = &rest[tag..];
    }
    Ok(())
}

/// Bytes of a tag up to its `>`, which may also stand in quotes.
fn tag_length(bytes: &[u8]) -> usize {
    let mut quote = None;
    let end = bytes.iter().position(|&byte| {
        match (quote, byte) {
            (None, b'>') => return true,
            (None, b'"' | b'\'') => quote = Some(byte),
            (Some(open), _) if open == byte => quote = None,
            _ => {}
        }
        false
    });
    end.unwrap_or(bytes.len())
}

/// Fails where the header of the file leads to no description of a length that can be.
pub fn check_header(input: &mut (impl Read + Seek), bytes: u64) -> Result<(), String> {
    let mut header = [0; 48];
    let read = input
        .seek(SeekFrom::Start(0))
        .and_then(|_| input.read_exact(&mut header));
    read.map_err(|_| "the file is cut short: it ends inside the header")?;
    if !bytes.is_multiple_of(PAGE) {
        return Err(format!(
            "the file is cut short: its {bytes} bytes are no whole pages of {PAGE}"
        ));
    }
    let number = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| header[at + i]));
    let (offset, length) = (number(24), number(32));
    if offset.saturating_add(length) > bytes {
        return Err(format!(
            "the file is cut short: its header promises a description of {length} bytes at \
             {offset}, but it has {bytes}"
        ));
    }
    if length > LONGEST_XML as u64 {
        return Err(format!("its description has {length} bytes"));
    }
    Ok(())
}

/// Fails where a file of `bytes` bytes cannot hold the points that its scans promise.
pub fn check_counts(scans: &[PointCloud], bytes: u64) -> Result<(), String> {
    let mut room = 8 * u128::from(bytes);
    for (k, scan) in scans.iter().enumerate() {
        let error = |what: String| Err(format!("scan {}: {what}", k + 1));
        let fields = &scan.prototype;
        if fields.len() > MOST_FIELDS {
            return error(format!("{} fields a point", fields.len()));
        }
        let bits = fields.iter().map(|f| bits(&f.data_type)).sum::<u32>();
        if bits == 0 && scan.records > 0 {
            return error(format!("its {} points are made of constants", scan.records));
        }
        let needed = u128::from(bits) * u128::from(scan.records);
        if needed > room {
            return error(format!(
                "the file is cut short: {} points are promised, and there is room for at most {}",
                scan.records,
                room / u128::from(bits)
            ));
        }
        room -= needed;
    }
    Ok(())
}

/// Bits of a value in the file.
fn bits(kind: &RecordDataType) -> u32 {
    match *kind {
        RecordDataType::Single { .. } => 32,
        RecordDataType::Double { .. } => 64,
        RecordDataType::ScaledInteger { min, max, .. } | RecordDataType::Integer { min, max } => {
            u64::BITS - max.wrapping_sub(min).cast_unsigned().leading_zeros()
        }
    }
}

/// A reader that fails when too much is read and nothing comes of it, and for which seeking to
/// where it is costs nothing.
pub struct Watched<R> {
    input: R,
    at: u64,
    /// Bytes since the last point.
    since: Rc<Cell<i64>>,
}

impl<R: Read + Seek> Watched<R> {
    pub fn new(mut input: R) -> io::Result<(Self, Rc<Cell<i64>>)> {
        // First comes the description.
        let since = Rc::new(Cell::new(-(LONGEST_XML as i64)));
        let watched = Watched {
            at: input.stream_position()?,
            input,
            since: since.clone(),
        };
        Ok((watched, since))
    }
}

impl<R: Read> Read for Watched<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.input.read(buffer)?;
        self.at += count as u64;
        self.since.set(self.since.get() + count as i64);
        if self.since.get() > MOST_BYTES_A_POINT {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                format!("{MOST_BYTES_A_POINT} bytes without a point"),
            ));
        }
        Ok(count)
    }
}

impl<R: Seek> Seek for Watched<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        if to != SeekFrom::Start(self.at) {
            self.at = self.input.seek(to)?;
        }
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn xml_that_takes_long_is_refused() {
        let good = "<?xml version='1.0'?><!-- <<< --><a b=\"<'>/\"><c/><![CDATA[<d><d>]]></a>";
        for (xml, expected) in [
            (good.to_owned(), None),
            (
                format!("{}{}", "<a>".repeat(65), "</a>".repeat(65)),
                Some("nested"),
            ),
            ("<a></a>".repeat(100), None),
            ("<a/>".repeat(100), None),
            (
                format!("<a {}/>", "b='' ".repeat(1000)),
                Some("a tag of 5004 bytes"),
            ),
            ("<a b=\"".to_owned(), None),
            ("<![CDATA[".to_owned(), None),
        ] {
            let result = check_xml(xml.as_bytes());
            let message = result.err().unwrap_or_default();
            assert!(message.contains(expected.unwrap_or("")), "{xml}: {message}");
            assert_eq!(message.is_empty(), expected.is_none(), "{xml}: {message}");
        }
    }
}
