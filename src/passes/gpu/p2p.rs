//! P2P on a device: surfel from surfel by the point kernel.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use wgpu::Features;

use crate::error::Result;
use crate::links::{Rows, Span};
use crate::octree::Octree;

use super::batch::{Batch, Pieces};
use super::wgsl::{P2P, P2P_ALONE};
use super::{Gpu, Pipeline, Table};

/// Receivers of an item, at most: of a subgroup, and of a single invocation.
const SHARED: u32 = 32;
const ALONE: u32 = 4;
/// Sources of a span, at most: sums are taken span by span, which keeps rounding small.
const SOURCES: u32 = 128;
/// Sources of an item, at most. In subgroups of four each takes up to six rounds of a loop, and Mesa's
/// llvmpipe leaves the loops of an invocation after 65,535 rounds in all, without a word.
const ROW: u32 = 1 << 13;
/// Pairs that take as long as reading a texel.
const PAIRS: u32 = 16;

/// A texel of the table of items: some receivers of one facet, and its row.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct PointItem {
    pub first: u32,
    pub end: u32,
    pub first_span: u32,
    pub end_span: u32,
}

/// A texel of the table of spans: sources that act with one weight.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct PointSpan {
    pub begin: u32,
    pub end: u32,
    pub weight: f32,
    pub padding: u32,
}

/// Rows of facets that act surfel by surfel.
pub struct P2p {
    items: Table,
    spans: Table,
    pieces: Pieces,
    pipeline: Pipeline,
}

impl P2p {
    /// Subgroups share their sources; a device that has none loads them for every invocation.
    pub fn new(gpu: &Gpu, octree: &Octree, rows: &Rows) -> Result<P2p> {
        let (shader, receivers) = if gpu.device.features().contains(Features::SUBGROUP) {
            (&P2P, SHARED)
        } else {
            (&P2P_ALONE, ALONE)
        };
        let mut items = Vec::new();
        let mut spans = Vec::new();
        let mut turns = Vec::new();
        // Facets of one level have no surfels in common, and the runs of a row take turns: no two
        // items of a turn add to the same surfel.
        for level in 0..octree.depth() {
            let mut open: Vec<Vec<PointItem>> = Vec::new();
            for target in octree.level(level) {
                let facet = &octree.facets[target];
                let row = rows.spans(octree, target);
                for (turn, run) in runs(&row).into_iter().enumerate() {
                    let first_span = spans.len() as u32;
                    spans.extend(run);
                    if turn == open.len() {
                        open.push(Vec::new());
                    }
                    open[turn].extend(blocks(facet.begin..facet.end, receivers).map(|part| {
                        PointItem {
                            first: part.start,
                            end: part.end,
                            first_span,
                            end_span: spans.len() as u32,
                        }
                    }));
                }
            }
            for turn in open {
                let first = items.len() as u32;
                items.extend(turn);
                turns.push(first..items.len() as u32);
            }
        }
        let each = |i: u32| {
            let item = &items[i as usize];
            let spans = &spans[item.first_span as usize..item.end_span as usize];
            let sources: u32 = spans.iter().map(|s: &PointSpan| s.end - s.begin).sum();
            let work = 1 + spans.len() + (receivers * sources / PAIRS) as usize;
            (work, item.first..item.end)
        };
        Ok(P2p {
            items: gpu.table("receivers of p2p", &items)?,
            spans: gpu.table("sources of p2p", &spans)?,
            pieces: Pieces::of(gpu, &turns, 1, each)?,
            pipeline: Pipeline::new(gpu, shader)?,
        })
    }

    /// Records the stage on the tables of surfels and of their radiosity.
    pub fn record(
        &self,
        batch: &mut Batch,
        surfels: &Table,
        radiosity: &Table,
        irradiance: &wgpu::Buffer,
    ) -> Result<()> {
        let resources = [
            self.items.binding(),
            self.spans.binding(),
            surfels.binding(),
            radiosity.binding(),
        ];
        batch.dispatch(&self.pipeline, &resources, &[(irradiance, 1)], &self.pieces)
    }
}

/// Cuts a row into runs of at most [`ROW`] sources, in spans of at most [`SOURCES`].
fn runs(row: &[Span]) -> Vec<Vec<PointSpan>> {
    let mut runs = Vec::new();
    let (mut run, mut sources) = (Vec::new(), 0);
    for span in row {
        for part in blocks(span.begin..span.end, SOURCES) {
            if sources + part.len() as u32 > ROW {
                runs.push(std::mem::take(&mut run));
                sources = 0;
            }
            sources += part.len() as u32;
            run.push(PointSpan {
                begin: part.start,
                end: part.end,
                weight: span.weight,
                padding: 0,
            });
        }
    }
    if !run.is_empty() {
        runs.push(run);
    }
    runs
}

/// Cuts a range into parts of at most `size`.
fn blocks(range: Range<u32>, size: u32) -> impl Iterator<Item = Range<u32>> {
    let end = range.end;
    range
        .step_by(size as usize)
        .map(move |first| first..(first + size).min(end))
}
