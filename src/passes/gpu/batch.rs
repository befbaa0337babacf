//! Dispatches of many stages in few submissions, and whether all of them ran.

use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use bytemuck::Pod;
use wgpu::{BindGroupEntry, BindingResource, BufferBinding, BufferSize, CommandEncoder};

use crate::error::{Error, Result};

use super::shader::{RANGE_BINDING, REPORTS_BINDING};
use super::{Gpu, Pace, Pipeline};

/// Work of one dispatch, in texels and vectors read or written: milliseconds on the slowest device.
const PIECE: usize = 1 << 20;

/// Runs stages on a device, one batch at a time.
pub struct Batches {
    gpu: Gpu,
    /// One number on the device: workgroups that reported.
    reports: wgpu::Buffer,
    state: Mutex<State>,
}

struct State {
    /// Workgroups dispatched so far; wraps like the number on the device.
    dispatched: u32,
    pace: Pace,
}

/// Stages that are being recorded.
pub struct Batch<'a> {
    batches: &'a Batches,
    state: MutexGuard<'a, State>,
    encoder: CommandEncoder,
    /// Work recorded and not yet submitted.
    work: usize,
}

/// Items of a stage, cut into dispatches that take no long time.
pub struct Pieces {
    /// First item and count of each piece.
    ranges: wgpu::Buffer,
    /// Bytes from one range to the next.
    stride: usize,
    pieces: Vec<Piece>,
}

struct Piece {
    count: u32,
    work: usize,
}

impl Pieces {
    /// Items that do not need each other. `work` tells how many texels and vectors an item reads
    /// and writes.
    pub fn new(gpu: &Gpu, items: u32, work: impl Fn(u32) -> usize) -> Result<Pieces> {
        Pieces::in_turn(gpu, std::slice::from_ref(&(0..items)), work)
    }

    /// The same in parts, each of which needs those before it.
    pub fn in_turn(gpu: &Gpu, parts: &[Range<u32>], work: impl Fn(u32) -> usize) -> Result<Pieces> {
        let cut = cut(parts, work);
        let stride = gpu.device.limits().min_uniform_buffer_offset_alignment as usize;
        let mut ranges = vec![0u32; cut.len().max(1) * stride / size_of::<u32>()];
        for (at, (range, _)) in ranges.chunks_mut(stride / size_of::<u32>()).zip(&cut) {
            at[..2].copy_from_slice(&[range.start, range.len() as u32]);
        }
        Ok(Pieces {
            ranges: gpu.uniform("ranges", &ranges)?,
            stride,
            pieces: cut
                .into_iter()
                .map(|(range, work)| Piece {
                    count: range.len() as u32,
                    work,
                })
                .collect(),
        })
    }

    fn range(&self, piece: usize) -> BindingResource<'_> {
        BindingResource::Buffer(BufferBinding {
            buffer: &self.ranges,
            offset: (piece * self.stride) as u64,
            size: BufferSize::new(8),
        })
    }
}

/// Cuts parts into pieces of about [`PIECE`] work; returns them with their work.
fn cut(parts: &[Range<u32>], work: impl Fn(u32) -> usize) -> Vec<(Range<u32>, usize)> {
    let mut pieces = Vec::new();
    for part in parts {
        let (mut first, mut sum) = (part.start, 0);
        for i in part.clone() {
            sum += work(i);
            if sum >= PIECE || i + 1 == part.end {
                pieces.push((first..i + 1, sum));
                (first, sum) = (i + 1, 0);
            }
        }
    }
    pieces
}

impl Batches {
    pub fn new(gpu: &Gpu) -> Result<Batches> {
        Ok(Batches {
            reports: gpu.storage("reports", size_of::<u32>())?,
            state: Mutex::new(State {
                dispatched: 0,
                pace: Pace::new(PIECE, PIECE << 10),
            }),
            gpu: gpu.clone(),
        })
    }

    /// Runs what `record` records, in order. It may still run when this returns.
    pub fn run(
        &self,
        what: &'static str,
        record: impl FnOnce(&mut Batch) -> Result<()>,
    ) -> Result<()> {
        self.watch(what, || {
            let mut batch = self.begin();
            record(&mut batch)?;
            batch.submit();
            Ok(())
        })
    }

