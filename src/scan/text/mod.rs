//! Text with a point a line: XYZ, PTS, TXT, CSV.

mod guess;
mod table;

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::colours::Stored;
use super::fields::{Builder, Fields};
use super::lines::Lines;
use super::{ReadOptions, Scan};
use crate::error::{Error, Result};
use crate::progress::Progress;
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
    if table.has_header {
        lines.line()?;
    }
    // Blocks of points with their count, and what follows without.
    while let Some(expected) = count_ahead(lines.ahead()?) {
        lines.line()?;
        let done = lines.rows(expected, width, parse, &mut |rows| builder.append(rows))?;
        if done < expected {
            return Err(Error::input(
                path,
                format!("the file is cut short: it ends after {done} of {expected} points"),
            ));
        }
    }
    let counted = builder.cloud.len();
    let more = lines.rows(usize::MAX, width, parse, &mut |rows| builder.append(rows))?;
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
