//! Surfels: points as small pieces of surface, as structure of arrays.

use glam::{DVec3, Vec3};

use super::Cells;

/// The points that take part in the transport.
///
/// Positions are in the scan's unit, relative to `origin`; normals are of unit length; all arrays
/// have one entry a surfel.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    /// Centre of the cloud's box, in the scan's coordinates.
    pub origin: DVec3,
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    /// Areas in unit².
    pub areas: Vec<f32>,
    pub reflectance: Vec<Vec3>,
    pub emission: Vec<Vec3>,
    pub cells: Cells,
    /// Distance above the surface at which segments start and end, a surfel (follows the noise).
    pub offsets: Vec<f32>,
    /// Scale of the cells as occluders (follows the noise; a little over 1 closes the seams).
    pub occluder_scale: f32,
    /// Index of each surfel's point in the cloud.
    pub points: Vec<u32>,
}

impl Surfels {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }
}
