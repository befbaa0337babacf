//! Text with a point a line: XYZ, PTS, TXT, CSV.

mod guess;
mod table;

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::colours::Stored;
use super::fields::{Builder, Fields};
use super::lines::{Lines, Text};
use super::{ReadOptions, Scan};
use crate::error::{Error, Result};
use crate::progress::{Progress, Silent};
use table::{Table, count, lines_of};

/// Places within a long file that are looked at, and bytes of each.
const PIECES: u64 = 15;
const PIECE: u64 = 1 << 16;

/// Reads a table of points.
///
/// Columns are parted by blanks, tabs, commas or semicolons; with the others a comma may stand for the
/// decimal point. A first line of names says what they are, also as a comment (`//X Y Z R G B`), one name less
/// if the first column has the names of rows; otherwise it is [guessed](guess). A number alone in a
/// line before the points is their count, which must come true; PTS files have several such blocks.
/// Lines that begin with `#`, `//`, `%` or `!` are comments.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let mut lines = Lines::open(path, progress)?;
    let table = Table::of(lines.ahead()?, &pieces(path)?, &options.columns);
    let table = table.map_err(|what| Error::input(path, what))?;
    let mut repairs = Vec::new();
    let fields = Fields::find(&table.names, |_| Stored::Words, &mut repairs);
    let fields = fields.ok_or_else(|| {
        let names = table.names.join(" ");
        Error::input(path, format!("the columns \"{names}\" lack x, y or z"))
    })?;
    let slots: Vec<Option<usize>> = (0..table.names.len())
        .map(|i| fields.columns.iter().position(|&column| column == i))
        .collect();
    let width = fields.columns.len();
    let mut builder = Builder::new(fields, 0);
    let parse = |line: &[u8], row: &mut [f64]| table.parse(line, &slots, row);
    let more = points(path, &mut lines, &table, &mut |lines, most| {
        lines.rows(most, width, parse, &mut |rows| builder.append(rows))
    })?;
    let counted = builder.cloud.len() - more;
    if builder.cloud.is_empty() {
        return Err(Error::input(path, "empty cloud: the file has no points"));
    }
    if counted > 0 && more > 0 {
        repairs.push(format!(
            "{more} points beyond the count of the file taken too"
        ));
    }
    repairs.extend(lines.doubt().filter(|_| more > 0));
    let (cloud, mut taken) = builder.finish(options.colours, repairs);
    if let Some(other) = &table.other {
        progress.note(&format!(
            "warning: {}: columns without names taken as {}; they could be {} as well: --columns says \
             what they are",
            path.display(),
            table.names.join(" "),
            other.join(" ")
        ));
    }
    if table.is_guessed && table.names.len() > 3 {
        taken = format!(
            "columns without names taken as {}; {taken}",
            table.names.join(" ")
        );
    }
    Ok(Scan {
        format: table.describe(),
        taken,
        sampled: false,
        cloud,
        fields: table.names,
    })
}

/// Goes through a file with `each`, which takes at most so many points from the lines and returns their
/// number: first the blocks of points with their count, then what follows without. Returns the number of the
/// latter.
fn points<'a>(
    path: &Path,
    lines: &mut Lines<'a, Text>,
    table: &Table,
    each: &mut dyn FnMut(&mut Lines<'a, Text>, usize) -> Result<usize>,
) -> Result<usize> {
    if table.has_header {
        lines.line()?;
    }
    while let Some(expected) = count_ahead(lines.ahead()?) {
        lines.line()?;
        let done = each(lines, expected)?;
        if done < expected {
            return Err(Error::input(
                path,
                format!("the file is cut short: it ends after {done} of {expected} points"),
            ));
        }
    }
    each(lines, usize::MAX)
}

/// A text whose points are read once more, as they are written.
pub(crate) struct TextFile {
    path: PathBuf,
    table: Table,
}

impl TextFile {
    /// Of a file whose columns were found to be `names`; fails as [`read`] does.
    pub fn open(path: &Path, names: &[String]) -> Result<Self> {
        let mut lines = Lines::open(path, &Silent)?;
        let table = Table::of(lines.ahead()?, &pieces(path)?, names);
        let table = table.map_err(|what| Error::input(path, what))?;
        Ok(TextFile {
            path: path.to_owned(),
            table,
        })
    }

    pub fn names(&self) -> &[String] {
        &self.table.names
    }

    /// Whether a column has numbers, as far as some lines tell.
    pub fn is_number(&self, column: usize) -> bool {
        !self.table.words[column]
    }

    /// What stands in the columns of a line; nothing where values are missing.
    pub fn cells<'a>(&self, line: &'a [u8]) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let cells = self.table.cells(line).chain(std::iter::repeat(&b""[..]));
        cells.take(self.table.names.len())
    }

    /// The numbers of a line, of which column `i` goes to `row[slots[i]]`; no number where there is none.
    pub fn numbers(&self, line: &[u8], slots: &[Option<usize>], row: &mut [f64]) {
        for (cell, slot) in self.cells(line).zip(slots) {
            if let Some(slot) = *slot {
                row[slot] = self.table.number(cell).unwrap_or(f64::NAN);
            }
        }
    }

    /// Hands the lines of all points to `take`, block by block.
    pub fn read(&self, take: &mut dyn FnMut(&[&[u8]]) -> Result<()>) -> Result<()> {
        let mut lines = Lines::open(&self.path, &Silent)?;
        points(&self.path, &mut lines, &self.table, &mut |lines, most| {
            lines.blocks(most, &mut |block| take(block.lines))
        })?;
        Ok(())
    }
}

/// Some lines from within a long file: what stands at its beginning need not be like the rest.
fn pieces(path: &Path) -> Result<Vec<Vec<u8>>> {
    let cannot = |e| Error::io(path, "cannot be read", e);
    let (mut file, bytes) = super::open_sized(path)?;
    let mut pieces = Vec::new();
    for k in 1..=PIECES {
        let begin = k * (bytes / (PIECES + 1));
        if begin < PIECE {
            continue; // short files are looked at as a whole
        }
        let mut piece = Vec::new();
        file.seek(SeekFrom::Start(begin)).map_err(cannot)?;
        let mut part = (&mut file).take(PIECE);
        part.read_to_end(&mut piece).map_err(cannot)?;
        // The first line and the last may be cut.
        let is_end = |byte: &u8| matches!(byte, b'\n' | b'\r');
        let ends = (
            piece.iter().position(is_end),
            piece.iter().rposition(is_end),
        );
        if let (Some(first), Some(last)) = ends {
            pieces.push(piece[first..last.max(first)].to_vec());
        }
    }
    Ok(pieces)
}

/// The number of points that the next line says, alone.
fn count_ahead(text: &[u8]) -> Option<usize> {
    lines_of(text).next().and_then(count)
}

pub(super) use table::is_bare;

/// Whether a text begins as a table does.
pub(super) fn begins(text: &[u8]) -> bool {
    Table::of(text, &[], &[]).is_ok()
}
