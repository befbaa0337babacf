//! The lines of a text file, read in blocks and parsed on all threads.

use std::fmt::Display;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use encoding_rs::{Encoding, UTF_16BE, UTF_16LE};
use encoding_rs_io::DecodeReaderBytesBuilder;
use memchr::{memchr_iter, memrchr};
use rayon::prelude::*;

use super::BOM;
use super::fields::Rows;
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Bytes that are read, parsed and handed on at a time; also the longest line.
const BLOCK: usize = 4 << 20;
/// Lines for one thread at a time.
const GRAIN: usize = 512;

/// The lines that are not blank, one after the other.
pub(crate) struct Lines<'a, R> {
    path: PathBuf,
    input: R,
    line_end: u8,
    /// Whether [comments](is_comment) are skipped.
    comments: bool,
    progress: &'a dyn Progress,
    buffer: Vec<u8>,
    /// What of the buffer is filled and not used yet.
    from: usize,
    to: usize,
    at_end: bool,
    /// Number of the next line.
    number: u64,
}

/// Lines that follow one another.
pub(super) struct Block<'a> {
    /// Of the first line.
    number: u64,
    text: &'a [u8],
    /// Those that count.
    pub lines: &'a [&'a [u8]],
}

/// A text file, in UTF-8 whatever it is stored in.
pub(super) type Text = Box<dyn Read + Send + Sync>;

impl<'a> Lines<'a, Text> {
    /// The lines of a file whose lines end with `\n`, or all with `\r`; comments are skipped.
    pub fn open(path: &Path, progress: &'a dyn Progress) -> Result<Self> {
        let (file, bytes) = super::open_sized(path)?;
        let cannot = |e| Error::io(path, "cannot be read", e);
        let mut file = decoded(path, file)?;
        progress.stage("reading", bytes);
        progress.check()?;
        let mut head = Vec::new();
        (&mut file)
            .take(BLOCK as u64)
            .read_to_end(&mut head)
            .map_err(cannot)?;
        progress.advance(head.len() as u64);
        let old = !head.contains(&b'\n') && head.contains(&b'\r');
        let line_end = if old { b'\r' } else { b'\n' };
        Ok(Lines {
            comments: true,
            from: if head.starts_with(BOM) { BOM.len() } else { 0 },
            to: head.len(),
            at_end: head.len() < BLOCK,
            buffer: head,
            ..Lines::new(path, file, line_end, 1, progress)
        })
    }
}

impl<'a, R: Read> Lines<'a, R> {
    /// Lines from the current place of `input`, which is at the start of line `number`.
    pub fn new(
        path: &Path,
        input: R,
        line_end: u8,
        number: u64,
        progress: &'a dyn Progress,
    ) -> Self {
        Lines {
            path: path.to_owned(),
            input,
            line_end,
            comments: false,
            progress,
            buffer: Vec::new(),
            from: 0,
            to: 0,
            at_end: false,
            number,
        }
    }

    /// The number of the line before the next.
    pub fn number(&self) -> u64 {
        self.number.saturating_sub(1)
    }

    /// An error in the line before the next.
    pub fn error(&self, what: impl Display) -> Error {
        Error::input(&self.path, self.located(what))
    }

    /// What is wrong, in the line before the next.
    pub fn located(&self, what: impl Display) -> String {
        format!("line {}: {what}", self.number())
    }

    /// Whole lines that are in memory and not used yet, comments and all; none at the end of the
    /// file.
    pub fn ahead(&mut self) -> Result<&[u8]> {
        let whole = self.whole()?;
        Ok(&self.buffer[self.from..whole])
    }

    /// The next line, without blanks around it.
    pub fn line(&mut self) -> Result<Option<&[u8]>> {
        loop {
            let whole = self.whole()?;
            if self.from == whole {
                return Ok(None);
            }
            let begin = self.from;
            let end = memchr::memchr(self.line_end, &self.buffer[begin..whole])
                .map_or(whole, |length| begin + length + 1);
            self.from = end;
            self.number += 1;
            if self.counts(&self.buffer[begin..end]) {
                return Ok(Some(self.buffer[begin..end].trim_ascii()));
            }
        }
    }

    /// Parses at most `most` lines to rows of `width` values, which go to `take` in blocks.
    /// Returns their number, which is less than `most` at the end of the file alone.
    pub fn rows(
        &mut self,
        most: usize,
        width: usize,
        parse: impl Fn(&[u8], &mut [f64]) -> std::result::Result<(), String> + Sync,
        take: &mut dyn FnMut(Rows),
    ) -> Result<usize> {
        let mut values = Vec::new();
        let (path, line_end) = (self.path.clone(), self.line_end);
        self.blocks(most, &mut |block| {
            let Block {
                number,
                text,
                lines,
            } = *block;
            values.clear();
            values.resize(lines.len() * width, 0.0);
            let wrong = values
                .par_chunks_exact_mut(width)
                .zip(lines)
                .with_min_len(GRAIN)
                .find_map_first(|(row, line)| Some((line, parse(line, row).err()?)));
            if let Some((line, what)) = wrong {
                let before = &text[..line.as_ptr().addr() - text.as_ptr().addr()];
                let line = number + memchr_iter(line_end, before).count() as u64;
                return Err(Error::input(&path, format!("line {line}: {what}")));
            }
            take(&values);
            Ok(())
        })
    }

