//! Surfels: points as small pieces of surface, as structure of arrays.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Cells;
use crate::visibility::{NO_SURFEL, Segment};

/// The points that take part in the transport.
///
/// Positions are in the scan's unit, relative to `origin`; normals are of unit length; all arrays
/// have one entry a surfel.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    /// Middle of the cloud (component-wise median), in the scan's coordinates.
    pub origin: DVec3,
    /// Centres, relative to `origin`.
    pub positions: Vec<Vec3>,
    /// Unit normals; smoothed, where those of the cloud scatter.
    pub normals: Vec<Vec3>,
    /// Areas in unit².
    pub areas: Vec<f32>,
    /// Linear RGB in [0, 1].
    pub reflectance: Vec<Vec3>,
    /// Linear RGB radiant exitance.
    pub emission: Vec<Vec3>,
    /// The pieces of surface that the surfels stand for.
    pub cells: Cells,
    /// Distance above the surface at which segments start and end, a surfel (follows the noise).
    pub offsets: Vec<f32>,
    /// How far below their surfel the cells block light. On a convex surface tangent planes stand out,
    /// and a body of such cells would throw too large a shadow: the cells are sunk until their corners
    /// lie on the surface.
    pub depths: Vec<f32>,
    /// Scale of the cells as occluders (follows the noise; a little over 1 closes the seams).
    pub occluder_scale: f32,
    /// Index of each surfel's point in the cloud.
    pub points: Vec<u32>,
    /// Of a surfel that is one of two at one place, the index of the one that faces the other way; of others
    /// [`NO_SURFEL`]. Empty if there are none such. Where nothing says which side of a surface is lit, both
    /// are surfels, and a point gets the brighter light.
    pub backs: Vec<u32>,
}

/// A point this many radii beside a surfel is no part of it.
const FAR: f64 = 3.0;

impl Surfels {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The segment between two surfels whose blocking decides their visibility: from above one to
    /// above the other, their own cells not in the way.
    pub fn segment(&self, i: usize, j: usize) -> Segment {
        Segment {
            from: self.above(i).to_array(),
            skip_from: i as u32,
            to: self.above(j).to_array(),
            skip_to: j as u32,
        }
    }

    /// A segment from above a surfel to anywhere, its own cell not in the way.
    pub fn ray(&self, i: usize, way: Vec3) -> Segment {
        let from = self.above(i);
        Segment {
            from: from.to_array(),
            skip_from: i as u32,
            to: (from + way).to_array(),
            skip_to: NO_SURFEL,
        }
    }

    /// Length at which a ray from any surfel has left the cloud and all cells.
    pub fn reach(&self) -> f32 {
        let corner = |i: usize| {
            let corners = self.cells.corners[i].iter().map(|c| c.length());
            corners.fold(0.0, f32::max)
        };
        let farthest = |i: usize| {
            let cell = self.occluder_scale * corner(i) + self.depths[i];
            self.positions[i].length() + cell.max(self.offsets[i])
        };
        let all = (0..self.len()).into_par_iter().map(farthest);
        2.0 * all.reduce(|| 0.0, f32::max)
    }

    /// The surfel at the same place that faces the other way, if there is one.
    pub fn back(&self, i: usize) -> Option<usize> {
        let back = self.backs.get(i).filter(|&&back| back != NO_SURFEL);
        back.map(|&back| back as usize)
    }

    /// Where segments that end at a surfel end: its position, lifted along the normal.
    pub fn above(&self, i: usize) -> Vec3 {
        self.positions[i] + self.normals[i] * self.offsets[i]
    }

    /// Middle of the surfel's cell as an occluder.
    pub fn below(&self, i: usize) -> Vec3 {
        self.positions[i] - self.normals[i] * self.depths[i]
    }

    /// Whether a place of the scan is on the piece of surface that a surfel stands for, or close to it.
    pub fn stands_for(&self, k: usize, place: DVec3) -> bool {
        let at = self.origin + self.positions[k].as_dvec3();
        let radius = (f64::from(self.areas[k]) / PI).sqrt();
        at.distance(place) <= FAR * radius
    }

    /// The same surfels in another order, or some of them: entry k of the result is entry `order[k]`.
    /// Arrays that are not there yet stay so; a surfel whose back is left out has none.
    pub fn reordered(&self, order: &[u32]) -> Surfels {
        let mut backs = Vec::new();
        if !self.backs.is_empty() {
            let mut place = vec![NO_SURFEL; self.len()];
            (0..).zip(order).for_each(|(k, &i)| place[i as usize] = k);
            let of = |&i: &u32| self.back(i as usize).map_or(NO_SURFEL, |back| place[back]);
            backs.extend(order.iter().map(of));
        }
        fn pick<T: Copy + Send + Sync>(from: &[T], order: &[u32]) -> Vec<T> {
            match from.is_empty() {
                true => Vec::new(),
                false => order.par_iter().map(|&i| from[i as usize]).collect(),
            }
        }
        Surfels {
            origin: self.origin,
            positions: pick(&self.positions, order),
            normals: pick(&self.normals, order),
            areas: pick(&self.areas, order),
            reflectance: pick(&self.reflectance, order),
            emission: pick(&self.emission, order),
            cells: Cells {
                tangents: pick(&self.cells.tangents, order),
                corners: pick(&self.cells.corners, order),
            },
            offsets: pick(&self.offsets, order),
            depths: pick(&self.depths, order),
            occluder_scale: self.occluder_scale,
            points: pick(&self.points, order),
            backs,
        }
    }
}
