//! Which surfels see each other, pair by pair.

use crate::error::Result;
use crate::points::Surfels;

use super::{Segment, Visibility};

/// Decides pairs of surfels in batches, on the CPU or on a device.
pub trait PointVisibility: Sync {
    /// One entry a pair: true where the two surfels face and see each other.
    fn visible(&self, pairs: &[[u32; 2]]) -> Result<Vec<bool>>;
}

/// Pairs by the segment between them: whether it meets a cell.
pub struct BySegment<'a> {
    pub surfels: &'a Surfels,
    pub visibility: &'a dyn Visibility,
}

impl PointVisibility for BySegment<'_> {
    fn visible(&self, pairs: &[[u32; 2]]) -> Result<Vec<bool>> {
        let facing: Vec<bool> = pairs
            .iter()
            .map(|&[i, j]| face(self.surfels, i as usize, j as usize))
            .collect();
        let segments: Vec<Segment> = pairs
            .iter()
            .zip(&facing)
            .filter(|&(_, &faces)| faces)
            .map(|(&[i, j], _)| self.surfels.segment(i as usize, j as usize))
            .collect();
        let mut answers = self.visibility.visible(&segments)?.into_iter();
        Ok(facing
            .into_iter()
            .map(|faces| faces && answers.next() == Some(true))
            .collect())
    }
}

/// Whether each of two surfels lies in front of the other (2.2.4.1 of the report).
pub fn face(surfels: &Surfels, i: usize, j: usize) -> bool {
    let way = surfels.positions[j] - surfels.positions[i];
    surfels.normals[i].dot(way) > 0.0 && surfels.normals[j].dot(way) < 0.0
}
