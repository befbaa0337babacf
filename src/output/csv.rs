//! Lit point clouds as text.

use std::fmt::Write;
use std::io;
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::columns::{Columns, Rows, Value};
use super::rows::{GRAIN, Lit, Paint};
use super::{Format, write_atomic};
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::{Grid, PointCloud};
use crate::scan::attributes::Kind;

/// Most decimals that a grid is given with.
const MOST_DECIMALS: i32 = 12;

/// Writes all points of a cloud with their light, in the cloud's order, as comma-separated values
/// with a line of names.
///
/// Coordinates have the decimals of the source's grid; all other numbers have the digits that
/// reading them back needs.
///
/// # Errors
/// [`Error::Invalid`](crate::Error::Invalid) if cloud and map differ in length,
/// [`Error::Io`](crate::Error::Io) if writing fails.
pub fn write_csv(path: &Path, cloud: &PointCloud, map: &IlluminationMap) -> Result<()> {
    let lit = Lit::new(cloud, map, Paint::Lit)?;
    write_columns(path, Columns::plain(lit, Format::Csv))
}

/// Writes a line for each point.
pub fn write_columns(path: &Path, columns: Columns) -> Result<()> {
    let digits = Digits::of(columns.lit.cloud);
    let mut header = String::new();
    for column in &columns.all {
        put_cell(&mut header, column.name.as_bytes());
    }
    end_line(&mut header);
    write_atomic(path, |writer| {
        writer.write_all(header.as_bytes())?;
        let written = columns.read(&mut |rows| {
            let texts: Vec<String> = (0..rows.count)
                .into_par_iter()
                .step_by(GRAIN)
                .map(|begin| {
                    let mut text = String::new();
                    for k in begin..rows.count.min(begin + GRAIN) {
                        put_line(&mut text, &digits, &rows, k);
                    }
                    text
                })
                .collect();
            texts
                .iter()
                .try_for_each(|text| writer.write_all(text.as_bytes()))
                .map_err(|e| Error::io(path, "cannot be written", e))
        });
        written.map_err(io::Error::other)
    })
}

fn put_line(text: &mut String, digits: &Digits, rows: &Rows, k: usize) {
    let cells = rows.cells(k);
    for column in rows.columns {
        let cell = match (column.value, &cells) {
            (Value::Kept(at), Some((cells, slots))) => slots[at].map(|slot| cells[slot]),
            _ => None,
        };
        match (cell, rows.value(column, k)) {
            (Some(cell), _) => put_cell(text, cell),
            (None, None) => text.push(','),
            (None, Some(x)) => match (column.value, column.kind) {
                (Value::Position(_), _) => digits.put(text, x),
                (_, Kind::F32) => put(text, x as f32),
                (_, Kind::I64) => put(text, x.to_bits() as i64),
                (_, Kind::U64) => put(text, x.to_bits()),
                _ => put(text, x),
            },
        }
    }
    end_line(text);
}

/// A number in as many digits as reading it back needs, and a comma.
fn put(text: &mut String, number: impl std::fmt::Display) {
    // Writing to a string cannot fail.
    let _ = write!(text, "{number},");
}

/// What stands in a text, in quotes where it needs them, and a comma.
fn put_cell(text: &mut String, cell: &[u8]) {
    let cell = String::from_utf8_lossy(cell);
    match cell.contains([',', ';', '\t', '"']) {
        true => put(text, format_args!("\"{}\"", cell.replace('"', "\"\""))),
        false => put(text, cell),
    }
}

/// Ends a line in the place of its last comma.
fn end_line(text: &mut String) {
    text.pop();
    text.push('\n');
}

/// How coordinates are written.
enum Digits {
    /// All are f32.
    Single,
    Double,
    /// On a grid of decimal steps.
    Decimals(usize),
}

impl Digits {
    fn of(cloud: &PointCloud) -> Self {
        if let Some(decimals) = cloud.grid.as_ref().and_then(decimals) {
            return Digits::Decimals(decimals);
        }
        let single = |p: &DVec3| p.is_nan() || p.as_vec3().as_dvec3() == *p;
        match cloud.positions.par_iter().all(single) {
            true => Digits::Single,
            false => Digits::Double,
        }
    }

    fn put(&self, text: &mut String, x: f64) {
        match *self {
            Digits::Single => put(text, x as f32),
            Digits::Double => put(text, x),
            Digits::Decimals(decimals) => put(text, format_args!("{x:.decimals$}")),
        }
    }
}

/// Decimals with which every place on a grid can be told; `None` if its steps are not decimal.
fn decimals(grid: &Grid) -> Option<usize> {
    let numbers = [grid.scale, grid.offset].map(|v| v.to_array());
    let whole = |&decimals: &i32| {
        numbers.as_flattened().iter().all(|x| {
            let x = x * 10f64.powi(decimals);
            (x - x.round()).abs() < 1e-6
        })
    };
    (0..=MOST_DECIMALS).find(whole).map(|d| d as usize)
}
