//! A facet: surfels close together and of similar normal.

use glam::Vec3;

use super::Cell;

/// One node of the octree. Lengths in the scan's unit, relative to the surfels' origin.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facet {
    /// Its surfels: `begin..end` in the octree's order.
    pub begin: u32,
    pub end: u32,
    /// Index of the parent; the root is its own.
    pub parent: u32,
    /// First child; children are `first_child..first_child + child_count`, none for a leaf.
    pub first_child: u32,
    pub child_count: u32,
    /// Its cube: of a leaf the octant as which it was split off, of others the smallest one around
    /// all its surfels. In larger cubes, up to the octant as which it was split off, it is alone.
    /// Facets above the cones, and a leaf alone in its cone, have the common cube and the smallest.
    pub cell: Cell,
    /// Mean of the positions, weighted by area: centre of the expansions.
    pub centre: Vec3,
    /// Largest distance of a surfel's position from the centre.
    pub radius: f32,
    /// Box of the positions.
    pub low: Vec3,
    pub high: Vec3,
    /// Mean normal, unit length.
    pub axis: Vec3,
    /// Largest angle between a normal and the axis: its sine, 1 from a right angle on.
    pub spread: f32,
    /// Least and largest `axis · (position - centre)`: the slab that holds the positions.
    pub slab: [f32; 2],
    /// Sum of the areas.
    pub area: f32,
    /// Square root of the largest area.
    pub spacing: f32,
    /// Largest distance of a cell's corner from its surfel.
    pub reach: f32,
}

impl Facet {
    pub fn is_leaf(&self) -> bool {
        self.child_count == 0
    }

    pub fn len(&self) -> usize {
        (self.end - self.begin) as usize
    }

    pub fn is_empty(&self) -> bool {
        self.begin == self.end
    }

    pub fn mean_area(&self) -> f32 {
        self.area / self.len() as f32
    }

    pub fn surfels(&self) -> std::ops::Range<usize> {
        self.begin as usize..self.end as usize
    }

    pub fn children(&self) -> std::ops::Range<u32> {
        self.first_child..self.first_child + self.child_count
    }

    /// Length by which expansion coefficients are scaled: the radius, or the spacing for a single
    /// place.
    pub fn scale(&self) -> f32 {
        if self.radius > 0.0 {
            self.radius
        } else {
            self.spacing
        }
    }
}
