//! P2P on a device: surfel from surfel by the point kernel.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use wgpu::Features;

use crate::error::Result;
use crate::links::{Rows, Span};
use crate::octree::Octree;

use super::batch::{Batch, Pieces};
use super::turns::{ROUNDS, blocks, in_turns};
use super::wgsl::{P2P, P2P_ALONE};
use super::{Gpu, Pipeline, Table};

/// Receivers of an item, at most: of a subgroup, and of a single invocation.
const SHARED: u32 = 32;
const ALONE: u32 = 4;
/// Sources of a span, at most: sums are taken span by span, which keeps rounding small.
const SOURCES: u32 = 128;
/// Sources of an item, at most. In subgroups of four each takes up to six rounds, which all lanes
/// take together.
const ROW: u32 = 2 * ROUNDS as u32;
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
        let mut spans = Vec::new();
        let (items, turns) = in_turns(octree, rows, |target| {
            let facet = &octree.facets[target];
            let mut items = Vec::new();
            for run in runs(&rows.spans(octree, target)) {
                let first_span = spans.len() as u32;
                spans.extend(run);
                let item = |part: Range<u32>| PointItem {
                    first: part.start,
                    end: part.end,
                    first_span,
                    end_span: spans.len() as u32,
                };
                items.push(
                    blocks(facet.begin..facet.end, receivers)
                        .map(item)
                        .collect(),
                );
            }
            items
        });
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
