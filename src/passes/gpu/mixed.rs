//! Mixed links on a device: P2M, M2L and L2P of one link at a time.

use std::cmp::Reverse;

use bytemuck::{Pod, Zeroable};

use crate::error::Result;
use crate::links::{Links, MIXED_ORDER, Rows};
use crate::octree::Octree;

use super::batch::{Batch, Pieces, VECTOR};
use super::stages::translation;
use super::turns::{ROUNDS, blocks, in_turns};
use super::wgsl::MIXED;
use super::{Gpu, Pipeline, Table};

/// Receivers of an item and sources of a part, at most.
const RECEIVERS: u32 = 256;
const SOURCES: u32 = 1024;

/// Two texels of the table of items: some receivers of a facet, and parts of its row.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct MixedItem {
    pub facet: u32,
    pub first: u32,
    pub end: u32,
    pub first_part: u32,
    pub end_part: u32,
    pub padding: [u32; 3],
}

/// A texel of the table of parts: some surfels of a source.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct MixedPart {
    pub source: u32,
    pub begin: u32,
    pub end: u32,
    pub weight: f32,
}

/// Mixed links, and the stage that works on them.
pub struct Mixed {
    items: Table,
    parts: Table,
    pieces: Pieces,
    pipeline: Pipeline,
}

impl Mixed {
    pub fn new(gpu: &Gpu, octree: &Octree, links: &Links) -> Result<Mixed> {
        let order = links.order().min(MIXED_ORDER);
        let mut parts: Vec<MixedPart> = Vec::new();
        let (mut items, turns) = in_turns(octree, &links.mixed, |target| {
            let facet = &octree.facets[target];
            let mut items = Vec::new();
            for run in runs(octree, &links.mixed, target) {
                let first_part = parts.len() as u32;
                parts.extend(run);
                let item = |receivers: std::ops::Range<u32>| MixedItem {
                    facet: target as u32,
                    first: receivers.start,
                    end: receivers.end,
                    first_part,
                    end_part: parts.len() as u32,
                    padding: [0; 3],
                };
                items.push(
                    blocks(facet.begin..facet.end, RECEIVERS)
                        .map(item)
                        .collect(),
                );
            }
            items
        });
        let each_surfel = 3 + (1 + order) * (2 + order);
        let work = |item: &MixedItem| {
            let parts = &parts[item.first_part as usize..item.end_part as usize];
            let sources: u32 = parts.iter().map(|p| p.end - p.begin).sum();
            let receivers = (item.end - item.first) as usize * parts.len();
            parts.len() * translation(order) + (sources as usize + receivers) * each_surfel
        };
        // Invocations side by side have as much to do; those that cannot be bound together stay apart.
        let together = (gpu.most_bound(VECTOR) / 2).max(1);
        for turn in &turns {
            let items = &mut items[turn.start as usize..turn.end as usize];
            items.sort_by_key(|i| (i.first as usize / together, Reverse(work(i))));
        }
        let each = |i: u32| {
            let item = &items[i as usize];
            (work(item), item.first..item.end)
        };
        Ok(Mixed {
            items: gpu.table("receivers of mixed links", &items)?,
            parts: gpu.table("sources of mixed links", &parts)?,
            pieces: Pieces::of(gpu, &turns, 1, each)?,
            pipeline: Pipeline::new(gpu, &MIXED.of_order(order, order))?,
        })
    }

    /// Records the stage on the tables of facets, surfels and their radiosity.
    pub fn record(
        &self,
        batch: &mut Batch,
        facets: &Table,
        surfels: &Table,
        radiosity: &Table,
        irradiance: &wgpu::Buffer,
    ) -> Result<()> {
        let tables = [facets, surfels, &self.items, &self.parts, radiosity].map(Table::binding);
        batch.dispatch(&self.pipeline, &tables, &[(irradiance, 1)], &self.pieces)
    }
}

/// Cuts the row of a facet into runs that take an invocation at most [`ROUNDS`].
fn runs(octree: &Octree, rows: &Rows, target: usize) -> Vec<Vec<MixedPart>> {
    let receivers = octree.facets[target].len().min(RECEIVERS as usize);
    let mut runs = vec![Vec::new()];
    let mut rounds = 0;
    for (source, weight) in rows.row(target) {
        let facet = &octree.facets[source];
        for part in blocks(facet.begin..facet.end, SOURCES) {
            let more = 1 + part.len() + receivers;
            if rounds + more > ROUNDS {
                runs.push(Vec::new());
                rounds = 0;
            }
            rounds += more;
            if let Some(run) = runs.last_mut() {
                run.push(MixedPart {
                    source: source as u32,
                    begin: part.start,
                    end: part.end,
                    weight,
                });
            }
        }
    }
    runs
}
