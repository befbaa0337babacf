//! Dispatches of many stages in few submissions, and whether all of them ran.

use std::ops::Range;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use bytemuck::Pod;
use wgpu::{BindGroupEntry, BindingResource, BufferBinding, BufferSize, CommandEncoder};

use crate::error::{Error, Result};

use super::context::mib;
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
pub struct Batch<'a, 'e> {
    batches: &'a Batches,
    state: MutexGuard<'a, State>,
    encoder: &'e mut CommandEncoder,
    /// Work recorded and not yet submitted.
    work: usize,
    /// Whether the batch may be submitted in parts.
    in_parts: bool,
}

/// Items of a stage, cut into dispatches that take no long time and need no more of a buffer than
/// can be bound.
pub struct Pieces {
    /// First item, count and first bound target of each piece.
    ranges: wgpu::Buffer,
    /// Bytes from one range to the next.
    stride: usize,
    pieces: Vec<Piece>,
}

#[derive(Clone, Debug, PartialEq)]
struct Piece {
    items: Range<u32>,
    work: usize,
    /// What of the buffers is bound.
    targets: Range<u32>,
}

/// A buffer of light with so many vectors a target, of which each piece binds its part.
pub type Vectors<'a> = (&'a wgpu::Buffer, usize);

/// Bytes of a vector of light.
pub(super) const VECTOR: usize = 16;
/// Bound parts begin at multiples of so many targets: any number of bytes is then a multiple of
/// 256, which is as much as a device may ask for.
const ALIGNMENT: u32 = 16;

impl Pieces {
    /// Items that do not need each other, each of which is its own target, with one vector of light.
    /// `work` tells how many texels and vectors an item reads and writes.
    pub fn new(gpu: &Gpu, items: u32, work: impl Fn(u32) -> usize) -> Result<Pieces> {
        Pieces::of(gpu, &[0..items], 1, |i| (work(i), i..i + 1))
    }

    /// Items in parts, each of which needs those before it, with up to `vectors` of light a target.
    /// For an item `each` tells how many texels and vectors it reads and writes, and on which
    /// targets it works.
    pub fn of(
        gpu: &Gpu,
        parts: &[Range<u32>],
        vectors: usize,
        each: impl Fn(u32) -> (usize, Range<u32>),
    ) -> Result<Pieces> {
        let most = gpu.most_bound(vectors * VECTOR);
        let cut = |part: &Range<u32>| cut(part.clone(), most, &each);
        let pieces: Vec<Piece> = parts.iter().flat_map(cut).collect();
        if let Some(piece) = pieces.iter().find(|p| p.targets.len() > most) {
            return Err(Error::TooLarge(format!(
                "a stage needs {:.1} MiB at once, but this device binds {:.1} MiB",
                mib(piece.targets.len() * vectors * VECTOR),
                mib(gpu.most_bound(1))
            )));
        }
        let stride = gpu.device.limits().min_uniform_buffer_offset_alignment as usize;
        let mut ranges = vec![0u32; pieces.len().max(1) * stride / size_of::<u32>()];
        for (at, piece) in ranges.chunks_mut(stride / size_of::<u32>()).zip(&pieces) {
            let count = piece.items.len() as u32;
            at[..3].copy_from_slice(&[piece.items.start, count, piece.targets.start]);
        }
        Ok(Pieces {
            ranges: gpu.uniform("ranges", &ranges)?,
            stride,
            pieces,
        })
    }

    fn range(&self, piece: usize) -> BindingResource<'_> {
        BindingResource::Buffer(BufferBinding {
            buffer: &self.ranges,
            offset: (piece * self.stride) as u64,
            size: BufferSize::new(12),
        })
    }
}

impl Piece {
    /// The part of a buffer that it needs.
    fn part<'a>(&self, (buffer, vectors): Vectors<'a>) -> BindingResource<'a> {
        let bytes = |targets: usize| (targets * vectors * VECTOR) as u64;
        BindingResource::Buffer(BufferBinding {
            buffer,
            offset: bytes(self.targets.start as usize),
            size: BufferSize::new(bytes(self.targets.len())),
        })
    }
}

/// Cuts items into pieces of about [`PIECE`] work and, where items allow it, at most `most` targets.
fn cut(items: Range<u32>, most: usize, each: impl Fn(u32) -> (usize, Range<u32>)) -> Vec<Piece> {
    let mut pieces: Vec<Piece> = Vec::new();
    let mut full = true;
    for i in items {
        let (work, mut targets) = each(i);
        targets.start -= targets.start % ALIGNMENT;
        match pieces.last_mut() {
            Some(piece) if !full && hull(&piece.targets, &targets).len() <= most => {
                piece.items.end = i + 1;
                piece.work += work;
                piece.targets = hull(&piece.targets, &targets);
            }
            _ => pieces.push(Piece {
                items: i..i + 1,
                work,
                targets,
            }),
        }
        full = pieces.last().is_some_and(|piece| piece.work >= PIECE);
    }
    pieces
}

