//! Segments against the cells, on a device.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use wgpu::BindingResource;

use crate::error::{Error, Result};
use crate::visibility::{Occluders, Segment, Visibility};

use super::wgsl::VISIBILITY;
use super::{Gpu, Pace, Pipeline, Table};

/// Segments of the first piece: few enough for the slowest device.
const FIRST: usize = 2048;
/// Segments of the largest piece: 32 MiB.
const MOST: usize = 1 << 20;

// What the shader answers, apart from 0, which stands for "not written".
const BLOCKED: u32 = 1;
const VISIBLE: u32 = 2;

/// Tests segments on a device, which holds the hierarchy from the start.
pub struct GpuVisibility {
    gpu: Gpu,
    nodes: Table,
    occluders: Table,
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

impl GpuVisibility {
    pub fn new(gpu: &Gpu, occluders: &Occluders) -> Result<GpuVisibility> {
        let most = MOST.min(gpu.most_bound(size_of::<Segment>()));
        let batch = Batch {
            pace: Pace::new(FIRST, most),
            segments: gpu.storage("segments", most * size_of::<Segment>())?,
            answers: gpu.storage("answers", most * size_of::<u32>())?,
            staging: gpu.staging("answers read back", most * size_of::<u32>())?,
        };
        Ok(GpuVisibility {
            nodes: gpu.table("nodes", &occluders.nodes)?,
            occluders: gpu.table("occluders", &occluders.occluders)?,
            pipeline: Pipeline::new(gpu, &VISIBILITY)?,
            batch: Mutex::new(batch),
            gpu: gpu.clone(),
        })
    }

    /// Appends the answers of one piece to `visible`.
    fn piece(&self, batch: &Batch, segments: &[Segment], visible: &mut Vec<bool>) -> Result<()> {
        let gpu = &self.gpu;
        gpu.queue
            .write_buffer(&batch.segments, 0, bytemuck::cast_slice(segments));
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let answer_bytes = (segments.len() * size_of::<u32>()) as u64;
        encoder.clear_buffer(&batch.answers, 0, Some(answer_bytes));
        let resources = [
            self.nodes.binding(),
            self.occluders.binding(),
            part(&batch.segments, size_of_val(segments)),
            batch.answers.as_entire_binding(),
        ];
        self.pipeline
            .dispatch(gpu, &mut encoder, &resources, segments.len() as u32);
        encoder.copy_buffer_to_buffer(&batch.answers, 0, &batch.staging, 0, answer_bytes);
        let unanswered = gpu.run_and_read(
            "visibility",
            encoder,
            &batch.staging,
            segments.len(),
            |answers: &[u32]| {
                visible.extend(answers.iter().map(|&answer| answer == VISIBLE));
                let answered = answers.iter().filter(|a| [BLOCKED, VISIBLE].contains(a));
                answers.len() - answered.count()
            },
        )?;
        match unanswered {
            0 => Ok(()),
            n => Err(Error::Device(format!(
                "visibility: {n} of {} segments got no answer; \
                 the driver may have given up on a dispatch",
                segments.len()
            ))),
        }
    }
}

impl Visibility for GpuVisibility {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        let mut batch = self.batch.lock().unwrap_or_else(PoisonError::into_inner);
        let mut visible = Vec::with_capacity(segments.len());
        while visible.len() < segments.len() {
            let rest = &segments[visible.len()..];
            let piece = &rest[..rest.len().min(batch.pace.size())];
            let start = Instant::now();
            self.gpu
                .watch("visibility", || self.piece(&batch, piece, &mut visible))?;
            batch.pace.took(piece.len(), start.elapsed());
        }
        Ok(visible)
    }
}

/// The first `bytes` of a buffer; the shader reads the length of its arrays from it.
pub(super) fn part(buffer: &wgpu::Buffer, bytes: usize) -> BindingResource<'_> {
    BindingResource::Buffer(wgpu::BufferBinding {
        buffer,
        offset: 0,
        size: wgpu::BufferSize::new(bytes as u64),
    })
}
