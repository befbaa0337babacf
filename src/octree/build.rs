//! Building the octree, level by level and in parallel.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::{Facet, MAX_HALF_ANGLE};
use crate::points::Surfels;

/// Levels of the Morton code: bits an axis.
const MORTON_LEVELS: u32 = 21;

pub(super) struct Builder<'a> {
    surfels: &'a Surfels,
    leaf_size: usize,
    /// Morton code of each surfel in the common cube.
    codes: Vec<u64>,
}

pub(super) struct Built {
    pub facets: Vec<Facet>,
    pub levels: Vec<u32>,
    /// Surfels in the octree's order.
    pub surfels: Vec<u32>,
}

/// How a facet's surfels are ordered so far.
#[derive(Clone, Copy)]
enum Split {
    /// By normal; positions in no order.
    Normal,
    /// By Morton code, all codes equal above this level.
    Morton(u32),
}

/// A facet of the level under construction, with its surfels.
struct Open<'s> {
    facet: Facet,
    split: Split,
    members: &'s mut [u32],
}

impl<'a> Builder<'a> {
    pub fn new(surfels: &'a Surfels, leaf_size: usize) -> Self {
        let (low, high) = surfels
            .positions
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &p| {
                (low.min(p), high.max(p))
            });
        let size = f64::from((high - low).max_element()).max(f64::MIN_POSITIVE);
        let cells = f64::from(1u32 << MORTON_LEVELS);
        let codes = surfels
            .positions
            .par_iter()
            .map(|&p| {
                let cell = (p - low).as_dvec3() / size * cells;
                morton(cell.min(DVec3::splat(cells - 1.0)).as_u64vec3().to_array())
            })
            .collect();
        Builder {
            surfels,
            leaf_size,
            codes,
        }
    }

    pub fn run(&self) -> Built {
        let mut surfels: Vec<u32> = (0..self.surfels.len() as u32).collect();
        let root = Facet::measure(self.surfels, &surfels, 0, 0);
        let mut facets: Vec<Facet> = Vec::new();
        let mut levels = vec![0];
        let mut level = vec![Open {
            facet: root,
            split: Split::Normal,
            members: &mut surfels,
        }];
        while !level.is_empty() {
            let first = facets.len() as u32;
            let parts: Vec<(Facet, Vec<Open>)> = level
                .into_par_iter()
                .enumerate()
                .map(|(k, open)| self.divide(open, first + k as u32))
                .collect();
            let mut next_child = first + parts.len() as u32;
            level = Vec::new();
            for (mut facet, children) in parts {
                facet.first_child = next_child;
                facet.child_count = children.len() as u32;
                next_child += facet.child_count;
                facets.push(facet);
                level.extend(children);
            }
            levels.push(facets.len() as u32);
        }
        Built {
            facets,
            levels,
            surfels,
        }
    }

    /// Splits a facet by normal if its cone is too wide, else by place if it has too many surfels.
    fn divide<'s>(&self, open: Open<'s>, index: u32) -> (Facet, Vec<Open<'s>>) {
        let Open {
            facet,
            split,
            members,
        } = open;
        let wide = f64::from(facet.spread) > MAX_HALF_ANGLE.sin();
        let (cuts, split) = match split {
            Split::Normal if wide => (self.cut_by_normal(members), Split::Normal),
            Split::Normal if members.len() > self.leaf_size => {
                members.par_sort_unstable_by_key(|&i| (self.codes[i as usize], i));
                self.cut_by_place(members, 0)
            }
            Split::Morton(MORTON_LEVELS) if members.len() > self.leaf_size => {
                (self.cut_in_half(members), split)
            }
            Split::Morton(level) if members.len() > self.leaf_size => {
                self.cut_by_place(members, level)
            }
            _ => (Vec::new(), split),
        };
        let children = split_at(members, &cuts)
            .scan(facet.begin, |begin, part| {
                let at = *begin;
                *begin += part.len() as u32;
                Some((at, part))
            })
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|(begin, part)| Open {
                facet: Facet::measure(self.surfels, part, begin, index),
                split,
                members: part,
            })
            .collect();
        (facet, children)
    }

    /// Sorts by orientation; returns where parts end. Very different normals part by the face of
    /// the cube that they point to, others at the middle of their widest extent.
    fn cut_by_normal(&self, members: &mut [u32]) -> Vec<usize> {
        let normal = |i: u32| self.surfels.normals[i as usize];
        let (low, high) = members
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &i| {
                (low.min(normal(i)), high.max(normal(i)))
            });
        let extent = high - low;
        if extent.max_element() > 1.8 {
            return cut_by_key(members, |i| cube_face(normal(i)));
        }
        let axis = extent.max_position();
        let middle = 0.5 * (low + high)[axis];
        cut_by_key(members, |i| usize::from(normal(i)[axis] > middle))
    }

    /// Where the octants of sorted surfels end that agree above `level`; single octants on the way
    /// are skipped.
    fn cut_by_place(&self, members: &mut [u32], mut level: u32) -> (Vec<usize>, Split) {
        let octant =
            |i: u32, level: u32| (self.codes[i as usize] >> (3 * (MORTON_LEVELS - 1 - level))) & 7;
        let (first, last) = (members[0], members[members.len() - 1]);
        while level < MORTON_LEVELS && octant(first, level) == octant(last, level) {
            level += 1;
        }
        if level == MORTON_LEVELS {
            return (self.cut_in_half(members), Split::Morton(level));
        }
        let cuts = (1..members.len())
            .filter(|&k| octant(members[k - 1], level) != octant(members[k], level))
            .chain([members.len()])
            .collect();
        (cuts, Split::Morton(level + 1))
    }

    /// Below the finest level of the Morton code (a cloud that is tiny against its strays) halves do.
    fn cut_in_half(&self, members: &mut [u32]) -> Vec<usize> {
        let place = |i: u32| self.surfels.positions[i as usize];
        let (low, high) = members
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &i| {
                (low.min(place(i)), high.max(place(i)))
            });
        let axis = (high - low).max_position();
        members.sort_by(|&i, &j| place(i)[axis].total_cmp(&place(j)[axis]));
        vec![members.len() / 2, members.len()]
    }
}

