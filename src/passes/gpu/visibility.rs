//! Segments against the cells, on a device.

use std::borrow::Cow;
use std::ops::Deref;

use crate::error::Result;
use crate::visibility::{Occluders, Segment, Visibility, blocked};

use super::Gpu;
use super::answers::Answers;
use super::wgsl::VISIBILITY;

/// Tests segments on a device, which holds the hierarchy from the start.
pub struct GpuVisibility<O> {
    occluders: O,
    answers: Answers,
}

impl<O: Deref<Target = Occluders>> GpuVisibility<O> {
    /// `occluders` are borrowed or shared.
    pub fn new(gpu: &Gpu, occluders: O) -> Result<Self> {
        let tables = [
            gpu.table("nodes", &occluders.nodes)?,
            gpu.table("occluders", &occluders.occluders)?,
        ];
        Ok(GpuVisibility {
            occluders,
            answers: Answers::new(gpu, "visibility", &VISIBILITY, tables, None)?,
        })
    }
}

impl<O: Deref<Target = Occluders> + Sync> Visibility for GpuVisibility<O> {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        self.answers.visible(
            segments.len(),
            |range| Cow::Borrowed(&segments[range]),
            |segment| !blocked::<f32>(&self.occluders, segment),
        )
    }
}
