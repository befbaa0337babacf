//! Links on a device.

use std::cmp::Reverse;
use std::ops::Range;

use bytemuck::{Pod, Zeroable};

use crate::error::Result;
use crate::links::Rows;

use super::batch::{Pieces, VECTOR};
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
/// the octree's order those of eight lanes wait for the longest of them half of the time.)
pub struct Lists {
    pub rows: Table,
    pub links: Table,
    pub pieces: Pieces,
}

/// Which rows there are, and on what they work.
pub struct Layout<'a> {
    /// Rows with links of one or two kinds, and the work of one link of either.
    pub kinds: &'a [(&'a Rows, usize)],
    /// Whether rows without links are needed too.
    pub empty_rows: bool,
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
            empty_rows: false,
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
        let needed = |t: &u32| layout.empty_rows || kinds.iter().any(|k| length(k.0, *t) > 0);
        let mut order: Vec<u32> = (0..targets as u32).filter(needed).collect();
        let group = |t: u32| (layout.targets)(t).start as usize / together;
        order.sort_by_key(|&t| (group(t), Reverse(work(t))));
        let mut links = Vec::with_capacity(kinds.iter().map(|k| k.0.len()).sum::<usize>() + 1);
        let mut rows = Vec::with_capacity(order.len());
        for &target in &order {
            let mut bounds = [links.len() as u32; 3];
            for (k, end) in bounds[1..].iter_mut().enumerate() {
                if let Some((kind, _)) = kinds.get(k) {
                    links.extend(kind.row(target as usize).map(|(source, weight)| Link {
                        source: source as u32,
                        weight,
                    }));
                }
                *end = links.len() as u32;
            }
            let [begin, middle, end] = bounds;
            rows.push(Row {
                target,
                begin,
                middle,
                end,
            });
        }
        // Two links a texel.
        links.resize(links.len().next_multiple_of(2), Link::zeroed());
        let texels: &[[u32; 4]] = bytemuck::cast_slice(&links);
        let each = |k: u32| {
            let target = order[k as usize];
            (work(target), (layout.targets)(target))
        };
        Ok(Lists {
            rows: gpu.table(what, &rows)?,
            links: gpu.table(what, texels)?,
            pieces: Pieces::of(gpu, &[0..order.len() as u32], layout.vectors, each)?,
        })
    }
}
