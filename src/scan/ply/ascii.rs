//! The values of ascii PLY files: one entry a line.

use ply_rs::ply::{ElementDef, PropertyType};

use super::faces::{Faces, Fan};
use super::{PlyFile, Rows};
use crate::error::Result;
use crate::progress::Progress;
use crate::scan::lines::{self, Lines, words};

type Parsed<T> = std::result::Result<T, String>;

pub fn rows(
    ply: &mut PlyFile,
    columns: &[usize],
    faces: bool,
    progress: &dyn Progress,
    take: &mut dyn FnMut(Rows),
) -> Result<Option<Faces>> {
    let element = ply.element().clone();
    let slots: Vec<Option<usize>> = (0..element.properties.len())
        .map(|property| columns.iter().position(|&column| column == property))
        .collect();
    let before: usize = ply.before().map(lines_of).sum();
    let (line_end, number) = (ply.header.line_end, ply.header.lines + 1);
    let mut lines = Lines::new(&ply.path, &mut ply.input, line_end, number, progress);
    let ignore = |_: &[u8], _: &mut [f64]| Ok(());
    lines.rows(before, 1, ignore, &mut |_| {})?;
    let parse = |line: &[u8], row: &mut [f64]| parse(line, &element, &slots, row);
    let done = lines.rows(element.count, columns.len(), parse, take)?;
    if done < element.count {
        return Err(ply.input_error(format!(
            "the file is cut short: it ends after {done} of {} vertices",
            element.count
        )));
    }
    if !faces {
        return Ok(None);
    }
    let Some((between, face)) = super::faces::element(&ply.header) else {
        return Ok(None);
    };
    let between: usize = between.into_iter().map(lines_of).sum();
    lines.rows(between, 1, ignore, &mut |_| {})?;
    let mut fan = Fan::new(element.count);
    for done in 0..face.count {
        let Some(line) = lines.line()? else {
            return Ok(Some(Err(format!(
                "the file ends after {done} of {} faces",
                face.count
            ))));
        };
        if let Err(what) = add_face(line, face, &mut fan) {
            return Ok(Some(Err(lines.error(what).to_string())));
        }
    }
    Ok(Some(Ok(fan.triangles)))
}

/// Lines that an element takes.
fn lines_of(element: &ElementDef) -> usize {
    match element.properties.len() {
        0 => 0,
        _ => element.count,
    }
}

/// Parses one line; the value of property `i` goes to `row[slots[i]]`.
fn parse(
    line: &[u8],
    element: &ElementDef,
    slots: &[Option<usize>],
    row: &mut [f64],
) -> Parsed<()> {
    let mut words = words(line);
    for (property, slot) in element.properties.values().zip(slots) {
        let name = &property.name;
        let word = words.next().ok_or_else(|| ends_before(name))?;
        match property.data_type {
            PropertyType::Scalar(_) => {
                if let Some(slot) = *slot {
                    row[slot] = number(word, name)?;
                }
            }
            PropertyType::List(..) => {
                for _ in 0..length(word, name)? {
                    words.next().ok_or_else(|| ends_before(name))?;
                }
            }
        }
    }
    match words.next() {
        None => Ok(()),
        Some(_) => Err("more values than the header has properties".to_owned()),
    }
}

/// Parses the line of a face.
fn add_face(line: &[u8], face: &ElementDef, fan: &mut Fan) -> Parsed<()> {
    let mut words = words(line);
    for property in face.properties.values() {
        let name = &property.name;
        let word = words.next().ok_or_else(|| ends_before(name))?;
        if let PropertyType::List(..) = property.data_type {
            let wanted = super::faces::is_vertices(name);
            fan.begin();
            for _ in 0..length(word, name)? {
                let word = words.next().ok_or_else(|| ends_before(name))?;
                if wanted {
                    fan.add(number(word, name)?)?;
                }
            }
        }
    }
    Ok(())
}

fn ends_before(name: &str) -> String {
    format!("the line ends before the value of {name:?}")
}

fn number(word: &[u8], name: &str) -> Parsed<f64> {
    lines::number(word).ok_or_else(|| lines::not_a_number(word, &format!("property {name:?}")))
}

/// Length of a list.
fn length(word: &[u8], name: &str) -> Parsed<u64> {
    match number(word, name) {
        Ok(length) if length >= 0.0 && length.fract() == 0.0 => Ok(length as u64),
        _ => Err(lines::not_a_number(word, &format!("property {name:?}"))),
    }
}
