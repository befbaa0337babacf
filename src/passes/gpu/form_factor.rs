//! Form factors of pairs of surfels, on a device.

use std::sync::{Mutex, PoisonError};

use bytemuck::{Pod, Zeroable};

use crate::error::Result;
use crate::points::{MAX_EDGES, Surfels};

use super::{Batches, Gpu, Pieces, Pipeline, Table, wgsl};

/// Pairs computed in one batch: 8 MiB.
const MOST: usize = 1 << 20;
/// Texels and vectors that a pair costs, roughly: those of the cell, and the angles of its edges.
const WORK: usize = 64;

/// Seven texels of the table of cells.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub struct Cell {
    pub position: [f32; 3],
    pub area: f32,
    pub normal: [f32; 3],
    pub padding0: f32,
    pub tangent: [f32; 3],
    pub padding1: f32,
    /// In the plane of tangent and bitangent, two a texel.
    pub corners: [[f32; 2]; MAX_EDGES],
}

/// Computes form factors on a device, which holds the cells from the start: the twin of
/// [`Surface::form_factor`](crate::expansion::Surface::form_factor).
pub struct GpuFormFactors {
    gpu: Gpu,
    batches: Batches,
    cells: Table,
    pipeline: Pipeline,
    /// Pairs of a batch at most.
    most: usize,
    /// Pairs and form factors of one batch at a time.
    buffers: Mutex<(wgpu::Buffer, wgpu::Buffer)>,
}

impl GpuFormFactors {
    pub fn new(gpu: &Gpu, surfels: &Surfels) -> Result<GpuFormFactors> {
        let cells: Vec<Cell> = (0..surfels.len())
            .map(|i| Cell {
                position: surfels.positions[i].to_array(),
                area: surfels.areas[i],
                normal: surfels.normals[i].to_array(),
                padding0: 0.0,
                tangent: surfels.cells.tangents[i].to_array(),
                padding1: 0.0,
                corners: surfels.cells.corners[i].map(|c| c.to_array()),
            })
            .collect();
        let most = MOST.min(gpu.most_bound(size_of::<[u32; 2]>()));
        Ok(GpuFormFactors {
            most,
            gpu: gpu.clone(),
            batches: Batches::new(gpu)?,
            cells: gpu.table("cells", &cells)?,
            pipeline: Pipeline::new(gpu, &wgsl::FORM_FACTOR)?,
            buffers: Mutex::new((
                gpu.storage("pairs", most * size_of::<[u32; 2]>())?,
                gpu.storage("form factors", most * size_of::<f32>())?,
            )),
        })
    }

    /// F_ij of each pair (i, j): what surfel i gets as irradiance of the radiosity of surfel j,
    /// without occlusion.
    pub fn compute(&self, pairs: &[(u32, u32)]) -> Result<Vec<f32>> {
        let mut found = Vec::with_capacity(pairs.len());
        let (input, output) = &*self.buffers.lock().unwrap_or_else(PoisonError::into_inner);
        for pairs in pairs.chunks(self.most) {
            let words: Vec<[u32; 2]> = pairs.iter().map(|&(i, j)| [i, j]).collect();
            self.gpu.watch("form factors", || {
                self.gpu
                    .queue
                    .write_buffer(input, 0, bytemuck::cast_slice(&words));
                Ok(())
            })?;
            let pieces = Pieces::new(&self.gpu, pairs.len() as u32, |_| WORK)?;
            let resources = [
                self.cells.binding(),
                input.as_entire_binding(),
                output.as_entire_binding(),
            ];
            found.extend(self.batches.run_and_read::<f32>(
                "form factors",
                output,
                pairs.len(),
                |batch| batch.dispatch(&self.pipeline, &resources, &[], &pieces),
            )?);
        }
        Ok(found)
    }
}
