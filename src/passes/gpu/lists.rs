//! Links on a device.

use std::cmp::Reverse;
use std::ops::Range;

use bytemuck::{Pod, Zeroable};

use crate::error::{Error, Result};
use crate::links::Rows;

use super::batch::{Pieces, VECTOR};
use super::turns::{ROUNDS, UNCUT};
use super::{Gpu, Table};

/// A link, half a texel.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Link {
    pub source: u32,
    pub weight: f32,
}

/// A texel of a table of rows.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Row {
    target: u32,
    /// Links of the first kind are `begin..middle`, of the second `middle..end`.
    begin: u32,
    middle: u32,
    end: u32,
}

/// Rows of links, sorted by their length, so that invocations side by side have as much to do. (In
/// the octree's order those of eight lanes wait for the longest of them half of the time.) What adds
/// to a target must read what it was, because long rows are cut.
pub struct Lists {
    pub rows: Table,
    pub links: Table,
    pub pieces: Pieces,
}

/// Which rows there are, and on what they work.
pub struct Layout<'a> {
    /// Rows with links of one or two kinds, and the work of one link of either.
    pub kinds: &'a [(&'a Rows, usize)],
    /// Rounds of loops that a link takes between a target and a source.
    pub rounds: &'a dyn Fn(u32, usize) -> usize,
    /// Vectors of light a target.
    pub vectors: usize,
    /// The targets in memory of a row's target: itself, or its surfels.
    pub targets: &'a dyn Fn(u32) -> Range<u32>,
}

impl<'a> Layout<'a> {
    /// Rows with links, each of which works on its own target.
    pub fn new(kinds: &'a [(&'a Rows, usize)], vectors: usize) -> Self {
        Layout {
            kinds,
            rounds: &|_, _| 1,
            vectors,
            targets: &|t| t..t + 1,
        }
    }
}

impl Lists {
    pub fn new(gpu: &Gpu, what: &str, layout: &Layout) -> Result<Lists> {
        let kinds = layout.kinds;
        let targets = kinds[0].0.offsets.len() - 1;
        let length = |rows: &Rows, t: u32| {
            (rows.offsets[t as usize + 1] - rows.offsets[t as usize]) as usize
        };
        let work = |t: u32| -> usize {
            let links = kinds.iter().map(|&(rows, each)| length(rows, t) * each);
            2 * layout.vectors + links.sum::<usize>()
        };
        let most = gpu.most_bound(layout.vectors * VECTOR);
        let end = (0..targets as u32).map(|t| (layout.targets)(t).end).max();
        // Targets that cannot be bound together are kept apart.
        let together = match end.unwrap_or(0) as usize {
            end if end <= most => usize::MAX,
            _ => (most / 2).max(1),
        };
        let needed = |t: &u32| kinds.iter().any(|k| length(k.0, *t) > 0);
        let mut order: Vec<u32> = (0..targets as u32).filter(needed).collect();
        let group = |t: u32| (layout.targets)(t).start as usize / together;
        order.sort_by_key(|&t| (group(t), Reverse(work(t))));
        let mut links = Vec::with_capacity(kinds.iter().map(|k| k.0.len()).sum::<usize>() + 1);
        let mut turns: Vec<Vec<Row>> = Vec::new();
        for &target in &order {
            for (turn, row) in layout.row(target, &mut links)?.into_iter().enumerate() {
                if turn == turns.len() {
                    turns.push(Vec::new());
                }
                turns[turn].push(row);
            }
        }
        let mut begin = 0;
        let ranges: Vec<Range<u32>> = turns
            .iter()
            .map(|rows| {
                let range = begin..begin + rows.len() as u32;
                begin = range.end;
                range
            })
            .collect();
        let rows = turns.concat();
        // Two links a texel.
        links.resize(links.len().next_multiple_of(2), Link::zeroed());
        let texels: &[[u32; 4]] = bytemuck::cast_slice(&links);
        let each = |k: u32| {
            let row = &rows[k as usize];
            let ends = [row.begin, row.middle, row.end];
            let links = kinds.iter().zip(ends.windows(2));
            let work: usize = links.map(|(k, e)| k.1 * (e[1] - e[0]) as usize).sum();
            (2 * layout.vectors + work, (layout.targets)(row.target))
        };
        Ok(Lists {
            rows: gpu.table(what, &rows)?,
            links: gpu.table(what, texels)?,
            pieces: Pieces::of(gpu, &ranges, layout.vectors, each)?,
        })
    }
}

impl Layout<'_> {
    /// Appends the links of a target; cuts them into rows of [`ROUNDS`] at most, which take turns.
    fn row(&self, target: u32, links: &mut Vec<Link>) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        let begin = links.len() as u32;
        let mut ends = [begin; 3];
        let mut rounds = 0;
        for (k, (kind, _)) in self.kinds.iter().enumerate() {
            for (source, weight) in kind.row(target as usize) {
                let more = (self.rounds)(target, source);
                if more > UNCUT + 1 {
                    return Err(Error::TooLarge(format!(
                        "a link of {more} surfels: on a device they may be {UNCUT}"
                    )));
                }
                if rounds > 0 && rounds + more > ROUNDS {
                    rows.push(Row::new(target, ends));
                    ends = [links.len() as u32; 3];
                    rounds = 0;
                }
                rounds += more;
                links.push(Link {
                    source: source as u32,
                    weight,
                });
                ends[k + 1..].fill(links.len() as u32);
            }
        }
        rows.push(Row::new(target, ends));
        Ok(rows)
    }
}

impl Row {
    fn new(target: u32, [begin, middle, end]: [u32; 3]) -> Row {
        Row {
            target,
            begin,
            middle,
            end,
        }
    }
}
