//! Links by rays: surfel from surfel, as often as its rays meet it.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::csr::Part;
use super::{Close, Rows};
use crate::error::Result;
use crate::math::Real;
use crate::octree::morton;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, Stratified, cosine_direction, stream};
use crate::visibility::{Occluders, first_hit};

/// Surfels whose links are made by one thread at a time.
const CHUNK: usize = 64;
/// Rays that are sorted by direction: so many of neighbours go the same way through the same memory.
const SORTED: usize = 1 << 14;
/// Parts of each axis that directions are sorted by.
const DIRECTIONS: f32 = 16.0;
/// Rays, or links, between two looks at whether the work should stop.
const BLOCK: usize = 1 << 20;

/// Casts the rays `numbers` of every surfel, in cosine-weighted directions: the weight of a link is
/// the part of them that meet the front of its source before anything else. A ray that meets a back
/// or nothing brings nothing, so that no row sums up to more than 1. What counts of a source is its
/// cell, not its area. Between [close](Close) pairs no ray counts.
///
/// Rays 0..2ᵏ are stratified, and so are 2ᵏ..2ᵏ⁺¹ for the same k, in other places: the operator of
/// twice as many rays is the [mean](mean()) of both.
///
/// Fails with [`Error::TooLarge`](crate::Error::TooLarge) beyond 2³² links.
pub fn gather<T: Real>(
    surfels: &Surfels,
    occluders: &Occluders,
    close: &Close,
    numbers: Range<u32>,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Rows> {
    let reach = surfels.reach();
    // Where each of the rays of some surfels begins, what it meets, if anything, and from which side.
    let met = |chunk: Range<usize>| {
        let mut rays: Vec<(u64, u32, Vec3)> = Vec::with_capacity(chunk.len() * numbers.len());
        for i in chunk {
            let points = Stratified::new(&mut stream(seed, Purpose::Rays, i as u64));
            let (normal, tangent) = (surfels.normals[i], surfels.cells.tangents[i]);
            rays.extend(numbers.clone().map(|k| {
                let [u, v] = points.get(k);
                let way = cosine_direction(normal, tangent, u, v);
                (direction(way), i as u32, way)
            }));
        }
        rays.sort_unstable_by_key(|&(direction, i, _)| (direction, i));
        let mut links: Vec<(u32, u32)> = (rays.into_iter())
            .filter_map(|(_, i, way)| {
                let ray = surfels.ray(i as usize, way * reach);
                let hit = first_hit::<T>(occluders, &ray).filter(|hit| hit.front)?;
                Some((i, hit.surfel))
            })
            .collect();
        links.sort_unstable();
        links
    };
    let n = surfels.len();
    let weight = 1.0 / numbers.len() as f32;
    progress.stage("rays", n as u64);
    let mut parts: Vec<Part> = Vec::with_capacity(n.div_ceil(CHUNK));
    for block in blocks(0..n, surfels_at_once(numbers.len())) {
        progress.check()?;
        let done = block.len() as u64;
        let chunks: Vec<_> = blocks(block, (SORTED / numbers.len()).max(1)).collect();
        parts.par_extend(chunks.into_par_iter().map(|chunk| {
            let mut part = Part::default();
            for same in met(chunk).chunk_by(|a, b| a == b) {
                let (target, source) = same[0];
                if !close.has(target as usize, source as usize) {
                    part.push(target, source);
                    part.weights.push(same.len() as f32 * weight);
                }
            }
            part
        }));
        progress.advance(done);
    }
    Rows::gather(n, parts)
}

/// The place of a unit vector on a curve that stays among its like (Morton order).
fn direction(way: Vec3) -> u64 {
    let parts = (way + 1.0) * (0.5 * DIRECTIONS);
    let last = Vec3::splat(DIRECTIONS - 1.0);
    morton(parts.min(last).as_u64vec3().to_array())
}

/// The mean of two lists of links whose rows are in the order of their sources. Of weights that are
/// parts of 2ᵏ rays it is exact.
///
/// Fails with [`Error::TooLarge`](crate::Error::TooLarge) beyond 2³² links.
pub fn mean(a: &Rows, b: &Rows, progress: &dyn Progress) -> Result<Rows> {
    sum(&[(0.5, a), (0.5, b)], |_, _| true, progress)
}

/// The sum of lists of links, each times a factor, as far as target and source are to `keep`; its rows are in
/// the order of their sources.
pub(super) fn sum(
    terms: &[(f32, &Rows)],
    keep: impl Fn(usize, usize) -> bool + Sync,
    progress: &dyn Progress,
) -> Result<Rows> {
    let targets = terms[0].1.offsets.len() - 1;
    let of_chunk = |chunk: Range<usize>| {
        let mut part = Part::default();
        let mut row: Vec<(usize, f32)> = Vec::new();
        for target in chunk {
            row.clear();
            for (factor, rows) in terms {
                let kept = rows.row(target).filter(|&(source, _)| keep(target, source));
                row.extend(kept.map(|(source, weight)| (source, factor * weight)));
            }
            row.sort_by_key(|&(source, _)| source);
            for same in row.chunk_by(|a, b| a.0 == b.0) {
                part.push(target as u32, same[0].0 as u32);
                part.weights
                    .push(same.iter().map(|&(_, weight)| weight).sum());
            }
        }
        part
    };
    let each = terms.iter().map(|(_, rows)| rows.len()).sum::<usize>() / targets.max(1);
    let mut parts: Vec<Part> = Vec::with_capacity(targets.div_ceil(CHUNK));
    for block in blocks(0..targets, surfels_at_once(each)) {
        progress.check()?;
        let chunks: Vec<_> = blocks(block, CHUNK).collect();
        parts.par_extend(chunks.into_par_iter().map(of_chunk));
    }
    Rows::gather(targets, parts)
}

/// Surfels in a block, where each has so many rays or links.
fn surfels_at_once(each: usize) -> usize {
    (BLOCK / each.max(1)).next_multiple_of(CHUNK).max(CHUNK)
}

fn blocks(range: Range<usize>, size: usize) -> impl Iterator<Item = Range<usize>> {
    let end = range.end;
    range
        .step_by(size)
        .map(move |first| first..(first + size).min(end))
}
