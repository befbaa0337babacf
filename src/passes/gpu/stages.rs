//! The stages of the operator on a device: the twins of `passes::cpu`.

use std::cmp::Reverse;
use std::ops::Range;

use bytemuck::{Pod, Zeroable};

use crate::error::Result;
use crate::links::{Links, Rows};
use crate::octree::{self, Octree};
use crate::points::Surfels;

use super::batch::{Batch, Pieces};
use super::wgsl::{L2L, L2P, M2L, M2M, NEAR_FIELD, P2M};
use super::{Gpu, P2p, Pipeline, Table};

/// Coefficients of an expansion, each a vector of red, green, blue and 0: three of order zero,
/// nine of order one, row by row, and one more (see `expansion::Moments` and `expansion::Local`).
pub const COEFFICIENTS: usize = 13;
/// Bytes of a vector.
const VECTOR: usize = 16;

/// Two texels of the table of surfels.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Surfel {
    pub position: [f32; 3],
    pub area: f32,
    pub normal: [f32; 3],
    pub padding: f32,
}

/// Three texels of the table of facets.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Facet {
    pub centre: [f32; 3],
    pub scale: f32,
    pub begin: u32,
    pub end: u32,
    pub first_child: u32,
    pub child_count: u32,
    pub parent: u32,
    pub padding: [u32; 3],
}

/// A link, half a texel.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Link {
    pub source: u32,
    pub weight: f32,
}

/// A texel of a table of rows.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Row {
    target: u32,
    /// Links of the first kind are `begin..middle`, of the second `middle..end`.
    begin: u32,
    middle: u32,
    end: u32,
}

/// The stages on one set of surfels and links, which stay on the device.
pub struct Stages {
    facets: Table,
    surfels: Table,
    far: Lists,
    near: Lists,
    points: P2p,
    /// [`COEFFICIENTS`] vectors a facet.
    pub moments: wgpu::Buffer,
    moments_table: Table,
    /// [`COEFFICIENTS`] vectors a facet.
    pub locals: wgpu::Buffer,
    radiosity: Table,
    p2m: Pipeline,
    m2m: Pipeline,
    m2l: Pipeline,
    l2l: Pipeline,
    l2p: Pipeline,
    near_field: Pipeline,
    all_facets: Pieces,
    upward: Pieces,
    downward: Pieces,
}

/// Links sorted by the length of their rows, so that invocations side by side have as much to do.
/// (In the octree's order those of eight lanes wait for the longest of them half of the time.)
struct Lists {
    rows: Table,
    links: Table,
    pieces: Pieces,
}

impl Lists {
    /// Rows with links of one or two kinds; `loads` is the work of one link of either.
    fn new(gpu: &Gpu, what: &str, kinds: &[(&Rows, usize)]) -> Result<Lists> {
        let targets = kinds[0].0.offsets.len() - 1;
        let length = |rows: &Rows, t: u32| {
            (rows.offsets[t as usize + 1] - rows.offsets[t as usize]) as usize
        };
        let work = |t: u32| -> usize {
            let links = kinds.iter().map(|&(rows, loads)| length(rows, t) * loads);
            2 * COEFFICIENTS + links.sum::<usize>()
        };
        let mut order: Vec<u32> = (0..targets as u32).collect();
        order.sort_by_key(|&t| Reverse(work(t)));
        let mut links = Vec::with_capacity(kinds.iter().map(|k| k.0.len()).sum::<usize>() + 1);
        let mut rows = Vec::with_capacity(targets);
        for &target in &order {
            let mut bounds = [links.len() as u32; 3];
            for (k, end) in bounds[1..].iter_mut().enumerate() {
                if let Some((kind, _)) = kinds.get(k) {
                    links.extend(kind.row(target as usize).map(|(source, weight)| Link {
                        source: source as u32,
                        weight,
                    }));
                }
                *end = links.len() as u32;
            }
            let [begin, middle, end] = bounds;
            rows.push(Row {
                target,
                begin,
                middle,
                end,
            });
        }
        // Two links a texel.
        links.resize(links.len().next_multiple_of(2), Link::zeroed());
        let texels: &[[u32; 4]] = bytemuck::cast_slice(&links);
        Ok(Lists {
            rows: gpu.table(what, &rows)?,
            links: gpu.table(what, texels)?,
            pieces: Pieces::new(gpu, targets as u32, |k| work(order[k as usize]))?,
        })
    }
}

