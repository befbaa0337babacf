//! Points between two points, on a device.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::points::Surfels;
use crate::visibility::{
    LOOKUP, PointTest, PointVisibility, Points, Segment, of_facing, segment_of,
};

use super::visibility::part;
use super::wgsl::POINT_VISIBLE;
use super::{Gpu, Pace, Pipeline, Table};

/// Pairs of the first piece: few enough for the slowest device.
const FIRST: usize = 2048;
/// Pairs of the largest piece: 32 MiB.
const MOST: usize = 1 << 20;

// What the shader answers, apart from 0, which stands for "not written".
const BLOCKED: u32 = 1;
const VISIBLE: u32 = 2;

/// Decides pairs on a device, which holds the points from the start.
///
/// The answers are those of the CPU in f32, bit for bit, as long as the driver rounds every
/// operation; one that fuses products and sums may differ where the threshold is met that closely.
pub struct GpuPointVisibility<'a> {
    gpu: Gpu,
    surfels: &'a Surfels,
    open: bool,
    nodes: Table,
    points: Table,
    test: wgpu::Buffer,
    pipeline: Pipeline,
    /// One batch at a time.
    batch: Mutex<Batch>,
}

struct Batch {
    pace: Pace,
    segments: wgpu::Buffer,
    answers: wgpu::Buffer,
    staging: wgpu::Buffer,
}

/// The parameters as the shader reads them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct Test {
    pub threshold: f32,
    pub closest: u32,
    /// Δ²
    pub limit: f32,
    /// Entries of the look-up table a spacing.
    pub steps: f32,
    pub lookup: [f32; LOOKUP.next_multiple_of(4)],
}

impl From<&PointTest> for Test {
    fn from(test: &PointTest) -> Test {
        let mut lookup = [1.0; LOOKUP.next_multiple_of(4)];
        lookup[..LOOKUP].copy_from_slice(&test.lookup);
        Test {
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
        let points = Points::build(surfels, test.radius);
        let most = MOST.min(gpu.most_bound(size_of::<Segment>()));
        let batch = Batch {
            pace: Pace::new(FIRST, most),
            segments: gpu.storage("segments", most * size_of::<Segment>())?,
            answers: gpu.storage("answers", most * size_of::<u32>())?,
            staging: gpu.staging("answers read back", most * size_of::<u32>())?,
        };
        Ok(GpuPointVisibility {
            surfels,
            open: test.is_open(),
            nodes: gpu.table("nodes", &points.nodes)?,
            points: gpu.table("points", &points.points)?,
            test: gpu.uniform("test", &[Test::from(&test)])?,
            pipeline: Pipeline::new(gpu, &POINT_VISIBLE)?,
            batch: Mutex::new(batch),
            gpu: gpu.clone(),
        })
    }

    /// Appends the answers of one piece to `visible`.
    fn piece(&self, batch: &Batch, pairs: &[[u32; 2]], visible: &mut Vec<bool>) -> Result<()> {
        let gpu = &self.gpu;
        let segment = |&pair: &[u32; 2]| segment_of(self.surfels, pair);
        let segments: Vec<Segment> = pairs.par_iter().map(segment).collect();
        gpu.queue
            .write_buffer(&batch.segments, 0, bytemuck::cast_slice(&segments));
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let answer_bytes = (pairs.len() * size_of::<u32>()) as u64;
        encoder.clear_buffer(&batch.answers, 0, Some(answer_bytes));
        let resources = [
            self.nodes.binding(),
            self.points.binding(),
            self.test.as_entire_binding(),
            part(&batch.segments, size_of_val(&segments[..])),
            batch.answers.as_entire_binding(),
        ];
        self.pipeline
            .dispatch(gpu, &mut encoder, &resources, pairs.len() as u32);
        encoder.copy_buffer_to_buffer(&batch.answers, 0, &batch.staging, 0, answer_bytes);
        let unanswered = gpu.run_and_read(
            "point visibility",
            encoder,
            &batch.staging,
            pairs.len(),
            |answers: &[u32]| {
                visible.extend(answers.iter().map(|&answer| answer == VISIBLE));
                let answered = answers.iter().filter(|a| [BLOCKED, VISIBLE].contains(a));
                answers.len() - answered.count()
            },
        )?;
        match unanswered {
            0 => Ok(()),
            n => Err(Error::Device(format!(
                "point visibility: {n} of {} pairs got no answer; \
                 the driver may have given up on a dispatch",
                pairs.len()
            ))),
        }
    }

    fn in_pieces(&self, pairs: &[[u32; 2]]) -> Result<Vec<bool>> {
        if self.open {
            return Ok(vec![true; pairs.len()]);
        }
        let mut batch = self.batch.lock().unwrap_or_else(PoisonError::into_inner);
        let mut visible = Vec::with_capacity(pairs.len());
        while visible.len() < pairs.len() {
            let rest = &pairs[visible.len()..];
            let piece = &rest[..rest.len().min(batch.pace.size())];
            let start = Instant::now();
            self.gpu.watch("point visibility", || {
                self.piece(&batch, piece, &mut visible)
            })?;
            batch.pace.took(piece.len(), start.elapsed());
        }
        Ok(visible)
    }
}

impl PointVisibility for GpuPointVisibility<'_> {
    fn visible(&self, pairs: &[[u32; 2]]) -> Result<Vec<bool>> {
        of_facing(self.surfels, pairs, |facing| self.in_pieces(facing))
    }
}
