//! Fields on a device.

use glam::DVec3;
use wgpu::{Buffer, BufferUsages};

use super::Fields;
use crate::error::{Error, Result};
use crate::passes::gpu::{Batches, Gpu, Pieces, Pipeline, WORKGROUP, wgsl};

/// Items that one invocation of an inner product sums up in f32; the host adds these sums in f64.
const PART: usize = WORKGROUP as usize;
/// Items that a workgroup sums up.
const BLOCK: usize = PART * WORKGROUP as usize;
/// What a buffer must be made for to serve as a field.
const USAGES: BufferUsages = BufferUsages::STORAGE
    .union(BufferUsages::COPY_SRC)
    .union(BufferUsages::COPY_DST);

/// Arithmetic on fields of one length that live on a device.
///
/// A field is a buffer of one `vec4<f32>` a surfel: red, green, blue, and a fourth that is ignored
/// where it is read and 0 where it is written. A buffer that the caller made on the same device
/// will do as well, if it is as long and has the usages `STORAGE`, `COPY_SRC` and `COPY_DST`.
///
/// Work is handed to the queue in order, without waiting; `dot` and `download` wait, and fail with
/// [`Error::Device`] if anything before them was not carried out.
pub struct GpuFields {
    gpu: Gpu,
    len: usize,
    pub(super) batches: Batches,
    axpy: Pipeline,
    scale: Pipeline,
    multiply: Pipeline,
    inner_product: Pipeline,
    items: Pieces,
    parts: Pieces,
    part_count: usize,
    /// Sums of an inner product.
    sums: Buffer,
}

impl GpuFields {
    /// Fields of `len` surfels.
    pub fn new(gpu: &Gpu, len: usize) -> Result<GpuFields> {
        let parts = len.div_ceil(BLOCK) * WORKGROUP as usize;
        // What the block of an invocation reads.
        let block = |k: u32| {
            let first = k / WORKGROUP * BLOCK as u32;
            (2 * PART, first..(first + BLOCK as u32).min(len as u32))
        };
        Ok(GpuFields {
            gpu: gpu.clone(),
            len,
            batches: Batches::new(gpu)?,
            axpy: Pipeline::new(gpu, &wgsl::AXPY)?,
            scale: Pipeline::new(gpu, &wgsl::SCALE)?,
            multiply: Pipeline::new(gpu, &wgsl::MULTIPLY)?,
            inner_product: Pipeline::new(gpu, &wgsl::INNER_PRODUCT)?,
            items: Pieces::new(gpu, len as u32, |_| 3)?,
            parts: Pieces::of(gpu, &[0..parts as u32], 1, block)?,
            part_count: parts,
            sums: gpu.storage("sums", parts * size_of::<f32>())?,
        })
    }

    /// A field of zeros.
    pub(super) fn empty(&self) -> Result<Buffer> {
        self.gpu.storage("field", self.bytes())
    }

    /// Fails with [`Error::Invalid`] if a buffer cannot serve as a field.
    pub(super) fn check(&self, field: &Buffer) -> Result<()> {
        if field.size() < self.bytes() as u64 || !field.usage().contains(USAGES) {
            return Err(Error::Invalid(format!(
                "this buffer is no field of {} surfels: it has {} bytes of {} and the usages {:?}, \
                 but needs {:?}",
                self.len,
                field.size(),
                self.bytes(),
                field.usage(),
                USAGES
            )));
        }
        Ok(())
    }

    fn bytes(&self) -> usize {
        self.len * size_of::<[f32; 4]>()
    }
}

impl Fields for GpuFields {
    type Field = Buffer;

    fn upload(&self, values: &[DVec3]) -> Result<Buffer> {
        let narrow = |v: &DVec3| v.as_vec3().extend(0.0).to_array();
        let vectors: Vec<[f32; 4]> = values.iter().map(narrow).collect();
        let field = self.empty()?;
        self.gpu.watch("upload", || {
            self.gpu
                .queue
                .write_buffer(&field, 0, bytemuck::cast_slice(&vectors));
            Ok(())
        })?;
        Ok(field)
    }

    fn download(&self, field: &Buffer) -> Result<Vec<DVec3>> {
        self.check(field)?;
        let vectors: Vec<[f32; 4]> =
            self.batches
                .run_and_read("download", field, self.len, |_| Ok(()))?;
        let wide = |&[r, g, b, _]: &[f32; 4]| DVec3::new(r.into(), g.into(), b.into());
        Ok(vectors.iter().map(wide).collect())
    }

    fn copy(&self, field: &Buffer) -> Result<Buffer> {
        self.check(field)?;
        let copy = self.empty()?;
        self.batches.run("copy", |batch| {
            let bytes = self.bytes() as u64;
            batch
                .encoder()
                .copy_buffer_to_buffer(field, 0, &copy, 0, bytes);
            Ok(())
        })?;
        Ok(copy)
    }

    fn axpy(&self, a: f64, x: &Buffer, y: &mut Buffer) -> Result<()> {
        let a = self.gpu.uniform("a", &[a as f32])?;
        let a = a.as_entire_binding();
        self.batches.run("axpy", |batch| {
            batch.dispatch(&self.axpy, &[a], &[(x, 1), (y, 1)], &self.items)
        })
    }

    fn scale(&self, a: f64, x: &mut Buffer) -> Result<()> {
        let a = self.gpu.uniform("a", &[a as f32])?;
        let a = a.as_entire_binding();
        self.batches.run("scale", |batch| {
            batch.dispatch(&self.scale, &[a], &[(x, 1)], &self.items)
        })
    }

    fn multiply(&self, factor: &Buffer, x: &mut Buffer) -> Result<()> {
        self.batches.run("multiply", |batch| {
            batch.dispatch(&self.multiply, &[], &[(factor, 1), (x, 1)], &self.items)
        })
    }

    fn dot(&self, x: &Buffer, y: &Buffer) -> Result<f64> {
        let items = self.gpu.uniform("items", &[self.len as u32])?;
        let resources = [&items, &self.sums].map(|b| b.as_entire_binding());
        let fields = [(x, 1), (y, 1)];
        let sums: Vec<f32> =
            self.batches
                .run_and_read("inner product", &self.sums, self.part_count, |batch| {
                    batch.dispatch(&self.inner_product, &resources, &fields, &self.parts)
                })?;
        Ok(sums.into_iter().map(f64::from).sum())
    }
}
