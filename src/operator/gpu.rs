//! The operator by links on a device.

use wgpu::Buffer;

use super::{GpuFields, TransportOperator};
use crate::error::Result;
use crate::links::Links;
use crate::octree::Octree;
use crate::passes::gpu::{Gpu, Stages};
use crate::points::Surfels;

/// The operator in WGSL, in f32: surfels, links and expansions stay on the device, and so do the
/// fields. A caller that has its own device applies it to buffers of its own; [`GpuFields`] says
/// how they must be made.
pub struct GpuFmm {
    stages: Stages,
    fields: GpuFields,
}

impl GpuFmm {
    /// `surfels` are those in the octree's order.
    ///
    /// Fails with `Error::TooLarge` if the links or expansions exceed what the device can bind at
    /// once.
    pub fn new(gpu: &Gpu, surfels: &Surfels, octree: &Octree, links: &Links) -> Result<GpuFmm> {
        Ok(GpuFmm {
            stages: Stages::new(gpu, surfels, octree, links)?,
            fields: GpuFields::new(gpu, surfels.len())?,
        })
    }
}

impl TransportOperator for GpuFmm {
    type Fields = GpuFields;

    fn fields(&self) -> &GpuFields {
        &self.fields
    }

    /// Waits until the irradiance is there, and fails with `Error::Device` if a part of the work
    /// was not carried out.
    fn apply(&self, radiosity: &Buffer) -> Result<Buffer> {
        self.fields.check(radiosity)?;
        let irradiance = self.fields.empty()?;
        let stages = &self.stages;
        self.fields.batches.run_and_wait("transport", |batch| {
            stages.take(batch, radiosity);
            stages.p2m(batch)?;
            stages.m2m(batch)?;
            stages.m2l(batch)?;
            stages.l2l(batch)?;
            stages.l2p(batch, &irradiance)?;
            stages.p2p(batch, &irradiance)?;
            stages.near_field(batch, &irradiance)
        })?;
        Ok(irradiance)
    }
}
