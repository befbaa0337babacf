//! How a table is written, and what its columns are.

use memchr::memchr;

use super::guess::{self, Sample};
use crate::scan::lines::{not_a_number, number};
use crate::scan::names;

type Parsed<T> = Result<T, String>;

/// Lines from which the meaning of columns is guessed.
const SAMPLE: usize = 2000;

pub struct Table {
    delimiter: Delimiter,
    /// Of the columns, as PLY files have them where they mean the same.
    pub names: Vec<String>,
    /// A first line that is no comment has the names.
    pub has_header: bool,
    pub is_guessed: bool,
}

#[derive(Clone, Copy, PartialEq)]
enum Delimiter {
    Blank,
    Byte(u8),
}

impl Delimiter {
    fn of(line: &[u8]) -> Self {
        let found = [b';', b','].into_iter().find(|byte| line.contains(byte));
        found.map_or(Delimiter::Blank, Delimiter::Byte)
    }
}

/// The values of a line.
#[derive(Clone)]
struct Values<'a> {
    rest: Option<&'a [u8]>,
    delimiter: Delimiter,
}

impl<'a> Values<'a> {
    fn of(line: &'a [u8], delimiter: Delimiter) -> Self {
        Values {
            rest: Some(line),
            delimiter,
        }
    }
}

impl<'a> Iterator for Values<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest?.trim_ascii_start();
        match self.delimiter {
            Delimiter::Blank if rest.is_empty() => None,
            Delimiter::Blank => {
                let end = rest.iter().position(u8::is_ascii_whitespace);
                let (value, rest) = rest.split_at(end.unwrap_or(rest.len()));
                self.rest = Some(rest);
                Some(value)
            }
            Delimiter::Byte(byte) => {
                // Within quotes it parts nothing.
                let quoted = rest.strip_prefix(b"\"");
                let quoted = quoted.and_then(|inner| Some((inner, memchr(b'"', inner)?)));
                let (value, after) = match quoted {
                    Some((inner, end)) => (&inner[..end], &inner[end + 1..]),
                    None => {
                        let end = memchr(byte, rest).unwrap_or(rest.len());
                        rest.split_at(end)
                    }
                };
                self.rest = memchr(byte, after).map(|end| &after[end + 1..]);
                Some(value.trim_ascii())
            }
        }
    }
}

impl Table {
    /// What the whole lines at the start of a file tell.
    pub fn of(text: &[u8]) -> Parsed<Self> {
        let mut lines = lines_of(text).peekable();
        let first = *lines.peek().ok_or("the file has no line of points")?;
        let numbers = |line: &[u8]| {
            let values = Values::of(line, Delimiter::of(line));
            values.filter(|&value| number(value).is_some()).count()
        };
        let has_header = numbers(first) == 0;
        if has_header {
            lines.next();
        }
        let is_count = |line: &&[u8]| count(line).is_some();
        let rows: Vec<&[u8]> = lines.filter(|line| !is_count(line)).collect();
        let Some(&first_row) = rows.first() else {
            if has_header {
                return Err("the file has no line of points".to_owned());
            }
            return Ok(Table::bare()); // a count alone
        };
        if numbers(first_row) < 3 {
            let line: String = String::from_utf8_lossy(first_row)
                .chars()
                .take(80)
                .collect();
            return Err(format!(
                "{line:?} is no point: it needs at least x, y and z"
            ));
        }
        let delimiter = Delimiter::of(first_row);
        let values = |line| Values::of(line, delimiter);
        let mut columns = values(first_row).count();
        if delimiter != Delimiter::Blank && values(first_row).last() == Some(b"") {
            columns -= 1; // every line ends with a delimiter
        }
        let every = rows.len().div_ceil(SAMPLE);
        let sample = rows.iter().step_by(every).map(|line| {
            let values = values(line).map(|value| number(value).unwrap_or(f64::NAN));
            values.take(columns).collect::<Vec<f64>>()
        });
        let sample = Sample::new(columns, sample.filter(|row| row.len() == columns));

        let mut header = has_header.then_some(first);
        if header.is_none() {
            header = comment_with_names(text, |line| {
                let names: Vec<String> = Values::of(line, delimiter).map(plain_name).collect();
                names.len() == columns && has_place(&names)
            });
        }
        let is_guessed = header.is_none();
        let names = match header {
            Some(line) => {
                let mut names: Vec<String> = Values::of(line, delimiter).map(plain_name).collect();
                if !has_place(&names) {
                    let line: String = String::from_utf8_lossy(line).chars().take(80).collect();
                    return Err(format!(
                        "the first line, {line:?}, does not name x, y and z"
                    ));
                }
                names.resize(names.len().max(columns), String::new());
                names
            }
            None => guess::names(&sample),
        };
        Ok(Table {
            delimiter,
            names,
            has_header,
            is_guessed,
        })
    }