    /// Hands at most `most` lines to `take`, in blocks. Returns their number, which is less than `most` at the end of the file alone.
    pub fn blocks(
        &mut self,
        most: usize,
        take: &mut dyn FnMut(&Block) -> Result<()>,
    ) -> Result<usize> {
        let mut done = 0;
        while done < most {
            let whole = self.whole()?;
            let block = &self.buffer[self.from..whole];
            if block.is_empty() {
                break;
            }
            let mut used = 0;
            let mut lines = Vec::new();
            let ends = memchr_iter(self.line_end, block).map(|end| end + 1);
            for end in ends.chain((block.last() != Some(&self.line_end)).then_some(block.len())) {
                if lines.len() == most - done {
                    break;
                }
                let line = &block[used..end];
                if self.counts(line) {
                    lines.push(line);
                }
                used = end;
            }
            take(&Block {
                number: self.number,
                text: block,
                lines: &lines,
            })?;
            done += lines.len();
            self.number += memchr_iter(self.line_end, &block[..used]).count() as u64;
            self.from += used;
        }
        Ok(done)
    }

    /// What to say, at the end of a file without any count, if its last line has no end.
    pub fn doubt(&self) -> Option<String> {
        let ends_well = self.to == 0 || self.buffer[self.to - 1] == self.line_end;
        (!ends_well).then(|| {
            "the last line has no end: if the file is cut short, its last values may be wrong"
                .to_owned()
        })
    }

    /// Whether a line is neither blank nor a comment.
    fn counts(&self, line: &[u8]) -> bool {
        let line = line.trim_ascii_start();
        !(line.is_empty() || self.comments && is_comment(line))
    }

    /// Reads on until a whole line is there; returns where the last whole one ends, which is
    /// `from` at the end of the file alone.
    fn whole(&mut self) -> Result<usize> {
        let ahead = &self.buffer[self.from..self.to];
        if let Some(last) = memrchr(self.line_end, ahead) {
            return Ok(self.from + last + 1);
        }
        if self.at_end {
            return Ok(self.to);
        }
        self.progress.check()?;
        self.buffer.copy_within(self.from..self.to, 0);
        (self.from, self.to) = (0, self.to - self.from);
        if self.to == BLOCK {
            return Err(Error::input(
                &self.path,
                format!("line {} is longer than {BLOCK} bytes", self.number),
            ));
        }
        self.buffer.truncate(self.to);
        let room = (BLOCK - self.to) as u64;
        let read = (&mut self.input)
            .take(room)
            .read_to_end(&mut self.buffer)
            .map_err(|e| Error::io(&self.path, "cannot be read", e))?;
        self.progress.advance(read as u64);
        self.to += read;
        self.at_end = (read as u64) < room;
        self.whole()
    }
}

/// The text of a file, whose length in bytes may be another than in the file.
fn decoded(path: &Path, mut file: File) -> Result<Text> {
    let cannot = |e| Error::io(path, "cannot be read", e);
    let mut head = [0; 4];
    let read = file.read(&mut head).map_err(cannot)?;
    file.rewind().map_err(cannot)?;
    Ok(match utf16(&head[..read]) {
        None => Box::new(file),
        encoding => Box::new(
            DecodeReaderBytesBuilder::new()
                .encoding(encoding)
                .build(file),
        ),
    })
}

/// Which kind of UTF-16 a text is in, if it is: by its mark, or by the empty half of its letters.
pub(super) fn utf16(head: &[u8]) -> Option<&'static Encoding> {
    match head {
        [0xff, 0xfe, ..] | [1..=127, 0, 1..=127, 0, ..] => Some(UTF_16LE),
        [0xfe, 0xff, ..] | [0, 1..=127, 0, 1..=127, ..] => Some(UTF_16BE),
        _ => None,
    }
}

/// A number as programs write it; also the signs of Microsoft's runtime for "no number".
pub(crate) fn number(word: &[u8]) -> Option<f64> {
    if let Ok(number) = fast_float2::parse(word) {
        return Some(number);
    }
    let bare = word.strip_prefix(b"-").unwrap_or(word);
    let no_number =
        bare.starts_with(b"1.#") || bare.len() >= 3 && bare[..3].eq_ignore_ascii_case(b"nan");
    no_number.then_some(f64::NAN)
}

/// What to say about a word that should be a number.
pub(crate) fn not_a_number(word: &[u8], name: &str) -> String {
    let word: String = String::from_utf8_lossy(word).chars().take(40).collect();
    format!("{word:?} is no number ({name})")
}

/// Whether a line is a comment in most text formats.
pub(crate) fn is_comment(line: &[u8]) -> bool {
    matches!(line.first(), Some(b'#' | b'%' | b'!')) || line.starts_with(b"//")
}

/// The words of a line that blanks part.
pub(crate) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(u8::is_ascii_whitespace)
        .filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_as_they_are_written() {
        for (word, value) in [
            ("1", 1.0),
            ("+7", 7.0),
            (".25", 0.25),
            ("5.", 5.0),
            ("-1.5e-3", -1.5e-3),
            ("1E5", 1e5),
            ("inf", f64::INFINITY),
            ("0.1", 0.1),
            ("5648349.895035", 5648349.895035),
        ] {
            assert_eq!(number(word.as_bytes()), Some(value), "{word}");
        }
        for word in ["nan", "-nan", "NaN", "-nan(ind)", "1.#QNAN", "-1.#IND"] {
            assert!(number(word.as_bytes()).is_some_and(f64::is_nan), "{word}");
        }
        for word in ["", "-", "1,5", "0x10", "1e", "abc", "1.5f"] {
            assert_eq!(number(word.as_bytes()), None, "{word}");
        }
    }
}
