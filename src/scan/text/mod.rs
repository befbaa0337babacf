//! Text with a point a line: XYZ, PTS, TXT, CSV.

mod guess;
mod table;

use std::path::Path;

use super::colours::Stored;
use super::fields::{Builder, Fields};
use super::lines::Lines;
use super::{ReadOptions, Scan};
use crate::error::{Error, Result};
use crate::progress::Progress;
use table::{Table, count, lines_of};

/// Reads a table of points.
///
/// Columns are parted by blanks, tabs, commas or semicolons. A first line of names says what they
/// are, also as a comment (`//X Y Z R G B`); otherwise it is [guessed](guess). A number alone in a
/// line before the points is their count, which must come true; PTS files have several such blocks.
/// Lines that begin with `#`, `//`, `%` or `!` are comments.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let mut lines = Lines::open(path, progress)?;
    let table = Table::of(lines.ahead()?).map_err(|what| Error::input(path, what))?;
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

/// The number of points that the next line says, alone.
fn count_ahead(text: &[u8]) -> Option<usize> {
    lines_of(text).next().and_then(count)
}

/// Whether a text begins as a table does.
pub(super) fn begins(text: &[u8]) -> bool {
    Table::of(text).is_ok()
}