/// Sorts by a small key, stably; returns where the parts of equal key end, or nothing if all are
/// equal.
fn cut_by_key(members: &mut [u32], key: impl Fn(u32) -> usize + Sync) -> Vec<usize> {
    members.par_sort_by_key(|&i| key(i));
    let cuts: Vec<usize> = (1..members.len())
        .filter(|&k| key(members[k - 1]) != key(members[k]))
        .chain([members.len()])
        .collect();
    if cuts.len() > 1 { cuts } else { Vec::new() }
}

/// The parts of a slice that end at `cuts`.
fn split_at<'s>(mut rest: &'s mut [u32], cuts: &[usize]) -> impl Iterator<Item = &'s mut [u32]> {
    let mut begin = 0;
    cuts.iter().map(move |&end| {
        let (part, tail) = std::mem::take(&mut rest).split_at_mut(end - begin);
        rest = tail;
        begin = end;
        part
    })
}

/// Which face of a cube a direction points to.
fn cube_face(n: Vec3) -> usize {
    let axis = n.abs().max_position();
    2 * axis + usize::from(n[axis] < 0.0)
}

/// Interleaves the lowest 21 bits of three coordinates.
fn morton(cell: [u64; 3]) -> u64 {
    let spread = |v: u64| {
        let mut x = v & 0x1f_ffff;
        x = (x | x << 32) & 0x001f_0000_0000_ffff;
        x = (x | x << 16) & 0x001f_0000_ff00_00ff;
        x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
        x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
        (x | x << 2) & 0x1249_2492_4924_9249
    };
    spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2
}
