//! Lit point clouds as arrays of NumPy.

use std::path::Path;

use super::rows::{LIT, Lit, Paint, write_rows};
use crate::error::Result;
use crate::map::IlluminationMap;
use crate::points::PointCloud;

/// What a row holds, as `numpy.dtype` takes it.
const DTYPE: &str = "[('position', '<f8', (3,)), ('normal', '<f4', (3,)), \
    ('colour', '|u1', (3,)), ('radius', '<f4'), ('irradiance', '<f4', (3,)), \
    ('radiosity', '<f4', (3,)), ('in_transport', '|b1')]";
/// Bytes of a row.
const STRIDE: usize = 24 + LIT;

/// Writes all points of a cloud with their light, in the cloud's order, as a NumPy file.
///
/// It is an array of one axis with named fields: `numpy.load("lit.npy")["irradiance"]` has the
/// shape (N, 3). The fields: `position` (f64), `normal` (0 without normals), `colour` (radiosity
/// as a display shows it), `radius`, `irradiance`, `radiosity`, `in_transport`.
///
/// # Errors
/// [`Error::Invalid`](crate::Error::Invalid) if cloud and map differ in length,
/// [`Error::Io`](crate::Error::Io) if writing fails.
pub fn write_npy(path: &Path, cloud: &PointCloud, map: &IlluminationMap) -> Result<()> {
    write_lit(path, Lit::new(cloud, map, Paint::Lit)?)
}

/// As [`write_npy`], in other colours.
pub fn write_lit(path: &Path, lit: Lit) -> Result<()> {
    let n = lit.len();
    write_rows(path, &header(n), n, STRIDE, |row, i| {
        row.double_vector(lit.cloud.positions[i]);
        lit.fill(row, i);
    })
}

/// Magic, version 1.0, length and text, which ends with a line; a multiple of 64 bytes in all.
fn header(n: usize) -> Vec<u8> {
    let text = format!("{{'descr': {DTYPE}, 'fortran_order': False, 'shape': ({n},), }}");
    let before = b"\x93NUMPY\x01\x00";
    let length = (before.len() + 2 + text.len() + 1).next_multiple_of(64) - before.len() - 2;
    let mut header = before.to_vec();
    header.extend((length as u16).to_le_bytes());
    header.extend(text.bytes());
    header.resize(before.len() + 2 + length - 1, b' ');
    header.push(b'\n');
    header
}
