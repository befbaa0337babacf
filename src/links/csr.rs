//! Compressed rows: which sources act on each target.

use rayon::prelude::*;

/// Sources of each target with one weight a link: those of target t are the entries
/// `offsets[t]..offsets[t + 1]` of `sources` and `weights`.
#[derive(Clone, Debug, PartialEq)]
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

    /// Sources and weights of a target.
    pub fn row(&self, target: usize) -> impl Iterator<Item = (usize, f32)> {
        let range = self.offsets[target] as usize..self.offsets[target + 1] as usize;
        self.sources[range.clone()]
            .iter()
            .zip(&self.weights[range])
            .map(|(&s, &w)| (s as usize, w))
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
