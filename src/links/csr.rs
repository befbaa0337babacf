//! Compressed rows: which sources act on each target.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Sources of each target with one weight a link: those of target t are the entries
/// `offsets[t]..offsets[t + 1]` of `sources` and `weights`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rows {
    /// Where each target's entries begin, and the number of entries at the end.
    pub offsets: Vec<u32>,
    /// The source of each entry.
    pub sources: Vec<u32>,
    /// The weight of each entry.
    pub weights: Vec<f32>,
}

/// One entry before it is sorted into its row.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    pub target: u32,
    pub source: u32,
    pub weight: f32,
}

impl Rows {
    /// No entries for so many targets.
    pub fn none(targets: usize) -> Rows {
        Rows {
            offsets: vec![0; targets + 1],
            sources: Vec::new(),
            weights: Vec::new(),
        }
    }

    /// Sorts entries into rows; within a row they keep their order.
    pub fn new(targets: usize, mut entries: Vec<Entry>) -> Rows {
        entries.par_sort_by_key(|e| e.target);
        let mut offsets = vec![0u32; targets + 1];
        for e in &entries {
            offsets[e.target as usize + 1] += 1;
        }
        for t in 0..targets {
            offsets[t + 1] += offsets[t];
        }
        Rows {
            offsets,
            sources: entries.iter().map(|e| e.source).collect(),
            weights: entries.iter().map(|e| e.weight).collect(),
        }
    }

    /// Puts parts of one list together; entries of a row keep their order.
    ///
    /// Fails with [`Error::TooLarge`] beyond 2³² entries.
    pub(super) fn gather(targets: usize, parts: Vec<Part>) -> Result<Rows> {
        let len: usize = parts.iter().map(|p| p.sources.len()).sum();
        if u32::try_from(len).is_err() {
            return Err(Error::TooLarge(format!(
                "{len} links are more than one operator can hold: ask for a larger tolerance"
            )));
        }
        let mut offsets = vec![0u32; targets + 1];
        for &(target, count) in parts.iter().flat_map(|p| &p.rows) {
            offsets[target as usize + 1] += count;
        }
        for t in 0..targets {
            offsets[t + 1] += offsets[t];
        }
        // Where the next entry of each row goes: at the end, the offsets are one row ahead.
        let mut sources = vec![0; len];
        let mut weights = vec![1.0; len];
        for part in parts {
            let mut begin = 0;
            for &(target, count) in &part.rows {
                let from = begin..begin + count as usize;
                let next = &mut offsets[target as usize];
                let to = *next as usize..(*next + count) as usize;
                *next += count;
                begin = from.end;
                sources[to.clone()].copy_from_slice(&part.sources[from.clone()]);
                if !part.weights.is_empty() {
                    weights[to].copy_from_slice(&part.weights[from]);
                }
            }
        }
        offsets.copy_within(0..targets, 1);
        offsets[0] = 0;
        Ok(Rows {
            offsets,
            sources,
            weights,
        })
    }

    /// Sources and weights of a target.
    pub fn row(&self, target: usize) -> impl Iterator<Item = (usize, f32)> {
        let range = self.offsets[target] as usize..self.offsets[target + 1] as usize;
        self.sources[range.clone()]
            .iter()
            .zip(&self.weights[range])
            .map(|(&s, &w)| (s as usize, w))
    }

    /// Whose row each entry is in.
    pub fn targets(&self) -> impl Iterator<Item = u32> {
        let rows = self.offsets.windows(2).zip(0..);
        rows.flat_map(|(ends, t)| std::iter::repeat_n(t, (ends[1] - ends[0]) as usize))
    }

    /// Whether a target has no entries.
    pub fn is_none(&self, target: usize) -> bool {
        self.offsets[target] == self.offsets[target + 1]
    }

    pub fn len(&self) -> usize {
        self.sources.len()
    }

    pub fn is_empty(&self) -> bool {
        self.sources.is_empty()
    }
}

/// Part of a list under construction: entries row by row.
#[derive(Default)]
pub(super) struct Part {
    /// Target and number of entries. A target may come again.
    pub rows: Vec<(u32, u32)>,
    pub sources: Vec<u32>,
    /// None where all are 1.
    pub weights: Vec<f32>,
}

impl Part {
    /// Adds an entry of weight 1.
    pub fn push(&mut self, target: u32, source: u32) {
        match self.rows.last_mut() {
            Some((last, count)) if *last == target => *count += 1,
            _ => self.rows.push((target, 1)),
        }
        self.sources.push(source);
    }

    /// Target, source and weight of each entry of a part that has weights.
    pub fn entries(&self) -> impl Iterator<Item = (u32, u32, f32)> {
        let targets = self.rows.iter();
        let targets = targets.flat_map(|&(t, count)| std::iter::repeat_n(t, count as usize));
        let sources = self.sources.iter().zip(&self.weights);
        targets.zip(sources).map(|(t, (&s, &w))| (t, s, w))
    }

    /// Bytes that it takes, here and once more in its rows.
    pub fn bytes(&self) -> usize {
        8 * self.rows.len() + 12 * self.sources.len() + 4 * self.weights.len()
    }
}
