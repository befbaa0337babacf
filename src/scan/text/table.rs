//! How a table is written, and what its columns are.

use memchr::memchr;

use super::guess::{self, Guess, Sample};
use crate::scan::lines::{is_comment, not_a_number, number};
use crate::scan::names;

type Parsed<T> = Result<T, String>;

/// Lines from which the meaning of columns is guessed, and into how many runs they are parted.
const SAMPLE: usize = 2000;
const RUNS: usize = 16;
/// Most letters of a decimal number.
const LONGEST_NUMBER: usize = 64;

pub struct Table {
    written: Written,
    /// Of the columns; `_` for those that have none.
    pub names: Vec<String>,
    /// A first line that is no comment has the names.
    pub has_header: bool,
    pub is_guessed: bool,
    /// Another meaning that columns without names could have.
    pub other: Option<Vec<String>>,
    /// Of the columns, whether they have no numbers in some lines that were looked at.
    pub words: Vec<bool>,
}

/// How a line is written.
#[derive(Clone, Copy, PartialEq)]
struct Written {
    delimiter: Delimiter,
    /// Whether a comma is what is a point elsewhere.
    decimal_comma: bool,
}

#[derive(Clone, Copy, PartialEq)]
enum Delimiter {
    Blank,
    Byte(u8),
}

impl Delimiter {
    fn of(line: &[u8]) -> Self {
        let has = |byte: u8| line.contains(&byte);
        let by_tabs = || line.split(|&byte| byte == b'\t');
        if has(b';') {
            Delimiter::Byte(b';')
        } else if by_tabs().count() >= 3 && by_tabs().all(|value| !value.trim_ascii().is_empty()) {
            Delimiter::Byte(b'\t')
        } else if has(b',') && !with_decimal_commas(line) {
            Delimiter::Byte(b',')
        } else {
            Delimiter::Blank
        }
    }
}

/// Whether commas are within numbers that blanks part.
fn with_decimal_commas(line: &[u8]) -> bool {
    let words = || {
        line.split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty())
    };
    let is_number = |word: &[u8]| number(word).is_some() || number_with_comma(word).is_some();
    words().count() >= 3 && words().all(is_number)
}

/// A number with a comma, as in `0,25`.
fn number_with_comma(word: &[u8]) -> Option<f64> {
    let place = memchr(b',', word)?;
    let mut letters = [0; LONGEST_NUMBER];
    let letters = letters.get_mut(..word.len())?;
    letters.copy_from_slice(word);
    letters[place] = b'.';
    number(letters).filter(|_| word.len() > 1 && !word.contains(&b'.'))
}

impl Written {
    fn number(&self, value: &[u8]) -> Option<f64> {
        let plain = number(value);
        plain.or_else(|| number_with_comma(value).filter(|_| self.decimal_comma))
    }

    fn values<'a>(&self, line: &'a [u8]) -> Values<'a> {
        Values {
            rest: Some(line),
            delimiter: self.delimiter,
        }
    }

    /// The names in a line, which may be parted in another way than the numbers.
    fn names(&self, line: &[u8], columns: usize) -> Vec<String> {
        let by = |delimiter| {
            let written = Written { delimiter, ..*self };
            let mut names: Vec<String> = written.values(line).map(plain_name).collect();
            while names.len() > columns && names.last().is_some_and(String::is_empty) {
                names.pop();
            }
            names
        };
        let names = by(self.delimiter);
        let others = by(Delimiter::of(line));
        match has_place(&names) || !has_place(&others) {
            true => names,
            false => others,
        }
    }
}

/// The values of a line.
#[derive(Clone)]
struct Values<'a> {
    rest: Option<&'a [u8]>,
    delimiter: Delimiter,
}

impl<'a> Iterator for Values<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = match self.delimiter {
            // Tabs that follow one another have nothing between them.
            Delimiter::Byte(b'\t') => self.rest?.strip_prefix(b" ").unwrap_or(self.rest?),
            _ => self.rest?.trim_ascii_start(),
        };
        // Within quotes nothing is parted.
        let quoted = rest.strip_prefix(b"\"");
        let quoted = quoted.and_then(|inner| Some((inner, memchr(b'"', inner)?)));
        let (value, after) = match (quoted, self.delimiter) {
            (Some((inner, end)), _) => (&inner[..end], &inner[end + 1..]),
            (None, Delimiter::Blank) if rest.is_empty() => return None,
            (None, Delimiter::Blank) => {
                let end = rest.iter().position(u8::is_ascii_whitespace);
                rest.split_at(end.unwrap_or(rest.len()))
            }
            (None, Delimiter::Byte(byte)) => {
                rest.split_at(memchr(byte, rest).unwrap_or(rest.len()))
            }
        };
        self.rest = match self.delimiter {
            Delimiter::Blank => Some(after),
            Delimiter::Byte(byte) => memchr(byte, after).map(|end| &after[end + 1..]),
        };
        Some(value.trim_ascii())
    }
}

