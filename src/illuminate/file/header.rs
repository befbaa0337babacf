//! The head of the file: what it belongs to, and how long everything is.

use bytemuck::{Pod, Zeroable};
use glam::Vec2;

use super::super::geometry::Geometry;
use crate::links::Kept;
use crate::octree::StoredFacet;
use crate::points::MAX_EDGES;
use crate::visibility::Shape;

/// The first eight bytes.
pub const MAGIC: [u8; 8] = *b"fmmgi-op";
/// Increased with every change of the format, and of what the numbers in it mean.
pub const VERSION: u32 = 2;
/// Says that surfels were fitted: no number that damage would leave.
pub const FITTED: u32 = 0x5449_4654;
/// Lists of links with expansions, by order, at most.
pub const ORDERS: usize = 13;

/// Words of 32 bits; longer numbers have the lower one first.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Header {
    pub magic: [u32; 2],
    pub version: u32,
    /// Largest order of the expansions.
    pub order: u32,
    /// Of the cloud.
    pub fingerprint: [u32; 2],
    pub origin: [[u32; 2]; 3],
    pub occluder_scale: f32,
    /// [`FITTED`] if the surfels were fitted to the points, or 0.
    pub fitted: u32,
    pub points: u32,
    pub surfels: u32,
    pub facets: u32,
    pub cones: u32,
    /// Boxes around what stands in the way, and what they hold.
    pub boxes: u32,
    pub occluders: u32,
    /// Bytes of the repairs, line by line, without the padding to whole words.
    pub repairs: u32,
    /// Lists of links with expansions.
    pub orders: u32,
    /// Links of each.
    pub m2l: [u32; ORDERS],
    pub sampled: u32,
    pub near: u32,
    pub left_out: u32,
}

impl Header {
    pub fn new(geometry: &Geometry, shape: &Shape, kept: &Kept, repairs: usize) -> Header {
        let surfels = &geometry.surfels;
        let mut m2l = [0; ORDERS];
        for (len, rows) in m2l.iter_mut().zip(&kept.links.m2l) {
            *len = rows.len() as u32;
        }
        Header {
            magic: magic(),
            version: VERSION,
            order: geometry.order as u32,
            fingerprint: halves(geometry.fingerprint),
            origin: surfels.origin.to_array().map(|x| halves(x.to_bits())),
            occluder_scale: surfels.occluder_scale,
            fitted: if geometry.fitted { FITTED } else { 0 },
            points: geometry.places.len() as u32,
            surfels: surfels.len() as u32,
            facets: geometry.octree.facets.len() as u32,
            cones: geometry.octree.cones.len() as u32,
            boxes: shape.counts.len() as u32,
            occluders: shape.order.len() as u32,
            repairs: repairs as u32,
            orders: kept.links.m2l.len() as u32,
            m2l,
            sampled: kept.links.sampled.len() as u32,
            near: kept.links.near.len() as u32,
            left_out: kept.left_out.len() as u32,
        }
    }

    /// Bytes of the whole file.
    pub fn file_length(&self) -> u64 {
        let [points, n, facets, cones] =
            [self.points, self.surfels, self.facets, self.cones].map(u64::from);
        let rows = |targets: u64, len: u32, arrays: u64| targets + 1 + arrays * u64::from(len);
        let mut words = words_of::<Header>() + points + n * words_a_surfel();
        words += facets * words_of::<StoredFacet>() + cones;
        words += u64::from(self.boxes) + u64::from(self.occluders);
        words += u64::from(self.repairs.div_ceil(4));
        for len in &self.m2l[..(self.orders as usize).min(ORDERS)] {
            words += rows(facets, *len, 3);
        }
        words += rows(facets, self.sampled, 3) + rows(n, self.near, 2);
        words += rows(facets, self.left_out, 2);
        // The checksum is the end.
        4 * words + 8
    }
}

pub fn magic() -> [u32; 2] {
    halves(u64::from_le_bytes(MAGIC))
}

/// Lower and upper half.
fn halves(x: u64) -> [u32; 2] {
    [x as u32, (x >> 32) as u32]
}

pub fn whole([low, high]: [u32; 2]) -> u64 {
    u64::from(low) | u64::from(high) << 32
}

fn words_of<T>() -> u64 {
    size_of::<T>() as u64 / 4
}

/// Position, normal, area, tangent, corners, offset, depth, point, back.
fn words_a_surfel() -> u64 {
    3 + 3 + 1 + 3 + words_of::<[Vec2; MAX_EDGES]>() + 4
}
