//! Segments against the cells, on a device.

use std::borrow::Cow;

use crate::error::Result;
use crate::visibility::{Occluders, Segment, Visibility, blocked};

use super::Gpu;
use super::answers::Answers;
use super::wgsl::VISIBILITY;

/// Tests segments on a device, which holds the hierarchy from the start.
pub struct GpuVisibility<'a> {
    occluders: &'a Occluders,
    answers: Answers,
}

impl<'a> GpuVisibility<'a> {
    pub fn new(gpu: &Gpu, occluders: &'a Occluders) -> Result<Self> {
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

impl Visibility for GpuVisibility<'_> {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        self.answers.visible(
            segments.len(),
            |range| Cow::Borrowed(&segments[range]),
            |segment| !blocked::<f32>(self.occluders, segment),
        )
    }
}
