//! The values of binary PLY files.

use std::io::{self, BufRead, Read, Seek, SeekFrom};

use ply_rs::ply::{ElementDef, Encoding, PropertyType, ScalarType};
use rayon::prelude::*;

use super::faces::{Faces, corner};
use super::layout::{decode, decode_packed, offset, size};
use super::{PlyFile, Rows};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scan::names;
use crate::scan::polygons::Polygons;

/// Bytes that are read, decoded and handed on at a time.
const BLOCK: usize = 4 << 20;
/// Rows for one thread at a time.
const GRAIN: usize = 4096;

pub fn rows(
    ply: &mut PlyFile,
    columns: &[usize],
    faces: bool,
    progress: &dyn Progress,
    take: &mut dyn FnMut(Rows),
) -> Result<Option<Faces>> {
    let mut found = None;
    for element in ply.before().cloned().collect::<Vec<_>>() {
        let (encoding, vertices) = (ply.header.encoding, ply.len());
        if faces && found.is_none() && super::faces::is_face(&element) {
            let failed = |e| Error::io(&ply.path, "cannot be read", e);
            let start = ply.input.stream_position().map_err(failed)?;
            let read = read_faces(&mut ply.input, &element, encoding, vertices, progress)?;
            let is_sound = read.is_ok();
            found = Some(read);
            if is_sound {
                continue;
            }
            // Damaged faces end anywhere: the vertices are found once more from the start.
            ply.input.seek(SeekFrom::Start(start)).map_err(failed)?;
        }
        skip(&mut ply.input, &element, encoding, progress)?.map_err(|e| match e.kind() {
            io::ErrorKind::UnexpectedEof => ply.input_error(format!(
                "the file is cut short: it ends in element {:?}, before the vertices",
                element.name
            )),
            io::ErrorKind::InvalidData => {
                ply.input_error(format!("element {:?}: {e}", element.name))
            }
            _ => Error::io(&ply.path, "cannot be read", e),
        })?;
    }
    match offset(ply.element(), usize::MAX) {
        Some(stride) => strided_rows(ply, stride, columns, progress, take)?,
        None => rows_with_lists(ply, columns, progress, take)?,
    }
    match super::faces::element(&ply.header) {
        _ if found.is_some() => Ok(found),
        Some((between, face)) if faces => {
            let vertices = ply.len();
            let encoding = ply.header.encoding;
            for element in between {
                if let Err(e) = skip(&mut ply.input, element, encoding, progress)? {
                    return Ok(Some(Err(format!("element {:?}: {e}", element.name))));
                }
            }
            let faces = read_faces(&mut ply.input, face, encoding, vertices, progress)?;
            Ok(Some(faces))
        }
        _ => Ok(None),
    }
}

/// Reads the faces. The outer error is the interruption.
fn read_faces<R: BufRead + Seek>(
    input: &mut R,
    face: &ElementDef,
    encoding: Encoding,
    vertices: usize,
    progress: &dyn Progress,
) -> Result<Faces> {
    let mut polygons = Polygons::default();
    for done in 0..face.count {
        if done % 65536 == 0 {
            progress.check()?;
        }
        match read_face(input, face, encoding, vertices, &mut polygons) {
            Ok(Ok(())) => {}
            Ok(Err(what)) => return Ok(Err(format!("face {done}: {what}"))),
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => {
                return Ok(Err(format!(
                    "the file ends after {done} of {} faces",
                    face.count
                )));
            }
            Err(e) => return Ok(Err(format!("face {done}: {e}"))),
        }
    }
    Ok(Ok(polygons))
}

/// Reads one face; the inner error is a bad index.
fn read_face<R: BufRead + Seek>(
    input: &mut R,
    face: &ElementDef,
    encoding: Encoding,
    vertices: usize,
    polygons: &mut Polygons,
) -> io::Result<std::result::Result<(), String>> {
    let value = |input: &mut R, scalar: &ScalarType| {
        let mut buffer = [0; 8];
        input.read_exact(&mut buffer[..size(scalar)])?;
        Ok::<f64, io::Error>(decode(scalar, &buffer, encoding))
    };
    for property in face.properties.values() {
        let (count, item) = match &property.data_type {
            PropertyType::Scalar(scalar) => (scalar, None),
            PropertyType::List(count, item) => (count, Some(item)),
        };
        let length = value(input, count)?;
        let Some(item) = item else { continue };
        if !super::faces::is_vertices(&property.name) {
            input.seek_relative(length.max(0.0) as i64 * size(item) as i64)?;
            continue;
        }
        for _ in 0..length as u64 {
            match corner(value(input, item)?, vertices) {
                Ok(corner) => polygons.add(corner),
                Err(what) => return Ok(Err(what)),
            }
        }
        polygons.close();
    }
    Ok(Ok(()))
}

