//! Building the octree: surfels are sorted once, by the cone of their normals and along a Morton
//! curve; then cells are cut from the sorted codes, level by level and in parallel.

use std::ops::Range;

use rayon::prelude::*;

use super::cell::{self, Cell, MORTON_LEVELS};
use super::cones::{Cones, Part};
use super::measure::measure;
use super::{Facet, Octree};
use crate::points::Surfels;

/// What a surfel is sorted by.
#[derive(Clone, Copy)]
struct Key {
    /// Morton code in the common cube.
    code: u64,
    /// Place of its cone among the cones.
    cone: u32,
    /// Which surfel it is.
    index: u32,
}

/// What the surfels of a facet under construction have in common.
#[derive(Clone, Copy)]
enum Kind<'a> {
    /// A part of the tree of cones.
    Part(&'a Part),
    /// Codes that agree above this level.
    Level(u32),
}

/// A facet under construction, with its surfels.
struct Open<'a, 'k> {
    begin: u32,
    parent: u32,
    kind: Kind<'a>,
    keys: &'k mut [Key],
}

struct Builder<'a> {
    surfels: &'a Surfels,
    leaf_size: usize,
    cones: &'a Cones,
}

pub(super) fn build(surfels: &Surfels, leaf_size: usize) -> (Octree, Surfels) {
    let cones = Cones::of(surfels);
    let mut keys = keys(surfels, &cones);
    let builder = Builder {
        surfels,
        leaf_size: leaf_size.max(1),
        cones: &cones,
    };
    let mut octree = builder.facets(&mut keys);
    drop(cones);
    let order: Vec<u32> = keys.par_iter().map(|k| k.index).collect();
    drop(keys);
    let sorted = surfels.reordered(&order);
    measure(&mut octree, &sorted);
    (octree, sorted)
}

/// The keys of all surfels in the octree's order.
fn keys(surfels: &Surfels, cones: &Cones) -> Vec<Key> {
    // Cones are ranked so that those of one part follow one another.
    let mut ranks = vec![0; cones.parts.len()];
    let mut stack = vec![0_u32];
    for rank in 0.. {
        let Some(part) = stack.pop() else { break };
        ranks[part as usize] = rank;
        stack.extend(cones.parts[part as usize].children.clone().rev());
    }
    let mut keys: Vec<Key> = cell::codes(&surfels.positions)
        .zip(&cones.part_of)
        .enumerate()
        .map(|(i, (code, &part))| Key {
            code,
            cone: ranks[part as usize],
            index: i as u32,
        })
        .collect();
    keys.par_sort_unstable_by_key(|k| (k.cone, k.code, k.index));
    keys
}

impl<'a> Builder<'a> {
    /// Facets that are not measured yet.
    fn facets(&self, keys: &mut [Key]) -> Octree {
        let mut facets: Vec<Facet> = Vec::new();
        let mut levels = vec![0];
        let mut cones = Vec::new();
        let mut level = vec![Open {
            begin: 0,
            parent: 0,
            kind: Kind::Part(&self.cones.parts[0]),
            keys,
        }];
        while !level.is_empty() {
            let first = facets.len() as u32;
            for (k, open) in level.iter().enumerate() {
                if matches!(open.kind, Kind::Part(part) if part.children.is_empty()) {
                    cones.push(first + k as u32);
                }
            }
            let divided: Vec<(Facet, Vec<Open>)> = level
                .into_par_iter()
                .enumerate()
                .map(|(k, open)| self.divide(open, first + k as u32))
                .collect();
            let mut next_child = first + divided.len() as u32;
            level = Vec::new();
            for (mut facet, children) in divided {
                facet.first_child = next_child;
                facet.child_count = children.len() as u32;
                next_child += facet.child_count;
                facets.push(facet);
                level.extend(children);
            }
            levels.push(facets.len() as u32);
        }
        Octree::unmeasured(facets, levels, cones)
    }

    /// Splits a facet by normal if its cone is too wide, else by place if it has too many surfels.
    fn divide<'k>(&self, open: Open<'a, 'k>, index: u32) -> (Facet, Vec<Open<'a, 'k>>) {
        let code = |key: Option<&Key>| key.map_or(0, |k| k.code);
        let (first, last) = (code(open.keys.first()), code(open.keys.last()));
        let large = open.keys.len() > self.leaf_size;
        let (level, parts): (u32, Vec<(usize, Kind)>) = match open.kind {
            Kind::Part(part) if !part.children.is_empty() => (0, self.parts(&part.children)),
            // Single octants on the way are skipped.
            Kind::Part(_) => match common_level(first, last) {
                level if large => (level, cut(open.keys, level)),
                level => (level, Vec::new()),
            },
            Kind::Level(level) if large => {
                let level = level.max(common_level(first, last));
                (level, cut(open.keys, level))
            }
            Kind::Level(level) => (level, Vec::new()),
        };
        if level >= MORTON_LEVELS && !parts.is_empty() {
            self.sort_along_widest(open.keys);
        }
        let facet = Facet {
            begin: open.begin,
            end: open.begin + open.keys.len() as u32,
            parent: open.parent,
            cell: Cell::of(first, level),
            ..Facet::default()
        };
        let mut begin = open.begin;
        let mut rest = open.keys;
        let children = parts.into_iter().map(|(len, kind)| {
            let (keys, tail) = std::mem::take(&mut rest).split_at_mut(len);
            rest = tail;
            begin += len as u32;
            Open {
                begin: begin - len as u32,
                parent: index,
                kind,
                keys,
            }
        });
        (facet, children.collect())
    }

    /// Lengths of the parts of a part that are not empty.
    fn parts(&self, children: &Range<u32>) -> Vec<(usize, Kind<'a>)> {
        let range = children.start as usize..children.end as usize;
        let parts = self.cones.parts[range].iter().filter(|p| p.len > 0);
        parts.map(|p| (p.len, Kind::Part(p))).collect()
    }

    /// For halves, below the finest level of the Morton code (a cloud that is tiny against its strays).
    fn sort_along_widest(&self, keys: &mut [Key]) {
        let place = |k: &Key| self.surfels.positions[k.index as usize];
        let (low, high) = keys
            .iter()
            .fold((place(&keys[0]), place(&keys[0])), |b, k| {
                (b.0.min(place(k)), b.1.max(place(k)))
            });
        let axis = (high - low).max_position();
        keys.sort_by(|a, b| place(a)[axis].total_cmp(&place(b)[axis]));
    }
}

/// The finest level at which sorted codes from first to last lie in one cell.
fn common_level(first: u64, last: u64) -> u32 {
    let differing = u64::BITS - (first ^ last).leading_zeros();
    MORTON_LEVELS - differing.div_ceil(3)
}

/// Lengths of the octants of sorted keys whose codes agree down to `level`, or of halves below the
/// finest one.
fn cut<'a>(keys: &[Key], level: u32) -> Vec<(usize, Kind<'a>)> {
    let kind = Kind::Level(level + 1);
    if level >= MORTON_LEVELS {
        let half = keys.len() / 2;
        return vec![(half, kind), (keys.len() - half, kind)];
    }
    let octant = |k: &Key| k.code >> (3 * (MORTON_LEVELS - 1 - level));
    let mut rest = keys;
    let mut parts = Vec::with_capacity(8);
    while let Some(first) = rest.first() {
        let len = rest.partition_point(|k| octant(k) <= octant(first));
        parts.push((len, kind));
        rest = &rest[len..];
    }
    parts
}