fn hull(a: &Range<u32>, b: &Range<u32>) -> Range<u32> {
    a.start.min(b.start)..a.end.max(b.end)
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
            let mut encoder = self.encoder();
            record(&mut self.begin(&mut encoder, true))?;
            self.gpu.queue.submit([encoder.finish()]);
            Ok(())
        })
    }

    /// Records into an encoder of the caller, who submits it in whole before anything else is run.
    pub fn record(
        &self,
        what: &'static str,
        encoder: &mut CommandEncoder,
        record: impl FnOnce(&mut Batch) -> Result<()>,
    ) -> Result<()> {
        self.watch(what, || record(&mut self.begin(encoder, false)))
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
            let mut encoder = self.encoder();
            let mut batch = self.begin(&mut encoder, true);
            record(&mut batch)?;
            let state = batch.state;
            if bytes > 0 {
                encoder.copy_buffer_to_buffer(result, 0, &staging, 0, bytes as u64);
            }
            encoder.copy_buffer_to_buffer(&self.reports, 0, &staging, bytes as u64, 4);
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

    fn encoder(&self) -> CommandEncoder {
        self.gpu.device.create_command_encoder(&Default::default())
    }

    fn begin<'a, 'e>(&'a self, encoder: &'e mut CommandEncoder, in_parts: bool) -> Batch<'a, 'e> {
        Batch {
            batches: self,
            state: self.lock(),
            encoder,
            work: 0,
            in_parts,
        }
    }
}

impl Batch<'_, '_> {
    /// Where copies are recorded.
    pub fn encoder(&mut self) -> &mut CommandEncoder {
        self.encoder
    }

    /// Runs a stage over all its pieces, with `resources` bound at 0, 1, ..., and after them the
    /// parts of `vectors` that a piece needs.
    pub fn dispatch(
        &mut self,
        pipeline: &Pipeline,
        resources: &[BindingResource],
        vectors: &[Vectors],
        pieces: &Pieces,
    ) -> Result<()> {
        for (k, piece) in pieces.pieces.iter().enumerate() {
            let full = self.work > 0 && self.work + piece.work > self.state.pace.size();
            if full && self.in_parts {
                self.submit_and_learn()?;
            }
            let parts = vectors.iter().map(|&vectors| piece.part(vectors));
            let common = [
                (RANGE_BINDING, pieces.range(k)),
                (REPORTS_BINDING, self.batches.reports.as_entire_binding()),
            ];
            let entries: Vec<BindGroupEntry> = (0..)
                .zip(resources.iter().cloned().chain(parts))
                .chain(common)
                .map(|(binding, resource)| BindGroupEntry { binding, resource })
                .collect();
            let groups = pipeline.dispatch_entries(
                &self.batches.gpu,
                self.encoder,
                &entries,
                piece.items.len() as u32,
            );
            self.state.dispatched = self.state.dispatched.wrapping_add(groups);
            self.work += piece.work;
        }
        Ok(())
    }

    /// Submits what is recorded and waits for it, so as to know how much to submit next time.
    fn submit_and_learn(&mut self) -> Result<()> {
        let gpu = &self.batches.gpu;
        let encoder = std::mem::replace(self.encoder, self.batches.encoder());
        let start = Instant::now();
        gpu.queue.submit([encoder.finish()]);
        gpu.wait("stages")?;
        self.state.pace.took(self.work, start.elapsed());
        self.work = 0;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Items, and pieces that each hold at least one of them, in order and without a gap.
    fn check(pieces: &[Piece], items: u32) {
        let all = pieces.iter().flat_map(|piece| piece.items.clone());
        assert!(all.eq(0..items));
    }

    #[test]
    fn pieces_are_cut_by_work() {
        let work = |i: u32| if i < 500 { PIECE / 100 } else { 3 * PIECE };
        let pieces = cut(0..1000, usize::MAX, |i| (work(i), i..i + 1));
        check(&pieces, 1000);
        for piece in &pieces {
            let items = piece.items.clone();
            assert_eq!(piece.work, items.clone().map(work).sum::<usize>());
            // The last item fills the piece.
            let others = items.start..items.end - 1;
            assert!(others.map(work).sum::<usize>() < PIECE);
        }
        // Small items by the hundred, the last of which take a large one along; large ones alone.
        assert_eq!(pieces.len(), 5 + 499);
        assert!(cut(0..0, 1, |_| (1, 0..1)).is_empty());
    }

    #[test]
    fn pieces_are_cut_by_what_can_be_bound() {
        let targets = |i: u32| (i * 3)..(i * 3 + 40);
        let pieces = cut(0..1000, 100, |i| (1, targets(i)));
        check(&pieces, 1000);
        for piece in &pieces {
            assert!(piece.targets.len() <= 100);
            assert_eq!(piece.targets.start % ALIGNMENT, 0);
            for i in piece.items.clone() {
                assert_eq!(hull(&piece.targets, &targets(i)), piece.targets);
            }
        }
        assert!(pieces.len() < 200);
    }
}
