//! Who lies around a point.

use std::num::NonZero;
use std::ops::Range;

use glam::{DVec3, Vec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

use crate::error::{Error, Result};

/// A neighbour seen from a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbour {
    /// Position relative to the point.
    pub offset: DVec3,
    pub normal: DVec3,
}

/// A search that the next one begins from.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Last {
    place: Vec3,
    /// Distance of the farthest of the `count` neighbours that were found, the point itself not counted.
    farthest: f32,
    count: usize,
}

/// More places than this to a point are many.
const SHARED: usize = 6;
/// Distances are rounded.
const ROUNDING: f32 = 1.0 + 1e-5;

/// The points in a tree.
pub(crate) struct Neighbours<'a> {
    positions: &'a [Vec3],
    tree: ImmutableKdTree<f32, 3>,
}

impl<'a> Neighbours<'a> {
    pub fn new(positions: &'a [Vec3]) -> Result<Self> {
        let places: Vec<[f32; 3]> = positions.iter().map(|p| p.to_array()).collect();
        let tree = ImmutableKdTree::new_from_slice(&places)
            .map_err(|e| Error::Invalid(format!("neighbour search failed: {e:?}")))?;
        Ok(Neighbours { positions, tree })
    }

    /// Distance to the nearest point at another place, among the `count` nearest ones.
    pub fn distance(&self, i: usize, count: usize) -> Option<f32> {
        let found = self.search(self.positions[i], count + 1, f32::INFINITY);
        let nearest = found.into_iter().map(|(_, square)| square);
        nearest.map(f32::sqrt).find(|&d| d > 0.0)
    }

    /// Puts the `count` nearest neighbours of point i into `near`, nearest first, with their
    /// normals; less those at the place of the point itself.
    pub(super) fn find(
        &self,
        i: usize,
        count: usize,
        normals: &[Vec3],
        last: &mut Last,
        near: &mut Vec<Neighbour>,
    ) {
        near.clear();
        let found = self.next_search(i, count, last);
        near.extend(self.others(i, &found).map(|(j, offset)| Neighbour {
            offset,
            normal: normals[j as usize].as_dvec3(),
        }));
    }

    /// Puts the `count` nearest neighbours of point i into `near`, nearest first: their indices, and
    /// their positions relative to the point; less those at the place of the point itself.
    pub fn nearest(&self, i: usize, count: usize, near: &mut Vec<(u32, DVec3)>) {
        self.next_nearest(i, count, &mut Last::default(), near);
    }

    /// The same, faster where the point before was close by; of points that are equally far, others may
    /// come first.
    pub fn next_nearest(
        &self,
        i: usize,
        count: usize,
        last: &mut Last,
        near: &mut Vec<(u32, DVec3)>,
    ) {
        near.clear();
        let found = self.next_search(i, count, last);
        near.extend(self.others(i, &found));
    }

    /// Point i and the `count` nearest ones, searched for from the last.
    fn next_search(&self, i: usize, count: usize, last: &mut Last) -> Vec<(u32, f32)> {
        let place = self.positions[i];
        // As many as around the last point are as near to that, so not farther from here than by the way.
        let reach = ROUNDING * (last.farthest + place.distance(last.place));
        let reach = if last.count >= count {
            reach * reach
        } else {
            f32::INFINITY
        };
        let found = self.search(place, count + 1, reach);
        *last = Last {
            place,
            farthest: found.last().map_or(0.0, |(_, square)| square.sqrt()),
            count: found.len().saturating_sub(1),
        };
        found
    }

    /// The points nearest to point i, nearest first, closer than the root of `reach`, with the squares of
    /// their distances; `count` at most, itself not among them.
    pub fn within(&self, i: usize, reach: f32, count: usize) -> Vec<(u32, f32)> {
        let mut found = self.search(self.positions[i], count + 1, reach);
        found.retain(|&(j, square)| j as usize != i && square < reach);
        found.truncate(count);
        found
    }

    /// All points up to `reach` from a place, nearest first, with the squares of their distances.
    pub fn all_within(&self, place: Vec3, reach: f32) -> Vec<(u32, f32)> {
        let found = self
            .tree
            .query(&place.to_array())
            .within::<SquaredEuclidean<f32>>(reach * reach)
            .execute();
        found.iter().map(|n| (n.item, n.distance)).collect()
    }

    /// For each point the `count` nearest ones, itself first, if many of so many places share a point: what lies
    /// around it lies around them. Else `None`.
    pub fn shared(&self, count: usize, places: usize) -> Option<Vec<Vec<u32>>> {
        let around = |place: &Vec3| self.around(*place, count);
        (places > SHARED * self.positions.len())
            .then(|| self.positions.par_iter().map(around).collect())
    }

    /// The points nearest to a place, nearest first.
    pub fn around(&self, place: Vec3, count: usize) -> Vec<u32> {
        let found = self.search(place, count, f32::INFINITY);
        found.into_iter().map(|(j, _)| j).collect()
    }

    /// The `count` points nearest to a place, up to the root of `reach` away, nearest first, with the squares
    /// of their distances.
    fn search(&self, place: Vec3, count: usize, reach: f32) -> Vec<(u32, f32)> {
        let found = self
            .tree
            .query(&place.to_array())
            .nearest_n::<SquaredEuclidean<f32>>(NonZero::<usize>::MIN.saturating_add(count - 1))
            .within(reach)
            .execute();
        found.iter().map(|n| (n.item, n.distance)).collect()
    }

    /// Those of the points found that lie at other places, relative to point i.
    fn others(&self, i: usize, found: &[(u32, f32)]) -> impl Iterator<Item = (u32, DVec3)> {
        let offset = move |j: u32| self.positions[j as usize] - self.positions[i];
        let all = found.iter().map(move |&(j, _)| (j, offset(j)));
        all.filter(|(_, offset)| *offset != Vec3::ZERO)
            .map(|(j, offset)| (j, offset.as_dvec3()))
    }
}

/// Points that are searched for one after the other: the same ones on any number of threads, as each
/// search begins from the last.
pub(super) const RUN: usize = 256;

/// The points of a range in runs.
pub(crate) fn runs(points: Range<usize>) -> impl IndexedParallelIterator<Item = Range<usize>> {
    let Range { start, end } = points;
    let run = move |k: usize| start + k * RUN..(start + (k + 1) * RUN).min(end);
    (0..points.len().div_ceil(RUN)).into_par_iter().map(run)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid, where many are equally far, and a spiral.
    #[test]
    fn the_last_search_changes_nothing() {
        let grid =
            (0..2000).map(|k| Vec3::new((k % 13) as f32, (k / 13 % 11) as f32, (k / 143) as f32));
        let spiral = (0..2000).map(|k| {
            let t = 0.01 * k as f32;
            Vec3::new(t * t.sin(), t * t.cos(), 0.3 * t)
        });
        for places in [grid.collect::<Vec<_>>(), spiral.collect()] {
            let neighbours = Neighbours::new(&places).unwrap();
            for count in [6, 16, 64] {
                let (mut last, mut next, mut plain) = (Last::default(), Vec::new(), Vec::new());
                for i in 0..places.len() {
                    neighbours.next_nearest(i, count, &mut last, &mut next);
                    neighbours.nearest(i, count, &mut plain);
                    // Which of those come first that are equally far is not said.
                    let lengths = |near: &[(u32, DVec3)]| -> Vec<f64> {
                        near.iter().map(|n| n.1.length_squared()).collect()
                    };
                    assert_eq!(lengths(&next), lengths(&plain));
                }
            }
        }
    }
}