/// Rows of equal length: read in blocks, decoded on all threads.
fn strided_rows(
    ply: &mut PlyFile,
    stride: usize,
    columns: &[usize],
    progress: &dyn Progress,
    take: &mut dyn FnMut(Rows),
) -> Result<()> {
    let encoding = ply.header.encoding;
    let packed = packed(ply.element());
    let fields: Vec<(usize, ScalarType, bool)> = columns
        .iter()
        .map(|&column| {
            let offset = offset(ply.element(), column).expect("rows of equal length");
            (offset, ply.scalar(column).clone(), packed.contains(&column))
        })
        .collect();
    let block = (BLOCK / stride).max(1).min(ply.len());
    let mut bytes = vec![0; block * stride];
    let mut values = vec![0.0; block * columns.len()];
    let mut done = 0;
    while done < ply.len() {
        progress.check()?;
        let rows = block.min(ply.len() - done);
        let bytes = &mut bytes[..rows * stride];
        let values = &mut values[..rows * columns.len()];
        ply.input
            .read_exact(bytes)
            .map_err(|e| ply.read_error(e, done))?;
        values
            .par_chunks_exact_mut(columns.len())
            .zip(bytes.par_chunks_exact(stride))
            .with_min_len(GRAIN)
            .for_each(|(values, bytes)| {
                for (value, (offset, scalar, packed)) in values.iter_mut().zip(&fields) {
                    let decode = if *packed { decode_packed } else { decode };
                    *value = decode(scalar, &bytes[*offset..], encoding);
                }
            });
        take(values);
        progress.advance(bytes.len() as u64);
        done += rows;
    }
    Ok(())
}

/// Rows with lists among their values: read one after the other, the lists are skipped.
fn rows_with_lists(
    ply: &mut PlyFile,
    columns: &[usize],
    progress: &dyn Progress,
    take: &mut dyn FnMut(Rows),
) -> Result<()> {
    let element = ply.element().clone();
    let encoding = ply.header.encoding;
    let packed = packed(&element);
    let mut row = vec![0.0; element.properties.len()];
    let mut values = Vec::new();
    let mut bytes = 0;
    for done in 0..ply.len() {
        bytes +=
            read_row(&mut ply.input, &element, encoding, &packed, &mut row).map_err(|e| match e
                .kind()
            {
                io::ErrorKind::InvalidData => ply.input_error(format!("vertex {done}: {e}")),
                _ => ply.read_error(e, done),
            })?;
        values.extend(columns.iter().map(|&column| row[column]));
        if values.len() * size_of::<f64>() >= BLOCK || done + 1 == ply.len() {
            progress.check()?;
            progress.advance(std::mem::take(&mut bytes));
            take(&values);
            values.clear();
        }
    }
    Ok(())
}

/// The columns that hold packed colours.
fn packed(element: &ElementDef) -> Vec<usize> {
    let names = element.properties.keys().enumerate();
    let packed = names.filter(|(_, name)| names::meaning(name) == Some("rgb"));
    packed.map(|(column, _)| column).collect()
}

/// Skips all entries of an element. The outer error is the interruption.
fn skip<R: BufRead + Seek>(
    input: &mut R,
    element: &ElementDef,
    encoding: Encoding,
    progress: &dyn Progress,
) -> Result<io::Result<()>> {
    if let Some(stride) = offset(element, usize::MAX) {
        // No overflow: the header fits the file's length.
        let bytes = (element.count * stride) as u64;
        progress.advance(bytes);
        return Ok(input.seek_relative(bytes as i64));
    }
    let mut row = vec![0.0; element.properties.len()];
    for i in 0..element.count {
        if i % 65536 == 0 {
            progress.check()?;
        }
        match read_row(input, element, encoding, &[], &mut row) {
            Ok(bytes) => progress.advance(bytes),
            Err(e) => return Ok(Err(e)),
        }
    }
    Ok(Ok(()))
}

/// Reads the scalars of one entry and skips its lists; returns its length in bytes.
fn read_row<R: BufRead + Seek>(
    input: &mut R,
    element: &ElementDef,
    encoding: Encoding,
    packed: &[usize],
    row: &mut [f64],
) -> io::Result<u64> {
    let mut bytes = 0;
    for (column, (property, value)) in element.properties.values().zip(row).enumerate() {
        let (PropertyType::Scalar(scalar) | PropertyType::List(scalar, _)) = &property.data_type;
        let mut buffer = [0; 8];
        input.read_exact(&mut buffer[..size(scalar)])?;
        let decode = match packed.contains(&column) {
            true => decode_packed,
            false => decode,
        };
        *value = decode(scalar, &buffer, encoding);
        bytes += size(scalar) as u64;
        if let PropertyType::List(_, item) = &property.data_type {
            if *value < 0.0 {
                return Err(io::Error::new(
                    io::ErrorKind::InvalidData,
                    format!("list {:?} has a negative length", property.name),
                ));
            }
            let length = *value as u64 * size(item) as u64;
            // Beyond the end of the file the next read fails.
            input.seek_relative(length as i64)?;
            bytes += length;
        }
    }
    Ok(bytes)
}