impl Stages {
    /// `surfels` are those in the octree's order.
    pub fn new(gpu: &Gpu, surfels: &Surfels, octree: &Octree, links: &Links) -> Result<Stages> {
        let n = octree.facets.len();
        let facets: Vec<Facet> = octree.facets.iter().map(facet).collect();
        let all: Vec<Surfel> = (0..surfels.len())
            .map(|i| Surfel {
                position: surfels.positions[i].to_array(),
                area: surfels.areas[i],
                normal: surfels.normals[i].to_array(),
                padding: 0.0,
            })
            .collect();
        let level = |level: usize| {
            let range = octree.level(level);
            range.start as u32..range.end as u32
        };
        let levels: Vec<Range<u32>> = (0..octree.depth()).map(level).collect();
        let from_below: Vec<Range<u32>> = levels.iter().rev().skip(1).cloned().collect();
        let expansion = |_: u32| 4 * COEFFICIENTS;
        Ok(Stages {
            facets: gpu.table("facets", &facets)?,
            surfels: gpu.table("surfels", &all)?,
            far: Lists::new(
                gpu,
                "far links",
                &[(&links.m2l[1], COEFFICIENTS + 2), (&links.sampled, 2)],
            )?,
            near: Lists::new(gpu, "near links", &[(&links.near, 2)])?,
            points: P2p::new(gpu, octree, &links.p2p)?,
            moments: gpu.storage("moments", n * COEFFICIENTS * VECTOR)?,
            moments_table: gpu.empty_table("moments", n * COEFFICIENTS)?,
            locals: gpu.storage("local expansions", n * COEFFICIENTS * VECTOR)?,
            radiosity: gpu.empty_table("radiosity", surfels.len())?,
            p2m: Pipeline::new(gpu, &P2M)?,
            m2m: Pipeline::new(gpu, &M2M)?,
            m2l: Pipeline::new(gpu, &M2L)?,
            l2l: Pipeline::new(gpu, &L2L)?,
            l2p: Pipeline::new(gpu, &L2P)?,
            near_field: Pipeline::new(gpu, &NEAR_FIELD)?,
            all_facets: Pieces::new(gpu, n as u32, expansion)?,
            upward: Pieces::in_turn(gpu, &from_below, expansion)?,
            downward: Pieces::in_turn(gpu, &levels[1..], expansion)?,
        })
    }

    /// Takes the radiosity for [`Self::p2m`], [`Self::p2p`] and [`Self::near_field`] from a field.
    pub fn take(&self, batch: &mut Batch, radiosity: &wgpu::Buffer) {
        self.radiosity.copy_from(radiosity, batch.encoder());
    }

    /// P2M: moments of the leaves; other facets get zeros.
    pub fn p2m(&self, batch: &mut Batch) -> Result<()> {
        let resources = [
            self.facets.binding(),
            self.surfels.binding(),
            self.radiosity.binding(),
            self.moments.as_entire_binding(),
        ];
        batch.dispatch(&self.p2m, &resources, &self.all_facets)
    }

    /// M2M: moments of the inner facets, from the leaves up.
    pub fn m2m(&self, batch: &mut Batch) -> Result<()> {
        let resources = [self.facets.binding(), self.moments.as_entire_binding()];
        batch.dispatch(&self.m2m, &resources, &self.upward)
    }

    /// M2L: local expansions from the moments by the far links.
    pub fn m2l(&self, batch: &mut Batch) -> Result<()> {
        self.moments_table.copy_from(&self.moments, batch.encoder());
        let resources = [
            self.facets.binding(),
            self.far.rows.binding(),
            self.far.links.binding(),
            self.moments_table.binding(),
            self.locals.as_entire_binding(),
        ];
        batch.dispatch(&self.m2l, &resources, &self.far.pieces)
    }

    /// L2L: adds local expansions to those of the children, from the root down.
    pub fn l2l(&self, batch: &mut Batch) -> Result<()> {
        let resources = [self.facets.binding(), self.locals.as_entire_binding()];
        batch.dispatch(&self.l2l, &resources, &self.downward)
    }

    /// L2P: irradiance of each surfel from the local expansion of its leaf.
    pub fn l2p(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        let resources = [
            self.facets.binding(),
            self.surfels.binding(),
            self.locals.as_entire_binding(),
            irradiance.as_entire_binding(),
        ];
        batch.dispatch(&self.l2p, &resources, &self.all_facets)
    }

    /// P2P: adds what each surfel gets by the point kernel.
    pub fn p2p(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        self.points
            .record(batch, &self.surfels, &self.radiosity, irradiance)
    }

    /// Near field: adds what each surfel gets by the near links.
    pub fn near_field(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        let resources = [
            self.near.rows.binding(),
            self.near.links.binding(),
            self.radiosity.binding(),
            irradiance.as_entire_binding(),
        ];
        batch.dispatch(&self.near_field, &resources, &self.near.pieces)
    }
}

fn facet(facet: &octree::Facet) -> Facet {
    Facet {
        centre: facet.centre.to_array(),
        scale: facet.scale(),
        begin: facet.begin,
        end: facet.end,
        first_child: facet.first_child,
        child_count: facet.child_count,
        parent: facet.parent,
        padding: [0; 3],
    }
}
