//! Who sees whom: segments tested against the cells of the surfels.

mod counted;

pub use counted::Counted;

use crate::error::Result;

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
}
