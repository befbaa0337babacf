//! Points between two points, on a device.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use crate::error::Result;
use crate::points::Surfels;
use crate::visibility::{LOOKUP, PointTest, PointTree, PointVisibility, of_facing, segment_of};

use super::Gpu;
use super::answers::Answers;
use super::wgsl::POINT_VISIBLE;

/// Decides pairs on a device, which holds the points from the start.
///
/// The answers are those of the CPU in f32, bit for bit, as long as the driver rounds every
/// operation; one that fuses products and sums may differ where the threshold is met that closely.
pub struct GpuPointVisibility<'a> {
    surfels: &'a Surfels,
    test: PointTest,
    points: PointTree,
    answers: Answers,
}

/// The parameters of a [`PointTest`] as the shader reads them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct PointTestUniform {
    pub threshold: f32,
    pub closest: u32,
    /// Δ²
    pub limit: f32,
    /// Entries of the look-up table a spacing.
    pub steps: f32,
    pub lookup: [f32; LOOKUP.next_multiple_of(4)],
}

impl From<&PointTest> for PointTestUniform {
    fn from(test: &PointTest) -> PointTestUniform {
        let mut lookup = [1.0; LOOKUP.next_multiple_of(4)];
        lookup[..LOOKUP].copy_from_slice(&test.lookup);
        PointTestUniform {
            threshold: test.threshold,
            closest: test.closest,
            limit: test.limit(),
            steps: test.steps(),
            lookup,
        }
    }
}

impl<'a> GpuPointVisibility<'a> {
    pub fn new(gpu: &Gpu, surfels: &'a Surfels, test: PointTest) -> Result<Self> {
        let points = PointTree::build(surfels, test.radius);
        let tables = [
            gpu.table("nodes", &points.nodes)?,
            gpu.table("points", &points.points)?,
        ];
        let uniform = gpu.uniform("test", &[PointTestUniform::from(&test)])?;
        let what = "point visibility";
        Ok(GpuPointVisibility {
            surfels,
            test,
            points,
            answers: Answers::new(gpu, what, &POINT_VISIBLE, tables, Some(uniform))?,
        })
    }
}

impl PointVisibility for GpuPointVisibility<'_> {
    fn visible(&self, pairs: &[[u32; 2]]) -> Result<Vec<bool>> {
        of_facing(self.surfels, pairs, |facing| {
            if self.test.is_open() {
                return Ok(vec![true; facing.len()]);
            }
            let segment = |&pair: &[u32; 2]| segment_of(self.surfels, pair);
            self.answers.visible(
                facing.len(),
                |range| facing[range].par_iter().map(segment).collect(),
                |segment| self.test.passes::<f32>(&self.points, segment),
            )
        })
    }
}
