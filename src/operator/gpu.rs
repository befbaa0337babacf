//! The operator by links on a device.

use wgpu::{Buffer, CommandEncoder};

use super::{GpuFields, TransportOperator};
use crate::error::Result;
use crate::links::Links;
use crate::octree::Octree;
use crate::passes::gpu::{Batch, Gpu, Stages};
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
    /// Fails with `Error::TooLarge` if links or expansions exceed the largest buffer or texture of
    /// the device, and with `Error::Invalid` if the order of the expansions is more than 6.
    pub fn new(gpu: &Gpu, surfels: &Surfels, octree: &Octree, links: &Links) -> Result<GpuFmm> {
        Ok(GpuFmm {
            stages: Stages::new(gpu, surfels, octree, links)?,
            fields: GpuFields::new(gpu, surfels.len())?,
        })
    }
}

impl GpuFmm {
    /// Records the operator into a caller's encoder, as a part of a frame: `irradiance` becomes F
    /// times `radiosity`. Nothing is waited for. All of it is in one submission, which a large scene
    /// can make too long for a desktop's patience.
    ///
    /// The encoder has to be submitted before the operator or its fields are used again; an error of
    /// the device shows when they next wait.
    pub fn record(
        &self,
        encoder: &mut CommandEncoder,
        radiosity: &Buffer,
        irradiance: &Buffer,
    ) -> Result<()> {
        self.fields.check(radiosity)?;
        self.fields.check(irradiance)?;
        let batches = &self.fields.batches;
        batches.record("transport", encoder, |batch| {
            batch.encoder().clear_buffer(irradiance, 0, None);
            self.stages(batch, radiosity, irradiance)
        })
    }

    /// All stages; `irradiance` is zero before.
    fn stages(&self, batch: &mut Batch, radiosity: &Buffer, irradiance: &Buffer) -> Result<()> {
        let stages = &self.stages;
        stages.take(batch, radiosity);
        stages.p2m(batch)?;
        stages.m2m(batch)?;
        stages.m2l(batch)?;
        stages.m2p(batch, irradiance)?;
        stages.p2l(batch)?;
        stages.l2l(batch)?;
        stages.l2p(batch, irradiance)?;
        stages.mixed(batch, irradiance)?;
        stages.p2p(batch, irradiance)?;
        stages.near_field(batch, irradiance)
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
        let batches = &self.fields.batches;
        batches.run_and_wait("transport", |batch| {
            self.stages(batch, radiosity, &irradiance)
        })?;
        Ok(irradiance)
    }
}
