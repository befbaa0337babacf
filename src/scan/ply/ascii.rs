//! The values of ascii PLY files: one entry a line.

use std::io::Read;

use ply_rs::ply::{ElementDef, PropertyType};
use rayon::prelude::*;

use super::{PlyFile, Rows};
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Bytes that are read, parsed and handed on at a time; also the longest line.
const BLOCK: usize = 4 << 20;

pub fn rows(
    ply: &mut PlyFile,
    columns: &[usize],
    progress: &dyn Progress,
    take: &mut dyn FnMut(Rows),
) -> Result<()> {
    let line_end = ply.header.line_end;
    let element = ply.element().clone();
    let slots: Vec<Option<usize>> = (0..element.properties.len())
        .map(|property| columns.iter().position(|&column| column == property))
        .collect();
    let mut skip: usize = ply
        .before()
        .filter(|element| !element.properties.is_empty())
        .map(|element| element.count)
        .sum();
    let mut done = 0;
    let mut line_number = ply.header.lines + 1;
    let mut values = Vec::new();
    let mut buffer = vec![0; BLOCK];
    // Bytes of a line that the last block cut.
    let mut kept = 0;

    while done < ply.len() {
        progress.check()?;
        let read = fill(&mut ply.input, &mut buffer[kept..])
            .map_err(|e| Error::io(&ply.path, "cannot be read", e))?;
        progress.advance(read as u64);
        let at_end = read < BLOCK - kept;
        let filled = &buffer[..kept + read];
        let whole = match filled.iter().rposition(|&byte| byte == line_end) {
            _ if at_end => filled.len(),
            Some(last) => last + 1,
            None => {
                return Err(
                    ply.input_error(format!("line {line_number} is longer than {BLOCK} bytes"))
                );
            }
        };
        let block = &filled[..whole];

        let mut lines = block
            .split(|&byte| byte == line_end)
            .filter(|line| !line.trim_ascii().is_empty());
        while skip > 0 && lines.next().is_some() {
            skip -= 1;
        }
        let lines: Vec<&[u8]> = lines.take(ply.len() - done).collect();
        values.clear();
        values.resize(lines.len() * columns.len(), 0.0);
        let wrong = values
            .par_chunks_exact_mut(columns.len())
            .zip(&lines)
            .find_map_first(|(row, line)| {
                let what = parse(line, &element, &slots, row).err()?;
                Some((line, what))
            });
        if let Some((line, what)) = wrong {
            let before = &block[..line.as_ptr().addr() - block.as_ptr().addr()];
            return Err(ply.input_error(format!(
                "line {}: {what}",
                line_number + count(before, line_end)
            )));
        }
        take(&values);
        done += lines.len();
        line_number += count(block, line_end);

        if at_end && done < ply.len() {
            return Err(ply.input_error(format!(
                "the file is cut short: it ends after {done} of {} vertices",
                ply.len()
            )));
        }
        let filled = filled.len();
        buffer.copy_within(whole..filled, 0);
        kept = filled - whole;
    }
    Ok(())
}

/// Reads until `buffer` is full or the file ends; returns the bytes read.
fn fill(input: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match input.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(filled)
}

fn count(bytes: &[u8], byte: u8) -> u64 {
    bytes.iter().filter(|&&b| b == byte).count() as u64
}

/// Parses one line; the value of property `i` goes to `row[slots[i]]`.
fn parse(
    line: &[u8],
    element: &ElementDef,
    slots: &[Option<usize>],
    row: &mut [f64],
) -> std::result::Result<(), String> {
    let mut words = line
        .split(|byte| byte.is_ascii_whitespace())
        .filter(|word| !word.is_empty());
    let mut next = |name: &str| {
        words
            .next()
            .ok_or_else(|| format!("the line ends before the value of {name:?}"))
    };
    for (property, slot) in element.properties.values().zip(slots) {
        let word = next(&property.name)?;
        match property.data_type {
            PropertyType::Scalar(_) => {
                if let Some(slot) = *slot {
                    row[slot] = number(word).ok_or_else(|| not_a_number(word, &property.name))?;
                }
            }
            PropertyType::List(..) => {
                let length = number(word)
                    .filter(|&length| length >= 0.0 && length.fract() == 0.0)
                    .ok_or_else(|| not_a_number(word, &property.name))?;
                for _ in 0..length as u64 {
                    next(&property.name)?;
                }
            }
        }
    }
    match words.next() {
        None => Ok(()),
        Some(_) => Err("more values than the header has properties".to_owned()),
    }
}

fn number(word: &[u8]) -> Option<f64> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

fn not_a_number(word: &[u8], name: &str) -> String {
    let word: String = String::from_utf8_lossy(word).chars().take(40).collect();
    format!("{word:?} is no number (property {name:?})")
}
