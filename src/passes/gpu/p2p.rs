//! P2P on a device: surfel from surfel by the point kernel.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use wgpu::Features;

use crate::error::Result;
use crate::links::Rows;
use crate::octree::Octree;

use super::batch::{Batch, Pieces};
use super::wgsl::{P2P, P2P_ALONE};
use super::{Gpu, Pipeline, Table};

/// Receivers of an item, at most: of a subgroup, and of a single invocation.
const SHARED: u32 = 32;
const ALONE: u32 = 4;
/// Sources of a span, at most: sums are taken span by span, which keeps rounding small.
const SOURCES: u32 = 512;
/// Pairs that take as long as reading a texel.
const PAIRS: usize = 16;

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
        let mut work = Vec::new();
        // Level by level: facets of one level have no surfels in common.
        let mut levels = Vec::new();
        for level in 0..octree.depth() {
            let first_item = items.len() as u32;
            for target in octree.level(level) {
                let first_span = spans.len() as u32;
                let mut sources = 0;
                for span in rows.spans(octree, target) {
                    sources += span.len();
                    spans.extend(blocks(span.begin..span.end, SOURCES).map(|part| PointSpan {
                        begin: part.start,
                        end: part.end,
                        weight: span.weight,
                        padding: 0,
                    }));
                }
                if sources > 0 {
                    let facet = &octree.facets[target];
                    for part in blocks(facet.begin..facet.end, receivers) {
                        work.push(1 + sources * receivers as usize / PAIRS);
                        items.push(PointItem {
                            first: part.start,
                            end: part.end,
                            first_span,
                            end_span: spans.len() as u32,
                        });
                    }
                }
            }
            levels.push(first_item..items.len() as u32);
        }
        Ok(P2p {
            items: gpu.table("receivers of p2p", &items)?,
            spans: gpu.table("sources of p2p", &spans)?,
            pieces: Pieces::in_turn(gpu, &levels, |i| work[i as usize])?,
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
            irradiance.as_entire_binding(),
        ];
        batch.dispatch(&self.pipeline, &resources, &self.pieces)
    }
}

/// Cuts a range into parts of at most `size`.
fn blocks(range: Range<u32>, size: u32) -> impl Iterator<Item = Range<u32>> {
    let end = range.end;
    range
        .step_by(size as usize)
        .map(move |first| first..(first + size).min(end))
}
