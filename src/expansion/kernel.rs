//! The discrete operator between two surfels: one definition for truth, CPU and WGSL.

use glam::Vec3;
use rayon::prelude::*;

use super::polygon_form_factor;
use crate::math::{Real, Vector};
use crate::points::{MAX_EDGES, Surfels};

/// Pairs closer than this many spacings (square root of the larger area) take the exact form
/// factor of the source's cell; farther ones the point kernel.
///
/// No distance of a lattice: where pairs lie exactly at the limit, rounding would decide on which side.
pub const NEAR_SPACINGS: f64 = 2.02;

/// max(0, n_x·(y-x)) max(0, n_y·(x-y)) / (π |x-y|⁴), in 1/unit²; 0 where x = y.
#[inline(always)]
pub fn point_kernel<T: Real>(x: T::Vec3, n_x: T::Vec3, y: T::Vec3, n_y: T::Vec3) -> T {
    let r = y - x;
    let cos_x = n_x.dot(r);
    let cos_y = -n_y.dot(r);
    if cos_x > T::ZERO && cos_y > T::ZERO {
        // Not divided by r⁴, which leaves the range of f32 at lengths of 1e-9 and 1e9.
        let inverse = T::ONE / r.dot(r);
        (cos_x * inverse) * (cos_y * inverse) / T::PI
    } else {
        T::ZERO
    }
}

/// Surfels as the operator sees them, in the reals of a pass.
#[derive(Clone, Debug)]
pub struct Surface<T: Real> {
    pub positions: Vec<T::Vec3>,
    pub normals: Vec<T::Vec3>,
    pub areas: Vec<T>,
    /// Corners of the cells in space, relative to the surfel's position.
    corners: Vec<[T::Vec3; MAX_EDGES]>,
}

impl<T: Real> Surface<T> {
    pub fn new(surfels: &Surfels) -> Self {
        let corners = |i: usize| {
            let normal = T::Vec3::from_f32(surfels.normals[i]);
            let tangent = T::Vec3::from_f32(surfels.cells.tangents[i]);
            let bitangent = normal.cross(tangent);
            surfels.cells.corners[i]
                .map(|c| tangent * T::from_f32(c.x) + bitangent * T::from_f32(c.y))
        };
        let vectors =
            |vectors: &[Vec3]| vectors.par_iter().map(|&v| T::Vec3::from_f32(v)).collect();
        Surface {
            positions: vectors(&surfels.positions),
            normals: vectors(&surfels.normals),
            areas: surfels.areas.iter().map(|&a| T::from_f32(a)).collect(),
            corners: (0..surfels.len()).into_par_iter().map(corners).collect(),
        }
    }

    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// A_j K(i, j): the form factor of a far pair.
    #[inline(always)]
    pub fn point_form_factor(&self, i: usize, j: usize) -> T {
        let (x, y) = (self.positions[i], self.positions[j]);
        self.areas[j] * point_kernel::<T>(x, self.normals[i], y, self.normals[j])
    }

    /// Pairs so close that the source is its cell and not a point.
    #[inline(always)]
    pub fn is_near(&self, i: usize, j: usize) -> bool {
        let r = self.positions[j] - self.positions[i];
        let near = T::from_f64(NEAR_SPACINGS * NEAR_SPACINGS) * self.areas[i].max(self.areas[j]);
        r.dot(r) < near
    }

    /// Form factor F_ij without occlusion: the part of what surfel j sends out (radiosity 1) that
    /// surfel i gets as irradiance. Far: A_j K(i, j). Near: the exact form factor of cell j.
    #[inline]
    pub fn form_factor(&self, i: usize, j: usize) -> T {
        let (x, y) = (self.positions[i], self.positions[j]);
        let r = y - x;
        if !self.is_near(i, j) {
            return self.point_form_factor(i, j);
        }
        if i == j || self.normals[j].dot(r) >= T::ZERO {
            return T::ZERO; // a cell does not light its own plane or what lies behind it
        }
        // Its formula squares areas, which at lengths of 1e-12 leave the range of f32.
        let scale = T::ONE / r.length();
        polygon_form_factor::<T>(self.normals[i], &self.corners[j].map(|c| (r + c) * scale))
    }
}