impl Table {
    /// What the whole lines at the start of a file tell, and `pieces` from within it. `told` says what the
    /// columns are, if it is not empty.
    pub fn of(text: &[u8], pieces: &[Vec<u8>], told: &[String]) -> Parsed<Self> {
        let mut lines = lines_of(text).peekable();
        let first = *lines.peek().ok_or("the file has no line of points")?;
        let has_header = !is_line_of_numbers(first);
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
        let mut written = Written {
            delimiter: Delimiter::of(first_row),
            decimal_comma: false,
        };
        written.decimal_comma = written.delimiter != Delimiter::Byte(b',')
            && rows.iter().take(SAMPLE).any(|line| {
                let mut values = written.values(line);
                values.any(|value| number_with_comma(value).is_some())
            });
        let values = |line| written.values(line);
        if values(first_row)
            .filter(|value| written.number(value).is_some())
            .count()
            < 3
        {
            return Err(format!(
                "{:?} is no point: it needs at least x, y and z",
                beginning(first_row)
            ));
        }
        let mut columns = values(first_row).count();
        if written.delimiter != Delimiter::Blank && values(first_row).last() == Some(b"") {
            columns -= 1; // every line ends with a delimiter
        }
        let sample = written.sample(columns, &rows, pieces);
        let names = match has_header {
            true => Some(named(&written.names(first, columns), &sample, first)?),
            false => comment_with_names(text, |line| {
                let names = written.names(line, columns);
                (names.len() == columns && has_place(&names)).then_some(names)
            }),
        };
        let mut table = Table {
            written,
            has_header,
            is_guessed: false,
            other: None,
            names: Vec::new(),
            words: (0..columns).map(|column| sample.is_words(column)).collect(),
        };
        match names {
            _ if !told.is_empty() => {
                if told.len() != columns {
                    return Err(format!(
                        "--columns names {}, and the lines have {columns} values",
                        told.len()
                    ));
                }
                table.names = told.to_vec();
            }
            Some(names) => table.names = names,
            None => {
                let Guess { names, other } = guess::names(&sample);
                (table.names, table.other) = (names, other);
                table.is_guessed = true;
            }
        }
        table.words.resize(table.names.len(), true); // names of columns that are not there
        Ok(table)
    }

    /// Places alone.
    fn bare() -> Self {
        Table {
            written: Written {
                delimiter: Delimiter::Blank,
                decimal_comma: false,
            },
            names: ["x", "y", "z"].map(str::to_owned).to_vec(),
            has_header: false,
            is_guessed: true,
            other: None,
            words: vec![false; 3],
        }
    }

    pub fn describe(&self) -> String {
        let delimiter = match self.written.delimiter {
            Delimiter::Blank => "blanks",
            Delimiter::Byte(b';') => "semicolons",
            Delimiter::Byte(b'\t') => "tabs",
            Delimiter::Byte(_) => "commas",
        };
        let comma = match self.written.decimal_comma {
            true => ", decimal commas",
            false => "",
        };
        let names = match (self.is_guessed, self.names.len()) {
            (false, _) => ", named columns",
            (true, 3) => "",
            (true, _) => ", meaning of columns guessed",
        };
        format!("text, parted by {delimiter}{comma}{names}")
    }

