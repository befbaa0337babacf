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
        of_facing(self.surfels, pairs, |facing| {
            let segment = |&[i, j]: &[u32; 2]| self.surfels.segment(i as usize, j as usize);
            let segments: Vec<Segment> = facing.iter().map(segment).collect();
            self.visibility.visible(&segments)
        })
    }
}

/// Decides those of the pairs that face each other; the others do not see each other.
pub fn of_facing(
    surfels: &Surfels,
    pairs: &[[u32; 2]],
    decide: impl FnOnce(&[[u32; 2]]) -> Result<Vec<bool>>,
) -> Result<Vec<bool>> {
    let faces: Vec<bool> = pairs
        .iter()
        .map(|&[i, j]| face(surfels, i as usize, j as usize))
        .collect();
    let facing = pairs.iter().zip(&faces).filter(|&(_, &faces)| faces);
    let facing: Vec<[u32; 2]> = facing.map(|(&pair, _)| pair).collect();
    let mut answers = decide(&facing)?.into_iter();
    Ok(faces
        .into_iter()
        .map(|faces| faces && answers.next() == Some(true))
        .collect())
}

/// Whether each of two surfels lies in front of the other (2.2.4.1 of the report).
pub fn face(surfels: &Surfels, i: usize, j: usize) -> bool {
    let way = surfels.positions[j] - surfels.positions[i];
    surfels.normals[i].dot(way) > 0.0 && surfels.normals[j].dot(way) < 0.0
}
