//! A point cloud as it was read.

use std::ops::Range;

use glam::{DVec3, Vec3};

use crate::scene::LARGEST;

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
    /// Points that their source marks as none of the surface, as noise; empty if there are none.
    pub flagged: Vec<bool>,
    /// The grid that all coordinates lie on, where the source has one.
    pub grid: Option<Grid>,
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

/// A grid of coordinates, as LAS files have it: a coordinate is `scale` times a 32-bit integer, plus
/// `offset`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Grid {
    pub scale: DVec3,
    pub offset: DVec3,
    /// What the coordinates refer to: numbers and contents of the records `LASF_Projection`.
    pub reference: Vec<(u16, Vec<u8>)>,
}

impl PointCloud {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Whether a point has a place, and is no flagged one.
    pub(crate) fn is_placed(&self, i: usize) -> bool {
        let placed = self.positions[i].abs().cmple(DVec3::splat(LARGEST)).all();
        placed && !self.is_flagged(i)
    }

    pub(crate) fn is_flagged(&self, i: usize) -> bool {
        self.flagged.get(i) == Some(&true)
    }
}
