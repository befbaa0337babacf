//! Tables: data that stages read as texels, which software Vulkan reads ten times as fast as
//! buffers.

use std::ops::Range;

use bytemuck::Pod;
use wgpu::TextureUsages;

use crate::error::{Error, Result};

use super::Gpu;
use super::context::mib;

/// Texels a row of a table. Every device has textures so wide, and a power of two divides fast.
pub const TABLE_WIDTH: u32 = 8192;
/// Bytes a texel.
const TEXEL: usize = 16;
const ROW: usize = TABLE_WIDTH as usize * TEXEL;

/// Read-only data in texels of 16 bytes; see `shaders/shared/table.wgsl`.
pub struct Table {
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    texels: usize,
}

/// A part of a table that is filled at once: whole rows, or a part of one.
struct Part {
    bytes: Range<usize>,
    origin: wgpu::Origin3d,
    size: wgpu::Extent3d,
}

impl Table {
    pub fn binding(&self) -> wgpu::BindingResource<'_> {
        wgpu::BindingResource::TextureView(&self.view)
    }

    /// Records a copy of the whole table's content from the beginning of `buffer`.
    pub fn copy_from(&self, buffer: &wgpu::Buffer, encoder: &mut wgpu::CommandEncoder) {
        self.copy_part(buffer, 0..self.texels, encoder);
    }

    /// Records a copy of some of the texels, which have the same place in `buffer`.
    pub fn copy_part(
        &self,
        buffer: &wgpu::Buffer,
        texels: Range<usize>,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        for part in parts(texels) {
            let from = wgpu::TexelCopyBufferInfo {
                buffer,
                layout: layout(part.bytes.start),
            };
            encoder.copy_buffer_to_texture(from, self.at(part.origin), part.size);
        }
    }

    fn at(&self, origin: wgpu::Origin3d) -> wgpu::TexelCopyTextureInfo<'_> {
        wgpu::TexelCopyTextureInfo {
            origin,
            ..self.texture.as_image_copy()
        }
    }
}

impl Gpu {
    /// Uploads elements of whole texels.
    pub fn table<T: Pod>(&self, what: &str, data: &[T]) -> Result<Table> {
        const { assert!(size_of::<T>().is_multiple_of(TEXEL)) };
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let table = self.empty_table(what, bytes.len() / TEXEL)?;
        self.watch(what, || {
            for part in parts(0..table.texels) {
                let data = &bytes[part.bytes];
                self.queue
                    .write_texture(table.at(part.origin), data, layout(0), part.size);
            }
            Ok(())
        })?;
        Ok(table)
    }

    /// A table to be filled on the device.
    pub fn empty_table(&self, what: &str, texels: usize) -> Result<Table> {
        let rows = texels.div_ceil(TABLE_WIDTH as usize).max(1);
        let most = self.device.limits().max_texture_dimension_2d as usize;
        if rows > most {
            return Err(Error::TooLarge(format!(
                "{what}: {:.1} MiB do not fit into a table of this device, which holds {:.1} MiB",
                mib(texels * TEXEL),
                mib(ROW * most)
            )));
        }
        self.watch(what, || {
            let texture = self.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(what),
                size: size(TABLE_WIDTH as usize, rows),
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Rgba32Uint,
                usage: TextureUsages::TEXTURE_BINDING | TextureUsages::COPY_DST,
                view_formats: &[],
            });
            let view = texture.create_view(&Default::default());
            Ok(Table {
                texture,
                view,
                texels,
            })
        })
    }
}

/// The rest of a row that was begun, whole rows, the beginning of a row.
fn parts(texels: Range<usize>) -> impl Iterator<Item = Part> {
    let (start, end) = (texels.start * TEXEL, texels.end * TEXEL);
    let first = start.next_multiple_of(ROW).min(end);
    let last = (end / ROW * ROW).max(first);
    [start..first, first..last, last..end]
        .into_iter()
        .filter(|bytes| !bytes.is_empty())
        .map(|bytes| Part {
            origin: wgpu::Origin3d {
                x: (bytes.start % ROW / TEXEL) as u32,
                y: (bytes.start / ROW) as u32,
                z: 0,
            },
            size: size(bytes.len().min(ROW) / TEXEL, bytes.len().div_ceil(ROW)),
            bytes,
        })
}

fn layout(offset: usize) -> wgpu::TexelCopyBufferLayout {
    wgpu::TexelCopyBufferLayout {
        offset: offset as u64,
        bytes_per_row: Some(ROW as u32),
        rows_per_image: None,
    }
}

fn size(width: usize, height: usize) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width: width as u32,
        height: height as u32,
        depth_or_array_layers: 1,
    }
}
