//! The cell of a surfel: its tangent-plane Voronoi polygon.

use glam::{Vec2, Vec3};

/// Largest number of edges of a cell, so that a GPU can hold it.
pub const MAX_EDGES: usize = 8;

/// Convex polygons, one a surfel, in the tangent plane through the surfel's position.
///
/// A corner (a, b) lies at `position + a * tangent + b * (normal × tangent)`. Corners go round
/// counter-clockwise seen from the tip of the normal; unused ones repeat the last corner, so that
/// an edge between them has no length and a loop over all [`MAX_EDGES`] needs no count.
#[derive(Clone, Debug, Default)]
pub struct Cells {
    /// Unit vectors orthogonal to the surfel's normal.
    pub tangents: Vec<Vec3>,
    pub corners: Vec<[Vec2; MAX_EDGES]>,
}
