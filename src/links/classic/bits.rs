//! A table of bits.

use std::ops::Range;

/// Rows of bits, one word after the other.
pub(super) struct Bits {
    /// Words a row.
    words: usize,
    bits: Vec<u64>,
}

impl Bits {
    /// All zero.
    pub fn new(rows: usize, columns: usize) -> Bits {
        let words = columns.div_ceil(64);
        Bits {
            words,
            bits: vec![0; rows * words],
        }
    }

    /// Bytes that so many bits take.
    pub fn bytes(rows: usize, columns: usize) -> u64 {
        8 * rows as u64 * columns.div_ceil(64) as u64
    }

    pub fn set(&mut self, row: usize, column: usize) {
        self.bits[row * self.words + column / 64] |= 1 << (column % 64);
    }

    /// Makes a row of others behind it, by an operation on their words.
    pub fn fold(&mut self, row: usize, others: Range<usize>, operation: fn(u64, u64) -> u64) {
        let (before, behind) = self.bits.split_at_mut((row + 1) * self.words);
        let first = (others.start - row - 1) * self.words;
        for (k, word) in before[row * self.words..].iter_mut().enumerate() {
            let words = behind[first + k..].iter().step_by(self.words);
            *word = words
                .take(others.len())
                .copied()
                .reduce(operation)
                .unwrap_or(0);
        }
    }

    /// Whether any of some bits of a row are set.
    pub fn any(&self, row: usize, columns: &Range<u32>) -> bool {
        self.masked(row, columns)
            .any(|(word, mask)| word & mask != 0)
    }

    /// Whether all of some bits of a row are set.
    pub fn all(&self, row: usize, columns: &Range<u32>) -> bool {
        self.masked(row, columns)
            .all(|(word, mask)| word & mask == mask)
    }

    /// The words of a row in which some columns lie, each with the mask of these.
    fn masked(&self, row: usize, columns: &Range<u32>) -> impl Iterator<Item = (u64, u64)> {
        let (begin, end) = (columns.start as usize, columns.end as usize);
        (begin / 64..end.div_ceil(64)).map(move |w| {
            let from = u64::MAX << begin.saturating_sub(64 * w);
            let to = u64::MAX >> (64 * (w + 1)).saturating_sub(end);
            (self.bits[row * self.words + w], from & to)
        })
    }
}
