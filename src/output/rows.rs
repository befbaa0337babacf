//! Points as rows of bytes, little endian, which more than one format writes.

use std::io::Write;
use std::path::Path;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::write_atomic;
use crate::colour::linear_to_srgb;
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::PointCloud;
use crate::render::tone;
use crate::scan::attributes::Kind;

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

    /// All bytes that are not passed yet.
    pub fn rest(&mut self) -> &mut [u8] {
        self.0
    }

    /// Leaves bytes as they are.
    pub fn skip(&mut self, bytes: usize) {
        let row = std::mem::take(&mut self.0);
        self.0 = &mut row[bytes..];
    }

    /// A number of some kind; without one no number, or 0 where there is no such.
    pub fn number(&mut self, kind: Kind, value: Option<f64>) {
        let missing = match kind {
            Kind::F32 | Kind::F64 => f64::NAN,
            _ => 0.0,
        };
        let (bytes, size) = kind.bytes(value.unwrap_or(missing));
        self.put(&bytes[..size]);
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

/// What the colours of an output are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Paint {
    /// Radiosity as a display shows it.
    Lit,
    /// Irradiance as a display shows it.
    Irradiance,
    /// The colours of the input.
    Keep,
}

/// Points with their light.
#[derive(Clone, Copy)]
pub struct Lit<'a> {
    pub cloud: &'a PointCloud,
    pub map: &'a IlluminationMap,
    pub paint: Paint,
    exposure: f32,
}

impl<'a> Lit<'a> {
    /// Fails with [`Error::Invalid`] if cloud and map differ in length.
    pub fn new(cloud: &'a PointCloud, map: &'a IlluminationMap, paint: Paint) -> Result<Self> {
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
        let exposure = match paint {
            Paint::Lit => tone::exposure(&map.radiosity),
            Paint::Irradiance => tone::exposure(&map.irradiance),
            Paint::Keep => 1.0,
        };
        Ok(Lit {
            cloud,
            map,
            paint,
            exposure,
        })
    }

    pub fn len(&self) -> usize {
        self.cloud.len()
    }

    /// Zero where the cloud has none.
    pub fn normal(&self, i: usize) -> Vec3 {
        self.map.normal(self.cloud, i)
    }

    /// In sRGB; colours of the input are those of its reflectance.
    pub fn colour(&self, i: usize) -> [u8; 3] {
        let light = match self.paint {
            Paint::Lit => self.map.radiosity[i],
            Paint::Irradiance => self.map.irradiance[i],
            Paint::Keep => {
                let reflectance = self.cloud.reflectance[i].to_array();
                return reflectance.map(|r| (linear_to_srgb(r) * 255.0).round() as u8);
            }
        };
        tone::tone_map(light, self.exposure)
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
