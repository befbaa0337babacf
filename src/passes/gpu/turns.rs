//! Items that add to surfels, in turns.

use std::ops::Range;

use crate::links::Rows;
use crate::octree::Octree;

/// Rounds of its loops that an invocation is given, at most, if its work can be cut. Mesa's llvmpipe
/// leaves the loops of eight invocations side by side after 65,535 rounds in all, without a word;
/// where loops are nested, the rounds of all eight may add up.
pub const ROUNDS: usize = 1 << 12;
/// The same of what cannot be cut: surfels of a leaf, or of a facet whose surfels act one by one on
/// an expansion.
pub const UNCUT: usize = 1 << 14;

/// Items of the rows of facets, and the ranges of them that may run at once: no two items of a turn
/// add to the same surfel. Facets of one level have no surfels in common; the runs into which `cut`
/// cuts the row of a facet take turns.
pub fn in_turns<I>(
    octree: &Octree,
    rows: &Rows,
    mut cut: impl FnMut(usize) -> Vec<Vec<I>>,
) -> (Vec<I>, Vec<Range<u32>>) {
    let (mut items, mut ranges) = (Vec::new(), Vec::new());
    for level in 0..octree.depth() {
        let mut turns: Vec<Vec<I>> = Vec::new();
        for target in octree.level(level).filter(|&t| !rows.is_none(t)) {
            for (turn, run) in cut(target).into_iter().enumerate() {
                if turn == turns.len() {
                    turns.push(Vec::new());
                }
                turns[turn].extend(run);
            }
        }
        for turn in turns {
            let first = items.len() as u32;
            items.extend(turn);
            ranges.push(first..items.len() as u32);
        }
    }
    (items, ranges)
}

/// Cuts a range into parts of at most `size`.
pub fn blocks(range: Range<u32>, size: u32) -> impl Iterator<Item = Range<u32>> {
    let end = range.end;
    range
        .step_by(size as usize)
        .map(move |first| first..(first + size).min(end))
}
