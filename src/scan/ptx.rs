//! PTX files: grids of a scanner, each with its pose.

use std::path::Path;

use glam::{DMat4, DVec3, DVec4};

use super::colours::Stored;
use super::fields::{Builder, Fields, Rows};
use super::lines::{Lines, Text, not_a_number, number, words};
use super::{ReadOptions, Scan, scanner};
use crate::error::{Error, Result};
use crate::progress::Progress;

type Parsed<T> = std::result::Result<T, String>;

/// Values of a point: place, intensity and colour.
const WIDTH: usize = 7;
const NAMES: [&str; WIDTH] = ["x", "y", "z", "intensity", "red", "green", "blue"];

/// Reads a PTX file.
///
/// Each grid has a header of ten lines: columns, rows, place and axes of the scanner, and a matrix
/// that turns its points, as rows, to the common coordinates. The scanner stands at the origin of
/// its own ones. Points `0 0 0` are directions without a return, and no points.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let mut lines = Lines::open(path, progress)?;
    let mut repairs = Vec::new();
    let fields = Fields::find(&NAMES, |_| Stored::Words, &mut repairs);
    let fields = fields.ok_or_else(|| Error::input(path, "no coordinates"))?;
    let columns = fields.columns.clone();
    let mut builder = Builder::new(fields, 0);
    let (mut grids, mut without_return, mut coloured) = (0, 0, false);
    let mut scanners = Vec::new();
    while let Some(grid) = Grid::read(&mut lines)? {
        grids += 1;
        let begin = builder.cloud.len();
        let parse = |line: &[u8], row: &mut [f64]| parse(line, &columns, row);
        let done = lines.rows(grid.points, columns.len(), parse, &mut |rows: Rows| {
            let returns = rows.chunks_exact(columns.len());
            let returns = returns.filter(|row| row[..3] != [0.0; 3]);
            let returns: Vec<f64> = returns.flatten().copied().collect();
            without_return += (rows.len() - returns.len()) / columns.len();
            coloured |= returns
                .iter()
                .skip(3)
                .step_by(columns.len())
                .any(|r| !r.is_nan());
            builder.append(&returns);
        })?;
        if done < grid.points {
            return Err(Error::input(
                path,
                format!(
                    "the file is cut short: it ends after {done} of the {} points of grid {grids}",
                    grid.points
                ),
            ));
        }
        let points = begin..builder.cloud.len();
        for p in &mut builder.cloud.positions[points.clone()] {
            *p = grid.pose.transform_point3(*p);
        }
        let place = grid.pose.transform_point3(DVec3::ZERO);
        scanners.extend(scanner(&builder.cloud, points, place));
    }
    if builder.cloud.is_empty() {
        return Err(Error::input(path, "empty cloud: the grids have no points"));
    }
    if !coloured {
        builder.cloud.reflectance.clear();
    }
    if without_return > 0 {
        repairs.push(format!(
            "{without_return} directions without a return left out"
        ));
    }
    let (mut cloud, taken) = builder.finish(options.colours, repairs);
    cloud.scanners = scanners;
    let names = if coloured { &NAMES[..] } else { &NAMES[..4] };
    Ok(Scan {
        format: format!("PTX, grids: {grids}"),
        fields: names.iter().map(|&name| name.to_owned()).collect(),
        taken,
        sampled: false,
        cloud,
    })
}

/// The header of a grid.
struct Grid {
    points: usize,
    pose: DMat4,
}

impl Grid {
    /// The next one, `None` at the end of the file.
    fn read(lines: &mut Lines<Text>) -> Result<Option<Grid>> {
        let Some(columns) = lines.line()?.map(count) else {
            return Ok(None);
        };
        let columns = columns.map_err(|what| lines.error(what))?;
        let rows = row(lines, count)?;
        let points = columns
            .checked_mul(rows)
            .filter(|&points| points <= u64::from(u32::MAX))
            .ok_or_else(|| lines.error(format!("a grid of {columns} by {rows} is too large")))?;
        for _ in 0..4 {
            row(lines, numbers::<3>)?; // place and axes: the matrix has them too
        }
        let mut matrix = [DVec4::ZERO; 4];
        for line in &mut matrix {
            *line = DVec4::from(row(lines, numbers::<4>)?);
        }
        let [x, y, z, w] = matrix;
        Ok(Some(Grid {
            points: points as usize,
            pose: DMat4::from_cols(x, y, z, w),
        }))
    }
}

/// The next line of a header, parsed.
fn row<T>(lines: &mut Lines<Text>, parse: impl Fn(&[u8]) -> Parsed<T>) -> Result<T> {
    let parsed = match lines.line()? {
        Some(line) => parse(line),
        None => Err("the file is cut short: it ends in the header of a grid".to_owned()),
    };
    parsed.map_err(|what| lines.error(what))
}

fn count(line: &[u8]) -> Parsed<u64> {
    let text = std::str::from_utf8(line).ok();
    text.and_then(|text| text.parse().ok())
        .ok_or_else(|| not_a_number(line, "columns or rows of a grid"))
}

fn numbers<const N: usize>(line: &[u8]) -> Parsed<[f64; N]> {
    let mut numbers = [0.0; N];
    let mut words = words(line);
    for value in &mut numbers {
        let word = words.next().unwrap_or_default();
        *value = number(word)
            .filter(|x| x.is_finite())
            .ok_or_else(|| not_a_number(word, "header of a grid"))?;
    }
    match words.next() {
        None => Ok(numbers),
        Some(_) => Err(format!("{N} numbers are expected in this line of a header")),
    }
}

/// Parses a point; a colour that is not there becomes no number.
fn parse(line: &[u8], columns: &[usize], row: &mut [f64]) -> Parsed<()> {
    let mut values = [f64::NAN; WIDTH];
    let mut words = words(line);
    let mut count = 0;
    for (value, word) in values.iter_mut().zip(&mut words) {
        *value = number(word).ok_or_else(|| not_a_number(word, NAMES[count]))?;
        count += 1;
    }
    if !matches!(count, 3 | 4 | WIDTH) || words.next().is_some() {
        return Err("a point has 3, 4 or 7 values: x y z intensity red green blue".to_owned());
    }
    for (value, &column) in row.iter_mut().zip(columns) {
        *value = values[column];
    }
    Ok(())
}

/// Whether a text begins as a grid does: two counts, four lines of three numbers, one of four.
pub(super) fn begins(text: &[u8]) -> bool {
    let mut lines = text
        .split(|&byte| byte == b'\n')
        .map(<[u8]>::trim_ascii)
        .filter(|line| !line.is_empty());
    let mut next = || lines.next().unwrap_or_default();
    (0..2).all(|_| count(next()).is_ok())
        && (0..4).all(|_| numbers::<3>(next()).is_ok())
        && numbers::<4>(next()).is_ok()
}