    /// What stands in the columns of a line.
    pub fn cells<'a>(&self, line: &'a [u8]) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let line = match self.written.delimiter {
            // A line may begin or end with values that are not there.
            Delimiter::Byte(b'\t') => without_end(line),
            _ => line.trim_ascii(),
        };
        self.written.values(line)
    }

    /// The number that stands in a column.
    pub fn number(&self, cell: &[u8]) -> Option<f64> {
        self.written.number(cell)
    }

    /// Parses one line; the value of column `i` goes to `row[slots[i]]`.
    pub fn parse(&self, line: &[u8], slots: &[Option<usize>], row: &mut [f64]) -> Parsed<()> {
        let mut values = self.cells(line);
        for (i, slot) in slots.iter().enumerate() {
            let value = values
                .next()
                .ok_or_else(|| format!("{i} values; the first line has {}", slots.len()))?;
            if let Some(slot) = *slot {
                row[slot] = match value {
                    b"" => f64::NAN,
                    _ => (self.written.number(value))
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

impl Written {
    /// Runs of lines that follow one another: of `rows` some, and of each piece the first ones.
    fn sample(&self, columns: usize, rows: &[&[u8]], pieces: &[Vec<u8>]) -> Sample {
        let mut sample = Sample::new(columns);
        let mut add = |rows: &mut dyn Iterator<Item = &[u8]>| {
            sample.begin();
            for line in rows {
                let value = |value: &[u8]| {
                    let is_pointed = |byte: &u8| matches!(byte, b'.' | b',' | b'e' | b'E');
                    let pointed = value.iter().any(is_pointed);
                    (self.number(value).unwrap_or(f64::NAN), pointed)
                };
                let values: Vec<_> = self.values(line).take(columns).map(value).collect();
                if values.len() == columns {
                    sample.push(&values);
                }
            }
        };
        let of_run = SAMPLE / RUNS;
        match rows.len() {
            ..=SAMPLE => add(&mut rows.iter().copied()),
            many => (0..RUNS)
                .map(|k| k * (many - of_run) / (RUNS - 1))
                .for_each(|begin| add(&mut rows[begin..begin + of_run].iter().copied())),
        }
        for piece in pieces {
            add(&mut lines_of(piece).take(of_run));
        }
        sample
    }
}

/// A line without what ends it.
fn without_end(line: &[u8]) -> &[u8] {
    let is_end = |byte: &u8| matches!(byte, b'\n' | b'\r');
    let end = line.iter().rposition(|byte| !is_end(byte));
    &line[..end.map_or(0, |last| last + 1)]
}

/// The names of all columns from those in the header, or what is wrong with them.
fn named(names: &[String], sample: &Sample, line: &[u8]) -> Parsed<Vec<String>> {
    let (columns, mut names) = (sample.columns, names.to_vec());
    if !has_place(&names) {
        return Err(format!(
            "the first line, {:?}, does not name x, y and z",
            beginning(line)
        ));
    }
    if columns == 2 * names.len() {
        return Err(format!(
            "{columns} values for {} names: if the commas are decimal ones, part the values by \
             semicolons",
            names.len()
        ));
    }
    // One name too few is that of the rows, which programs of statistics write first.
    if names.len() + 1 == columns && sample.is_row_name(0) {
        names.insert(0, "_".to_owned());
    }
    names.resize(names.len().max(columns), "_".to_owned());
    Ok(names)
}

/// The lines that are neither blank nor comments.
pub fn lines_of(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    all_lines(text).filter(|line| !is_comment(line))
}

fn all_lines(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    let lines = text.split(|&byte| byte == b'\n' || byte == b'\r');
    lines
        .map(<[u8]>::trim_ascii)
        .filter(|line| !line.is_empty())
}

/// Whether a line has any number, however it is written.
fn is_line_of_numbers(line: &[u8]) -> bool {
    let written = Written {
        delimiter: Delimiter::of(line),
        decimal_comma: true,
    };
    written
        .values(line)
        .any(|value| written.number(value).is_some())
}

/// Whether a text begins with a line of three numbers or more and nothing else.
pub fn is_bare(text: &[u8]) -> bool {
    let is_point = |line: &[u8]| {
        let written = Written {
            delimiter: Delimiter::of(line),
            decimal_comma: true,
        };
        let numbers = || written.values(line).map(|value| written.number(value));
        numbers().count() >= 3 && numbers().all(|number| number.is_some())
    };
    lines_of(text).next().is_some_and(is_point)
}

/// The number of points that a line says, alone.
pub fn count(line: &[u8]) -> Option<usize> {
    std::str::from_utf8(line).ok()?.parse().ok()
}

/// What of the last comment before the points that fits.
fn comment_with_names<T>(text: &[u8], fit: impl Fn(&[u8]) -> Option<T>) -> Option<T> {
    let comments = all_lines(text).take_while(|line| is_comment(line));
    let bare = |line: &'_ [u8]| {
        let sign = |byte: &u8| matches!(byte, b'#' | b'/' | b'%' | b'!');
        line.iter()
            .position(|byte| !sign(byte))
            .unwrap_or(line.len())
    };
    comments.filter_map(|line| fit(&line[bare(line)..])).last()
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

/// The beginning of a line, for messages.
fn beginning(line: &[u8]) -> String {
    String::from_utf8_lossy(line).chars().take(80).collect()
}
