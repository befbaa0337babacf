//! Who sees whom: segments tested against the cells of the surfels, or, as in the report, against
//! the points near them.

mod bvh;
mod counted;
mod pairs;
mod point_visible;
mod seen;
mod segment;
mod stored;
mod wide;

use std::marker::PhantomData;

use rayon::prelude::*;

use crate::error::Result;
use crate::math::Real;

pub use bvh::{Node, Occluder, Occluders};
pub use counted::Counted;
pub use pairs::{BySegment, PointVisibility, face, of_facing};
pub use point_visible::{
    CpuPointVisibility, LOOKUP, MAX_CLOSEST, PointOccluder, PointTest, PointTree, segment_of,
};
pub use seen::Seen;
pub use segment::{BEHIND, EDGE, Hit, RIM, TOGETHER, blocked, first_hit, meeting};
pub(crate) use stored::Shape;
pub use wide::WideNode;

/// Stands for "no surfel" in [`Segment`]'s skip fields.
pub const NO_SURFEL: u32 = u32::MAX;

/// An open segment between two places, relative to the surfels' origin.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Segment {
    pub from: [f32; 3],
    /// Index of a surfel whose cell does not block (where the segment starts), or [`NO_SURFEL`].
    pub skip_from: u32,
    pub to: [f32; 3],
    /// The same for the end.
    pub skip_to: u32,
}

/// Tests segments in batches, on the CPU or on a device, with the same answers.
pub trait Visibility: Sync {
    /// One entry a segment: true where no cell (other than the two excluded) is met.
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>>;

    /// Nothing can be in the way: all segments are visible, and none need be tested.
    fn is_open(&self) -> bool {
        false
    }
}

impl<V: Visibility + ?Sized> Visibility for &V {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        (**self).visible(segments)
    }

    fn is_open(&self) -> bool {
        (**self).is_open()
    }
}

/// Answers cut into rows of these lengths, one row for each of whoever asked.
pub(crate) fn in_rows(mut answers: &[bool], lengths: impl Iterator<Item = usize>) -> Vec<&[bool]> {
    lengths
        .map(|length| answers.split_off(..length).unwrap_or_default())
        .collect()
}

/// Tests on all threads of the current rayon pool, in `T`: f64 is the reference, f32 the product.
pub struct CpuVisibility<'a, T> {
    occluders: &'a Occluders,
    real: PhantomData<T>,
}

impl<'a, T: Real> CpuVisibility<'a, T> {
    pub fn new(occluders: &'a Occluders) -> Self {
        CpuVisibility {
            occluders,
            real: PhantomData,
        }
    }
}

impl<T: Real> Visibility for CpuVisibility<'_, T> {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        Ok(segments
            .par_iter()
            .with_min_len(64)
            .map(|segment| !blocked::<T>(self.occluders, segment))
            .collect())
    }
}

/// Everybody sees everybody.
pub struct NothingInTheWay;

impl Visibility for NothingInTheWay {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        Ok(vec![true; segments.len()])
    }

    fn is_open(&self) -> bool {
        true
    }
}