    /// Places alone.
    fn bare() -> Self {
        Table {
            delimiter: Delimiter::Blank,
            names: ["x", "y", "z"].map(str::to_owned).to_vec(),
            has_header: false,
            is_guessed: true,
        }
    }

    pub fn describe(&self) -> String {
        let delimiter = match self.delimiter {
            Delimiter::Blank => "blanks",
            Delimiter::Byte(b';') => "semicolons",
            Delimiter::Byte(_) => "commas",
        };
        let names = match (self.is_guessed, self.names.len()) {
            (false, _) => ", named columns",
            (true, 3) => "",
            (true, _) => ", meaning of columns guessed",
        };
        format!("text, parted by {delimiter}{names}")
    }

    /// Parses one line; the value of column `i` goes to `row[slots[i]]`.
    pub fn parse(&self, line: &[u8], slots: &[Option<usize>], row: &mut [f64]) -> Parsed<()> {
        let mut values = Values::of(line.trim_ascii(), self.delimiter);
        for (i, slot) in slots.iter().enumerate() {
            let value = values
                .next()
                .ok_or_else(|| format!("{i} values; the first line has {}", slots.len()))?;
            if let Some(slot) = *slot {
                row[slot] = match value {
                    b"" => f64::NAN,
                    _ => number(value)
                        .ok_or_else(|| not_a_number(value, &format!("column {}", i + 1)))?,
                };
            }
        }
        match values.find(|value| !value.is_empty()) {
            None => Ok(()),
            Some(_) => Err(format!(
                "more values than the {} of the first line",
                slots.len()
            )),
        }
    }
}

/// The lines that are neither blank nor comments.
pub fn lines_of(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    all_lines(text).filter(|line| !crate::scan::lines::is_comment(line))
}

fn all_lines(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    let lines = text.split(|&byte| byte == b'\n' || byte == b'\r');
    lines
        .map(<[u8]>::trim_ascii)
        .filter(|line| !line.is_empty())
}

/// The number of points that a line says, alone.
pub fn count(line: &[u8]) -> Option<usize> {
    std::str::from_utf8(line).ok()?.parse().ok()
}

/// The last comment before the points that has their columns' names.
fn comment_with_names(text: &[u8], fits: impl Fn(&[u8]) -> bool) -> Option<&[u8]> {
    let comments = all_lines(text).take_while(|line| crate::scan::lines::is_comment(line));
    let bare = |line: &'_ [u8]| {
        let sign = |byte: &u8| matches!(byte, b'#' | b'/' | b'%' | b'!');
        line.iter()
            .position(|byte| !sign(byte))
            .unwrap_or(line.len())
    };
    comments
        .map(|line| &line[bare(line)..])
        .filter(|line| fits(line))
        .last()
}

fn has_place(names: &[String]) -> bool {
    let is_known = |axis| names::find(names, axis).is_some();
    ["x", "y", "z"].into_iter().all(is_known)
}

/// The name of a column, without quotes around it.
fn plain_name(name: &[u8]) -> String {
    let name = String::from_utf8_lossy(name);
    name.trim_matches(|c: char| c == '"' || c == '\'' || c.is_whitespace())
        .to_owned()
}
