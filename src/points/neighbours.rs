//! Who lies around a point.

use std::num::NonZero;

use glam::{DVec3, Vec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::error::{Error, Result};

/// A neighbour seen from a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbour {
    /// Position relative to the point.
    pub offset: DVec3,
    pub normal: DVec3,
}

/// The points in a tree.
pub(super) struct Neighbours<'a> {
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

    /// Puts the `count` nearest neighbours of point i into `near`, nearest first, with their
    /// normals; less those at the place of the point itself.
    pub fn find(&self, i: usize, count: usize, normals: &[Vec3], near: &mut Vec<Neighbour>) {
        let found = self
            .tree
            .query(&self.positions[i].to_array())
            .nearest_n::<SquaredEuclidean<f32>>(NonZero::<usize>::MIN.saturating_add(count))
            .execute();
        near.clear();
        for item in found.iter().filter(|item| item.distance > 0.0) {
            let j = item.item as usize;
            near.push(Neighbour {
                offset: (self.positions[j] - self.positions[i]).as_dvec3(),
                normal: normals[j].as_dvec3(),
            });
        }
    }

    /// Puts the `count` nearest neighbours of point i into `near`, nearest first: their indices, and
    /// their positions relative to the point; less those at the place of the point itself.
    pub fn nearest(&self, i: usize, count: usize, near: &mut Vec<(u32, DVec3)>) {
        near.clear();
        let place = self.positions[i];
        near.extend(self.around(place, count + 1).into_iter().filter_map(|j| {
            let offset = self.positions[j as usize] - place;
            (offset != Vec3::ZERO).then(|| (j, offset.as_dvec3()))
        }));
    }

    /// The points nearest to a place, nearest first.
    pub fn around(&self, place: Vec3, count: usize) -> Vec<u32> {
        let found = self
            .tree
            .query(&place.to_array())
            .nearest_n::<SquaredEuclidean<f32>>(NonZero::<usize>::MIN.saturating_add(count - 1))
            .execute();
        found.iter().map(|item| item.item).collect()
    }
}
