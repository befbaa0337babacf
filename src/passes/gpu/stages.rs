//! The stages of the operator on a device: the twins of `passes::cpu`.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};

use crate::error::{Error, Result};
use crate::expansion::coefficients;
use crate::links::{Entry, Links, Rows};
use crate::octree::{self, Octree};
use crate::points::Surfels;

use super::batch::{Batch, Pieces, VECTOR, Vectors};
use super::lists::{Layout, Lists};
use super::shader::{MAX_ORDER, Shader};
use super::turns::UNCUT;
use super::wgsl::{L2L, L2P, M2L, M2M, M2P, NEAR_FIELD, P2L, P2M};
use super::{Gpu, Mixed, P2p, Pipeline, Table};

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

/// The stages on one set of surfels and links, which stay on the device.
///
/// Stages read expansions from a table and write them to a buffer, from which they are copied to the
/// table when they are complete: one table, first for moments, then for local expansions.
pub struct Stages {
    facets: Table,
    surfels: Table,
    /// Facets of each level.
    levels: Vec<Range<u32>>,
    /// Vectors of an expansion.
    coefficients: usize,
    /// Vectors of each facet: the scalar, then by multi-indices (see `expansion`).
    pub moments: wgpu::Buffer,
    /// As many.
    pub locals: wgpu::Buffer,
    /// The expansions that stages read.
    pub expansions: Table,
    radiosity: Table,
    p2m: Pipeline,
    m2m: Pipeline,
    l2l: Pipeline,
    l2p: Pipeline,
    m2l: Vec<Linked>,
    p2l: Option<Linked>,
    m2p: Option<Linked>,
    mixed: Option<Mixed>,
    p2p: Option<P2p>,
    near_field: Linked,
    /// All facets, which write expansions.
    by_facet: Pieces,
    /// The same level by level.
    by_level: Vec<Pieces>,
    /// All facets, which write to their surfels.
    by_surfel: Pieces,
}

/// A stage that works by links.
struct Linked {
    pipeline: Pipeline,
    lists: Lists,
}