    /// Runs what `record` records, waits for it, and returns the first `count` elements of
    /// `result`. Fails if any workgroup, of this batch or one before it, did not report.
    pub fn run_and_read<T: Pod>(
        &self,
        what: &'static str,
        result: &wgpu::Buffer,
        count: usize,
        record: impl FnOnce(&mut Batch) -> Result<()>,
    ) -> Result<Vec<T>> {
        let bytes = count * size_of::<T>();
        let staging = self
            .gpu
            .staging("result and reports", bytes + size_of::<u32>())?;
        self.watch(what, || {
            let mut batch = self.begin();
            record(&mut batch)?;
            let encoder = &mut batch.encoder;
            if bytes > 0 {
                encoder.copy_buffer_to_buffer(result, 0, &staging, 0, bytes as u64);
            }
            encoder.copy_buffer_to_buffer(&self.reports, 0, &staging, bytes as u64, 4);
            let Batch { state, encoder, .. } = batch;
            let words = (bytes + size_of::<u32>()) / size_of::<u32>();
            let read = |words: &[u32]| {
                let (reports, result) = words.split_last().unwrap_or((&0, &[]));
                (*reports, bytemuck::cast_slice(result).to_vec())
            };
            let (reports, result) = self
                .gpu
                .run_and_read(what, encoder, &staging, words, read)?;
            let missing = state.dispatched.wrapping_sub(reports);
            if missing != 0 {
                return Err(Error::Device(format!(
                    "{what}: {missing} workgroups did not report; the driver may have given up on \
                     a dispatch"
                )));
            }
            Ok(result)
        })
    }

    /// Runs what `record` records and waits for it. Fails like [`Self::run_and_read`].
    pub fn run_and_wait(
        &self,
        what: &'static str,
        record: impl FnOnce(&mut Batch) -> Result<()>,
    ) -> Result<()> {
        self.run_and_read::<u32>(what, &self.reports, 0, record)
            .map(|_| ())
    }

    /// Turns errors of the device into ours; what comes after a failure is judged for itself.
    fn watch<T>(&self, what: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        self.gpu.watch(what, work).inspect_err(|_| {
            let _ = self.gpu.watch(what, || {
                self.lock().dispatched = 0;
                self.gpu.queue.write_buffer(&self.reports, 0, &[0; 4]);
                Ok(())
            });
        })
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn begin(&self) -> Batch<'_> {
        Batch {
            batches: self,
            state: self.lock(),
            encoder: self.gpu.device.create_command_encoder(&Default::default()),
            work: 0,
        }
    }
}

impl Batch<'_> {
    /// Where copies are recorded.
    pub fn encoder(&mut self) -> &mut CommandEncoder {
        &mut self.encoder
    }

    /// Runs a stage over all its pieces, with `resources` bound at 0, 1, ...
    pub fn dispatch(
        &mut self,
        pipeline: &Pipeline,
        resources: &[BindingResource],
        pieces: &Pieces,
    ) -> Result<()> {
        for (k, piece) in pieces.pieces.iter().enumerate() {
            if self.work > 0 && self.work + piece.work > self.state.pace.size() {
                self.submit_and_learn()?;
            }
            let common = [
                (RANGE_BINDING, pieces.range(k)),
                (REPORTS_BINDING, self.batches.reports.as_entire_binding()),
            ];
            let entries: Vec<BindGroupEntry> = (0..)
                .zip(resources.iter().cloned())
                .chain(common)
                .map(|(binding, resource)| BindGroupEntry { binding, resource })
                .collect();
            let groups = pipeline.dispatch_entries(
                &self.batches.gpu,
                &mut self.encoder,
                &entries,
                piece.count,
            );
            self.state.dispatched = self.state.dispatched.wrapping_add(groups);
            self.work += piece.work;
        }
        Ok(())
    }

    /// Submits what is recorded and waits for it, so as to know how much to submit next time.
    fn submit_and_learn(&mut self) -> Result<()> {
        let gpu = &self.batches.gpu;
        let next = gpu.device.create_command_encoder(&Default::default());
        let encoder = std::mem::replace(&mut self.encoder, next);
        let start = Instant::now();
        gpu.queue.submit([encoder.finish()]);
        gpu.wait("stages")?;
        self.state.pace.took(self.work, start.elapsed());
        self.work = 0;
        Ok(())
    }

    fn submit(self) {
        self.batches.gpu.queue.submit([self.encoder.finish()]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_cover_all_items_in_order() {
        let parts = [0..1, 1..1000, 1000..1000, 1000..1007];
        let work = |i: u32| if i < 500 { PIECE / 100 } else { 3 * PIECE };
        let pieces = cut(&parts, work);
        let items: Vec<u32> = pieces.iter().flat_map(|(range, _)| range.clone()).collect();
        assert!(items.into_iter().eq(0..1007));
        for (range, sum) in &pieces {
            assert_eq!(*sum, range.clone().map(work).sum::<usize>());
            // The last item fills the piece.
            let others = range.start..range.end - 1;
            assert!(others.map(work).sum::<usize>() < PIECE);
            assert!(
                parts
                    .iter()
                    .any(|p| p.start <= range.start && range.end <= p.end)
            );
        }
        // The first part; small items by the hundred, the last of which take a large one along;
        // large ones alone.
        assert_eq!(pieces.len(), 1 + 5 + 499 + 7);
    }
}
