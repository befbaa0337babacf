//! A point cloud as it was read.

use std::ops::Range;

use glam::{DVec3, Vec3};

/// Reflectance of points that carry no colour.
pub const DEFAULT_REFLECTANCE: f32 = 0.5;
/// Largest reflectance that an 8- or 16-bit colour stands for: white is 0.9, no real wall is 1.
pub const MAX_COLOUR_REFLECTANCE: f32 = 0.9;

/// Points in the order, unit and coordinates of their source.
///
/// All arrays that are present have one entry a point.
#[derive(Clone, Debug, Default)]
pub struct PointCloud {
    /// Positions in the scan's unit, at full precision.
    pub positions: Vec<DVec3>,
    /// Normals, of any length; empty when the source has none.
    pub normals: Vec<Vec3>,
    /// Surface areas in unit²; empty when the source has none (cells give them then).
    pub areas: Vec<f32>,
    /// Linear RGB in [0, 1].
    pub reflectance: Vec<Vec3>,
    /// Linear RGB radiant exitance; zero where a point does not shine.
    pub emission: Vec<Vec3>,
    /// Where points were measured from, as far as the source tells; ranges in ascending order.
    pub scanners: Vec<Scanner>,
    /// Repairs that reading made, each as "count what": shown to the user.
    pub repairs: Vec<String>,
}

/// A place that some points were measured from: their surfaces face it.
#[derive(Clone, Debug, PartialEq)]
pub struct Scanner {
    /// In the coordinates of the points.
    pub position: DVec3,
    /// The points of this scan.
    pub points: Range<usize>,
}

impl PointCloud {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }
}