impl Stages {
    /// `surfels` are those in the octree's order. The expansions are of the highest order that the
    /// links ask for.
    ///
    /// Fails with `Error::TooLarge` if expansions or links exceed the largest buffer or texture of
    /// the device, and with `Error::Invalid` beyond [`MAX_ORDER`].
    pub fn new(gpu: &Gpu, surfels: &Surfels, octree: &Octree, links: &Links) -> Result<Stages> {
        let order = links.order();
        if order > MAX_ORDER {
            return Err(Error::Invalid(format!(
                "expansions of order {order}: on a device they go to {MAX_ORDER}"
            )));
        }
        let n = octree.facets.len();
        let largest = octree.facets.iter().filter(|f| f.is_leaf());
        let largest = largest.map(|f| f.len()).max().unwrap_or(0);
        if largest > UNCUT {
            return Err(Error::TooLarge(format!(
                "{largest} surfels in a leaf: on a device they may be {UNCUT}"
            )));
        }
        let coefficients = coefficients(order);
        let facets: Vec<Facet> = octree.facets.iter().map(facet).collect();
        let all: Vec<Surfel> = (0..surfels.len())
            .map(|i| Surfel {
                position: surfels.positions[i].to_array(),
                area: surfels.areas[i],
                normal: surfels.normals[i].to_array(),
                padding: 0.0,
            })
            .collect();
        let levels: Vec<Range<u32>> = octree.levels.windows(2).map(|l| l[0]..l[1]).collect();

        let expansion = |f: u32| {
            let facet = &octree.facets[f as usize];
            let below = if facet.is_leaf() {
                2 * facet.len()
            } else {
                facet.child_count as usize
            };
            ((below + 2) * coefficients, f..f + 1)
        };
        let irradiance = |f: u32| {
            let facet = &octree.facets[f as usize];
            let surfels = if facet.is_leaf() { facet.len() } else { 0 };
            (
                coefficients + surfels * (4 + coefficients / 4),
                facet.begin..facet.begin + surfels as u32,
            )
        };
        let pipeline = |stage: &Shader| Pipeline::new(gpu, &stage.of_order(order, order));
        let none = Rows::none(n);
        let mut m2l = Vec::new();
        for (of_order, rows) in links.m2l.iter().enumerate() {
            let sampled = if of_order == order {
                &links.sampled
            } else {
                &none
            };
            if !rows.is_empty() || !sampled.is_empty() {
                let kinds = [(rows, translation(of_order)), (sampled, 2)];
                let stage = M2L.of_order(of_order, order);
                m2l.push(Linked::new(
                    gpu,
                    &stage,
                    &Layout::new(&kinds, coefficients),
                )?);
            }
        }
        let mean = surfels.len() / n.max(1) + 1;
        let direct = |stage: &Shader, rows: &Rows, layout: &Layout| {
            let linked = || Linked::new(gpu, &stage.of_order(order, order), layout);
            (!rows.is_empty()).then(linked).transpose()
        };
        let kinds = [(&links.p2l, mean * 2 * coefficients)];
        let by_source = Layout {
            rounds: &|_, source| 1 + octree.facets[source].len(),
            ..Layout::new(&kinds, coefficients)
        };
        let p2l = direct(&P2L, &links.p2l, &by_source)?;
        let m2p = by_leaf(octree, &links.m2p);
        let kinds = [(&m2p, mean * 3 * coefficients)];
        let surfels_of = |f: u32| octree.facets[f as usize].begin..octree.facets[f as usize].end;
        let by_surfel = Layout {
            targets: &surfels_of,
            rounds: &|target, _| 1 + octree.facets[target as usize].len(),
            ..Layout::new(&kinds, 1)
        };
        let m2p = direct(&M2P, &m2p, &by_surfel)?;
        let kinds = [(&links.near, 2)];
        let near = Layout::new(&kinds, 1);
        Ok(Stages {
            facets: gpu.table("facets", &facets)?,
            surfels: gpu.table("surfels", &all)?,
            moments: gpu.storage("moments", n * coefficients * VECTOR)?,
            locals: gpu.storage("local expansions", n * coefficients * VECTOR)?,
            expansions: gpu.empty_table("expansions", n * coefficients)?,
            radiosity: gpu.empty_table("radiosity", surfels.len())?,
            p2m: pipeline(&P2M)?,
            m2m: pipeline(&M2M)?,
            l2l: pipeline(&L2L)?,
            l2p: pipeline(&L2P)?,
            m2l,
            p2l,
            m2p,
            mixed: (!links.mixed.is_empty())
                .then(|| Mixed::new(gpu, octree, links))
                .transpose()?,
            p2p: (!links.p2p.is_empty())
                .then(|| P2p::new(gpu, octree, &links.p2p))
                .transpose()?,
            near_field: Linked::new(gpu, &NEAR_FIELD, &near)?,
            by_facet: Pieces::of(gpu, &[0..n as u32], coefficients, expansion)?,
            by_level: levels
                .iter()
                .map(|level| Pieces::of(gpu, std::slice::from_ref(level), coefficients, expansion))
                .collect::<Result<_>>()?,
            by_surfel: Pieces::of(gpu, &[0..n as u32], 1, irradiance)?,
            levels,
            coefficients,
        })
    }

    /// Takes the radiosity, which is what [`Self::p2m`], [`Self::p2l`], [`Self::mixed`],
    /// [`Self::p2p`] and [`Self::near_field`] work on, from a field.
    pub fn take(&self, batch: &mut Batch, radiosity: &wgpu::Buffer) {
        self.radiosity.copy_from(radiosity, batch.encoder());
    }

    /// P2M: moments of the leaves; other facets get zeros.
    pub fn p2m(&self, batch: &mut Batch) -> Result<()> {
        let tables = [&self.facets, &self.surfels, &self.radiosity].map(Table::binding);
        batch.dispatch(&self.p2m, &tables, &[self.moments()], &self.by_facet)
    }

    /// M2M: moments of the inner facets, from the leaves up; then all of them are in the table.
    pub fn m2m(&self, batch: &mut Batch) -> Result<()> {
        let tables = [&self.facets, &self.expansions].map(Table::binding);
        for level in (0..self.levels.len()).rev() {
            if level + 1 < self.levels.len() {
                let pieces = &self.by_level[level];
                batch.dispatch(&self.m2m, &tables, &[self.moments()], pieces)?;
            }
            self.tabulate(batch, &self.moments, level);
        }
        Ok(())
    }

    /// M2L: local expansions from the moments in the table by links of all orders and sampled ones.
    pub fn m2l(&self, batch: &mut Batch) -> Result<()> {
        batch.encoder().clear_buffer(&self.locals, 0, None);
        for Linked { pipeline, lists } in &self.m2l {
            let tables = [&self.facets, &lists.rows, &lists.links, &self.expansions];
            let tables = tables.map(Table::binding);
            batch.dispatch(pipeline, &tables, &[self.locals()], &lists.pieces)?;
        }
        Ok(())
    }

