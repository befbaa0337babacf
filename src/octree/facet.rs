//! A facet: surfels close together and of similar normal.

use glam::{DVec3, Vec3};

use crate::points::Surfels;

/// One node of the octree. Lengths in the scan's unit, relative to the surfels' origin.
#[derive(Clone, Debug)]
pub struct Facet {
    /// Its surfels: `begin..end` in the octree's order.
    pub begin: u32,
    pub end: u32,
    /// Index of the parent; the root is its own.
    pub parent: u32,
    /// First child; children are `first_child..first_child + child_count`, none for a leaf.
    pub first_child: u32,
    pub child_count: u32,
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
    /// Least and largest `axis · position`: the slab that holds the positions.
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

    /// Measures the facet that consists of these surfels.
    pub(super) fn measure(surfels: &Surfels, members: &[u32], begin: u32, parent: u32) -> Facet {
        let positions = || {
            members
                .iter()
                .map(|&i| surfels.positions[i as usize].as_dvec3())
        };
        let normals = || {
            members
                .iter()
                .map(|&i| surfels.normals[i as usize].as_dvec3())
        };
        let areas = || {
            members
                .iter()
                .map(|&i| f64::from(surfels.areas[i as usize]))
        };

        let area: f64 = areas().sum();
        let mean = |values: &mut dyn Iterator<Item = DVec3>| -> DVec3 {
            let weighted: DVec3 = values.zip(areas()).map(|(v, a)| v * a).sum();
            weighted / area
        };
        let centre = mean(&mut positions());
        let axis = mean(&mut normals()).try_normalize();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut radius = 0.0_f64;
        let mut slab = [f64::INFINITY, f64::NEG_INFINITY];
        // The sine by a cross product: that of equal normals is zero, not the root of a rounding.
        let mut spread = if axis.is_some() { 0.0_f64 } else { 1.0 };
        let direction = axis.unwrap_or(DVec3::Z);
        for (p, n) in positions().zip(normals()) {
            low = low.min(p);
            high = high.max(p);
            radius = radius.max(p.distance(centre));
            let height = direction.dot(p);
            slab = [slab[0].min(height), slab[1].max(height)];
            spread = spread.max(if direction.dot(n) > 0.0 {
                direction.cross(n).length().min(1.0)
            } else {
                1.0
            });
        }
        Facet {
            begin,
            end: begin + members.len() as u32,
            parent,
            first_child: 0,
            child_count: 0,
            centre: centre.as_vec3(),
            radius: radius as f32,
            low: low.as_vec3(),
            high: high.as_vec3(),
            axis: direction.as_vec3(),
            spread: spread as f32,
            slab: [slab[0] as f32, slab[1] as f32],
            area: area as f32,
            spacing: areas().fold(0.0, f64::max).sqrt() as f32,
            reach: members
                .iter()
                .flat_map(|&i| surfels.cells.corners[i as usize])
                .fold(0.0, |reach, corner| corner.length().max(reach)),
        }
    }
}
