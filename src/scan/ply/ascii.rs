//! The values of ascii PLY files: one entry a line.

use std::io::Read;

use ply_rs::ply::{ElementDef, PropertyDef, PropertyType};

use super::faces::{Faces, corner};
use super::{PlyFile, Rows};
use crate::error::Result;
use crate::progress::Progress;
use crate::scan::lines::{self, Lines, words};
use crate::scan::polygons::Polygons;

/// Vertices that are handed on at a time.
const BLOCK: usize = 1 << 12;

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
    let before: Vec<ElementDef> = ply.before().cloned().collect();
    let (line_end, number) = (ply.header.line_end, ply.header.lines + 1);
    let mut lines = Lines::new(&ply.path, &mut ply.input, line_end, number, progress);
    let ignore = |_: &[u8], _: &mut [f64]| Ok(());
    let mut found = None;
    for other in &before {
        if faces && found.is_none() && super::faces::is_face(other) {
            found = Some(read_faces(&mut lines, other, element.count)?);
        } else {
            lines.rows(lines_of(other), 1, ignore, &mut |_| {})?;
        }
    }
    let parse = |line: &[u8], row: &mut [f64]| parse(line, &element, &slots, row);
    let scattered = is_scattered(lines.ahead()?, &element);
    let done = match scattered {
        true => scattered_rows(&mut lines, &element, &slots, columns.len(), take)?,
        false => lines.rows(element.count, columns.len(), parse, take)?,
    };
    if done < element.count {
        return Err(ply.input_error(format!(
            "the file is cut short: it ends after {done} of {} vertices",
            element.count
        )));
    }
    if !faces || found.is_some() {
        return Ok(found);
    }
    let Some((between, face)) = super::faces::element(&ply.header) else {
        return Ok(None);
    };
    let between: usize = between.into_iter().map(lines_of).sum();
    lines.rows(between, 1, ignore, &mut |_| {})?;
    Ok(Some(read_faces(&mut lines, face, element.count)?))
}

/// Reads the lines of all faces, or says what is wrong with the first bad one.
fn read_faces<R: Read>(lines: &mut Lines<R>, face: &ElementDef, vertices: usize) -> Result<Faces> {
    let mut polygons = Polygons::default();
    let mut wrong = None;
    for done in 0..face.count {
        let Some(line) = lines.line()? else {
            let ends = || format!("the file ends after {done} of {} faces", face.count);
            return Ok(Err(wrong.unwrap_or_else(ends)));
        };
        // The rest is passed over: vertices may follow.
        if wrong.is_none()
            && let Err(what) = add_face(line, face, vertices, &mut polygons)
        {
            wrong = Some(lines.located(what));
        }
    }
    Ok(wrong.map_or(Ok(polygons), Err))
}

/// Whether each vertex takes several lines: the values of the first ones fit just so.
fn is_scattered(text: &[u8], element: &ElementDef) -> bool {
    let is_scalar = |property: &PropertyDef| matches!(property.data_type, PropertyType::Scalar(_));
    let all = element.properties.len();
    let lines = text.split(|&byte| matches!(byte, b'\n' | b'\r'));
    let mut counts = lines
        .map(|line| words(line).count())
        .filter(|&count| count > 0);
    let mut sum = counts.next().unwrap_or(all);
    if sum >= all || !element.properties.values().all(is_scalar) {
        return false;
    }
    while sum < all {
        match counts.next() {
            Some(count) => sum += count,
            None => return false,
        }
    }
    sum == all
}

/// Vertices whose values are parted into lines anyhow; returns their number.
fn scattered_rows<R: Read>(
    lines: &mut Lines<R>,
    element: &ElementDef,
    slots: &[Option<usize>],
    width: usize,
    take: &mut dyn FnMut(Rows),
) -> Result<usize> {
    let names: Vec<&String> = element.properties.keys().collect();
    let mut values = vec![0.0; BLOCK * width];
    let (mut row, mut column, mut done) = (0, 0, 0);
    while done < element.count {
        let Some(line) = lines.line()? else { break };
        let mut wrong = None;
        for word in words(line) {
            match (done < element.count, number(word, names[column])) {
                (false, _) => wrong = Some("more values than the header has properties".into()),
                (true, Err(what)) => wrong = Some(what),
                (true, Ok(value)) => {
                    if let Some(slot) = slots[column] {
                        values[row * width + slot] = value;
                    }
                }
            }
            if wrong.is_some() {
                break;
            }
            column = (column + 1) % names.len();
            if column == 0 {
                (row, done) = (row + 1, done + 1);
            }
            if row == BLOCK {
                take(&values);
                row = 0;
            }
        }
        if let Some(what) = wrong {
            return Err(lines.error(what));
        }
    }
    take(&values[..row * width]);
    Ok(done)
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
fn add_face(
    line: &[u8],
    face: &ElementDef,
    vertices: usize,
    polygons: &mut Polygons,
) -> Parsed<()> {
    let mut words = words(line);
    for property in face.properties.values() {
        let name = &property.name;
        let word = words.next().ok_or_else(|| ends_before(name))?;
        if let PropertyType::List(..) = property.data_type {
            let wanted = super::faces::is_vertices(name);
            for _ in 0..length(word, name)? {
                let word = words.next().ok_or_else(|| ends_before(name))?;
                if wanted {
                    polygons.add(corner(number(word, name)?, vertices)?);
                }
            }
            if wanted {
                polygons.close();
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