    /// M2P: adds to the irradiance what comes from the moments in the table.
    pub fn m2p(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        let Some(Linked { pipeline, lists }) = &self.m2p else {
            return Ok(());
        };
        let links = [&lists.rows, &lists.links, &self.expansions];
        let tables = [&self.facets, &self.surfels].into_iter().chain(links);
        let tables: Vec<_> = tables.map(Table::binding).collect();
        batch.dispatch(pipeline, &tables, &[(irradiance, 1)], &lists.pieces)
    }

    /// P2L: adds to local expansions what comes from surfels.
    pub fn p2l(&self, batch: &mut Batch) -> Result<()> {
        let Some(Linked { pipeline, lists }) = &self.p2l else {
            return Ok(());
        };
        let links = [&lists.rows, &lists.links, &self.radiosity];
        let tables = [&self.facets, &self.surfels].into_iter().chain(links);
        let tables: Vec<_> = tables.map(Table::binding).collect();
        batch.dispatch(pipeline, &tables, &[self.locals()], &lists.pieces)
    }

    /// L2L: adds local expansions to those of the children, from the root down; then all of them
    /// are in the table.
    pub fn l2l(&self, batch: &mut Batch) -> Result<()> {
        let tables = [&self.facets, &self.expansions].map(Table::binding);
        self.expansions.copy_from(&self.locals, batch.encoder());
        for level in 1..self.levels.len() {
            let pieces = &self.by_level[level];
            batch.dispatch(&self.l2l, &tables, &[self.locals()], pieces)?;
            self.tabulate(batch, &self.locals, level);
        }
        Ok(())
    }

    /// L2P: adds to the irradiance of each surfel what the local expansion of its leaf, in the
    /// table, says.
    pub fn l2p(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        let tables = [&self.facets, &self.surfels, &self.expansions].map(Table::binding);
        batch.dispatch(&self.l2p, &tables, &[(irradiance, 1)], &self.by_surfel)
    }

    /// P2M, M2L and L2P of each mixed link: adds what surfels get from those that face them.
    pub fn mixed(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        let (facets, surfels, radiosity) = (&self.facets, &self.surfels, &self.radiosity);
        match &self.mixed {
            Some(mixed) => mixed.record(batch, facets, surfels, radiosity, irradiance),
            None => Ok(()),
        }
    }

    /// P2P: adds what each surfel gets by the point kernel.
    pub fn p2p(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        match &self.p2p {
            Some(p2p) => p2p.record(batch, &self.surfels, &self.radiosity, irradiance),
            None => Ok(()),
        }
    }

    /// Near field: adds what each surfel gets by the near links.
    pub fn near_field(&self, batch: &mut Batch, irradiance: &wgpu::Buffer) -> Result<()> {
        let Linked { pipeline, lists } = &self.near_field;
        let tables = [&lists.rows, &lists.links, &self.radiosity].map(Table::binding);
        batch.dispatch(pipeline, &tables, &[(irradiance, 1)], &lists.pieces)
    }

    fn moments(&self) -> Vectors<'_> {
        (&self.moments, self.coefficients)
    }

    fn locals(&self) -> Vectors<'_> {
        (&self.locals, self.coefficients)
    }

    /// Copies the expansions of a level to the table.
    fn tabulate(&self, batch: &mut Batch, expansions: &wgpu::Buffer, level: usize) {
        let facets = &self.levels[level];
        let texels = [facets.start, facets.end].map(|f| f as usize * self.coefficients);
        let encoder = batch.encoder();
        self.expansions
            .copy_part(expansions, texels[0]..texels[1], encoder);
    }
}

impl Linked {
    fn new(gpu: &Gpu, stage: &Shader, layout: &Layout) -> Result<Linked> {
        Ok(Linked {
            pipeline: Pipeline::new(gpu, stage)?,
            lists: Lists::new(gpu, stage.name, layout)?,
        })
    }
}

/// Links of the leaves: their own and those of the facets that hold them. So a surfel is in one row.
fn by_leaf(octree: &Octree, links: &Rows) -> Rows {
    let mut entries = Vec::new();
    let leaves = (0..octree.facets.len()).filter(|&f| octree.facets[f].is_leaf());
    for leaf in leaves {
        let above = |&f: &usize| Some(octree.facets[f].parent as usize).filter(|&p| p != f);
        for f in std::iter::successors(Some(leaf), above) {
            entries.extend(links.row(f).map(|(source, weight)| Entry {
                target: leaf as u32,
                source: source as u32,
                weight,
            }));
        }
    }
    Rows::new(octree.facets.len(), entries)
}

/// Work of a link: what it reads, and its sums over pairs of multi-indices, of which twenty take the
/// time of a texel.
pub(super) fn translation(order: usize) -> usize {
    let pairs: usize = (1..=6).fold(1, |pairs, k| pairs * (order + k) / k);
    coefficients(order) + 2 + 9 * pairs / 20
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
