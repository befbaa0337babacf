//! Stages that say of segments whether they are free, piece by piece.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use rayon::prelude::*;
use wgpu::BindingResource;

use crate::error::{Error, Result};
use crate::visibility::Segment;

use super::{Gpu, Pace, Pipeline, Shader, Table};

/// Segments of the first piece: few enough for the slowest device.
const FIRST: usize = 2048;
/// Segments of the largest piece: 32 MiB.
const MOST: usize = 1 << 20;

// What the shader answers, apart from 0, which stands for "not written".
const BLOCKED: u32 = 1;
const VISIBLE: u32 = 2;
/// The driver left a loop before its end.
const UNKNOWN: u32 = 3;

/// A stage with `shared/bvh.wgsl`, and what it reads.
pub(super) struct Answers {
    gpu: Gpu,
    what: &'static str,
    /// The nodes and what they hold.
    tables: [Table; 2],
    /// Parameters, bound after the answers.
    uniform: Option<wgpu::Buffer>,
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

impl Answers {
    /// `what` names it in errors.
    pub fn new(
        gpu: &Gpu,
        what: &'static str,
        shader: &Shader,
        tables: [Table; 2],
        uniform: Option<wgpu::Buffer>,
    ) -> Result<Answers> {
        let most = MOST.min(gpu.most_bound(size_of::<Segment>()));
        let batch = Batch {
            pace: Pace::new(FIRST, most),
            segments: gpu.storage("segments", most * size_of::<Segment>())?,
            answers: gpu.storage("answers", most * size_of::<u32>())?,
            staging: gpu.staging("answers read back", most * size_of::<u32>())?,
        };
        Ok(Answers {
            what,
            tables,
            uniform,
            pipeline: Pipeline::new(gpu, shader)?,
            batch: Mutex::new(batch),
            gpu: gpu.clone(),
        })
    }

    /// One entry for each of `count` segments, which `segments` gives in pieces: true where it is
    /// free. `on_cpu` says the same of the few that are too long a way for the driver.
    pub fn visible<'a>(
        &self,
        count: usize,
        segments: impl Fn(Range<usize>) -> Cow<'a, [Segment]>,
        on_cpu: impl Fn(&Segment) -> bool + Sync,
    ) -> Result<Vec<bool>> {
        let mut batch = self.batch.lock().unwrap_or_else(PoisonError::into_inner);
        let mut visible = Vec::with_capacity(count);
        while visible.len() < count {
            let first = visible.len();
            let start = Instant::now();
            let piece = segments(first..count.min(first + batch.pace.size()));
            let work = || self.piece(&batch, &piece, &mut visible);
            let unknown = self.gpu.watch(self.what, work)?;
            batch.pace.took(piece.len(), start.elapsed());
            let answer = |&k: &usize| (first + k, on_cpu(&piece[k]));
            let answers: Vec<_> = unknown.par_iter().map(answer).collect();
            for (k, answer) in answers {
                visible[k] = answer;
            }
        }
        Ok(visible)
    }

    /// Appends the answers of one piece to `visible`, and returns which segments have none yet.
    fn piece(
        &self,
        batch: &Batch,
        segments: &[Segment],
        visible: &mut Vec<bool>,
    ) -> Result<Vec<usize>> {
        let gpu = &self.gpu;
        gpu.queue
            .write_buffer(&batch.segments, 0, bytemuck::cast_slice(segments));
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let answer_bytes = (segments.len() * size_of::<u32>()) as u64;
        encoder.clear_buffer(&batch.answers, 0, Some(answer_bytes));
        let [nodes, items] = &self.tables;
        let mut resources = vec![
            nodes.binding(),
            items.binding(),
            part(&batch.segments, size_of_val(segments)),
            batch.answers.as_entire_binding(),
        ];
        resources.extend(self.uniform.iter().map(|u| u.as_entire_binding()));
        self.pipeline
            .dispatch(gpu, &mut encoder, &resources, segments.len() as u32);
        encoder.copy_buffer_to_buffer(&batch.answers, 0, &batch.staging, 0, answer_bytes);
        let unanswered: Vec<(usize, u32)> = gpu.run_and_read(
            self.what,
            encoder,
            &batch.staging,
            segments.len(),
            |answers: &[u32]| {
                visible.extend(answers.iter().map(|&answer| answer == VISIBLE));
                let answers = answers.iter().copied().enumerate();
                answers
                    .filter(|(_, answer)| ![BLOCKED, VISIBLE].contains(answer))
                    .collect()
            },
        )?;
        match unanswered.iter().filter(|&&(_, a)| a != UNKNOWN).count() {
            0 => Ok(unanswered.into_iter().map(|(k, _)| k).collect()),
            n => Err(Error::Device(format!(
                "{}: {n} of {} segments got no answer; \
                 the driver may have given up on a dispatch",
                self.what,
                segments.len()
            ))),
        }
    }
}

/// The first `bytes` of a buffer; the shader reads the length of its arrays from it.
fn part(buffer: &wgpu::Buffer, bytes: usize) -> BindingResource<'_> {
    BindingResource::Buffer(wgpu::BufferBinding {
        buffer,
        offset: 0,
        size: wgpu::BufferSize::new(bytes as u64),
    })
}
