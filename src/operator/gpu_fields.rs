//! Fields on a device.

use glam::DVec3;
use wgpu::{BindingResource, Buffer, BufferBinding, BufferSize, BufferUsages};

use super::Fields;
use crate::error::{Error, Result};
use crate::passes::gpu::{Batch, Batches, Gpu, Pieces, Pipeline, WORKGROUP, wgsl};

/// Items that one invocation of an inner product sums up in f32.
const PART: usize = WORKGROUP as usize;
/// Items that a workgroup sums up.
const BLOCK: usize = PART * WORKGROUP as usize;
/// Sums that the device makes of these parts, and the host adds up in f64.
const SUMS: usize = WORKGROUP as usize;
/// Bytes of them: as many as a binding's offset may have to be a multiple of.
const SUM_BYTES: usize = SUMS * size_of::<f32>();
/// Inner products of which the sums are read together.
const TOGETHER: usize = 32;
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
/// Work is handed to the queue in order, without waiting; `dots` and `download` wait, and fail with
/// [`Error::Device`] if anything before them was not carried out.
pub struct GpuFields {
    gpu: Gpu,
    len: usize,
    pub(super) batches: Batches,
    axpy: Pipeline,
    scale: Pipeline,
    multiply: Pipeline,
    inner_product: Pipeline,
    sum: Pipeline,
    items: Pieces,
    by_part: Pieces,
    by_sum: Pieces,
    /// How many items and parts there are.
    item_count: Buffer,
    part_count: Buffer,
    /// Parts of an inner product.
    parts: Buffer,
    /// Sums of [`TOGETHER`] inner products.
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
            sum: Pipeline::new(gpu, &wgsl::SUM)?,
            items: Pieces::new(gpu, len as u32, |_| 3)?,
            by_part: Pieces::of(gpu, &[0..parts as u32], 1, block)?,
            by_sum: Pieces::new(gpu, SUMS as u32, |_| parts / SUMS)?,
            item_count: gpu.uniform("items", &[len as u32])?,
            part_count: gpu.uniform("parts", &[parts as u32])?,
            parts: gpu.storage("parts", parts * size_of::<f32>())?,
            sums: gpu.storage("sums", TOGETHER * SUM_BYTES)?,
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
    const EPSILON: f64 = f32::EPSILON as f64;

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

    fn add(&self, terms: &[(f64, &Buffer)], y: &mut Buffer) -> Result<()> {
        let uniform = |&(a, _): &(f64, _)| self.gpu.uniform("a", &[a as f32]);
        let factors: Vec<Buffer> = terms.iter().map(uniform).collect::<Result<_>>()?;
        self.batches.run("add", |batch| {
            for (a, &(_, x)) in factors.iter().zip(terms) {
                let a = a.as_entire_binding();
                batch.dispatch(&self.axpy, &[a], &[(x, 1), (y, 1)], &self.items)?;
            }
            Ok(())
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

    fn dots(&self, xs: &[&Buffer], y: &Buffer) -> Result<Vec<f64>> {
        let mut products = Vec::with_capacity(xs.len());
        let parts = || self.parts.as_entire_binding();
        for xs in xs.chunks(TOGETHER) {
            let record = |batch: &mut Batch| {
                for (k, &x) in xs.iter().enumerate() {
                    let items = self.item_count.as_entire_binding();
                    let vectors = [(x, 1), (y, 1)];
                    batch.dispatch(
                        &self.inner_product,
                        &[items, parts()],
                        &vectors,
                        &self.by_part,
                    )?;
                    let resources = [
                        self.part_count.as_entire_binding(),
                        parts(),
                        BindingResource::Buffer(BufferBinding {
                            buffer: &self.sums,
                            offset: (k * SUM_BYTES) as u64,
                            size: BufferSize::new(SUM_BYTES as u64),
                        }),
                    ];
                    batch.dispatch(&self.sum, &resources, &[], &self.by_sum)?;
                }
                Ok(())
            };
            let count = xs.len() * SUMS;
            let sums: Vec<f32> =
                self.batches
                    .run_and_read("inner products", &self.sums, count, record)?;
            let product = |sums: &[f32]| sums.iter().copied().map(f64::from).sum::<f64>();
            products.extend(sums.chunks(SUMS).map(product));
        }
        Ok(products)
    }
}
