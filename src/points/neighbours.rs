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

    /// Puts the `count` nearest neighbours of point i into `near`, nearest first, with their
    /// normals; less those at the place of the point itself.
    pub(super) fn find(&self, i: usize, count: usize, normals: &[Vec3], near: &mut Vec<Neighbour>) {
        near.clear();
        near.extend(self.nearest(i, count).map(|(j, _)| Neighbour {
            offset: (self.positions[j] - self.positions[i]).as_dvec3(),
            normal: normals[j].as_dvec3(),
        }));
    }

    /// The `count` nearest neighbours of point i, nearest first, with the squares of their distances;
    /// less those at the place of the point itself.
    pub fn nearest(&self, i: usize, count: usize) -> impl Iterator<Item = (usize, f32)> {
        let found = self
            .tree
            .query(&self.positions[i].to_array())
            .nearest_n::<SquaredEuclidean<f32>>(NonZero::<usize>::MIN.saturating_add(count))
            .execute();
        let others = found.into_iter().filter(|item| item.distance > 0.0);
        others.map(|item| (item.item as usize, item.distance))
    }
}
