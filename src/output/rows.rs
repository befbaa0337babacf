//! Points as rows of bytes, little endian, which more than one format writes.

use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::write_atomic;
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::PointCloud;
use crate::render::tone;

/// Rows that are encoded and written at a time.
pub const BLOCK: usize = 1 << 17;
/// Rows for one thread at a time.
pub const GRAIN: usize = 4096;

/// Bytes of what [`Lit::fill`] tells of a point.
pub const LIT: usize = 44;

/// The bytes of a point that are still to be filled.
pub struct Row<'a>(&'a mut [u8]);

impl Row<'_> {
    pub fn put(&mut self, bytes: &[u8]) {
        self.0
            .write_all(bytes)
            .expect("a row has room for its values");
    }

    pub fn vector(&mut self, v: Vec3) {
        for x in v.to_array() {
            self.put(&x.to_le_bytes());
        }
    }

    pub fn double_vector(&mut self, v: DVec3) {
        for x in v.to_array() {
            self.put(&x.to_le_bytes());
        }
    }
}

/// Fills `bytes` with rows of `stride` bytes, in parallel; `fill` gets the number of its row.
pub fn fill_rows(bytes: &mut [u8], stride: usize, fill: impl Fn(&mut Row, usize) + Sync) {
    bytes
        .par_chunks_exact_mut(stride)
        .enumerate()
        .with_min_len(GRAIN)
        .for_each(|(i, bytes)| {
            let mut row = Row(bytes);
            fill(&mut row, i);
            debug_assert!(row.0.is_empty());
        });
}

/// Writes `header` and then `n` rows of `stride` bytes.
pub fn write_rows(
    path: &Path,
    header: &[u8],
    n: usize,
    stride: usize,
    fill: impl Fn(&mut Row, usize) + Sync,
) -> Result<()> {
    write_atomic(path, |writer| {
        writer.write_all(header)?;
        let mut bytes = vec![0; n.min(BLOCK) * stride];
        for begin in (0..n).step_by(BLOCK) {
            let bytes = &mut bytes[..BLOCK.min(n - begin) * stride];
            fill_rows(bytes, stride, |row, k| fill(row, begin + k));
            writer.write_all(bytes)?;
        }
        Ok(())
    })
}

/// Points with their light.
#[derive(Clone, Copy)]
pub struct Lit<'a> {
    pub cloud: &'a PointCloud,
    pub map: &'a IlluminationMap,
    exposure: f32,
}

impl<'a> Lit<'a> {
    /// Fails with [`Error::Invalid`] if cloud and map differ in length.
    pub fn new(cloud: &'a PointCloud, map: &'a IlluminationMap) -> Result<Self> {
        let n = cloud.len();
        let lengths = [
            map.irradiance.len(),
            map.radiosity.len(),
            map.radius.len(),
            map.in_transport.len(),
        ];
        if lengths != [n; 4] {
            return Err(Error::Invalid(format!(
                "the map has {lengths:?} entries, the cloud {n} points"
            )));
        }
        Ok(Lit {
            cloud,
            map,
            exposure: tone::exposure(&map.radiosity),
        })
    }

    pub fn len(&self) -> usize {
        self.cloud.len()
    }

    /// Zero where the cloud has none.
    pub fn normal(&self, i: usize) -> Vec3 {
        self.map.normal(self.cloud, i)
    }

    /// Radiosity as a display shows it.
    pub fn colour(&self, i: usize) -> [u8; 3] {
        tone::tone_map(self.map.radiosity[i], self.exposure)
    }

    /// Everything but the position.
    pub fn fill(&self, row: &mut Row, i: usize) {
        row.vector(self.normal(i));
        row.put(&self.colour(i));
        row.put(&self.map.radius[i].to_le_bytes());
        row.vector(self.map.irradiance[i]);
        row.vector(self.map.radiosity[i]);
        row.put(&[u8::from(self.map.in_transport[i])]);
    }
}
