//! Triangles to points: samples that stand for equal shares of the surface.
//!
//! The surface is made a line: triangles in Morton order, each walked through by bisection at its
//! longest edge, which halves the area at every step. Samples lie at equal distances along the line
//! (systematic sampling, from a random start), moved to the middle of their piece, so that they keep
//! a distance from each other.

use std::path::Path;

use glam::{DVec3, Vec3};
use rand::RngExt;
use rayon::prelude::*;

use super::ReadOptions;
use crate::error::{Error, Result};
use crate::memory;
use crate::octree::morton_codes;
use crate::points::PointCloud;
use crate::progress::Progress;
use crate::random::{Purpose, stream};
use crate::scene::DEFAULT_POINTS;

/// How far a sample may be from the middle of its piece, relative to the piece.
const JITTER: f64 = 0.3;
/// Most bisections of a triangle; more would not change an f64.
const DEEPEST: u32 = 40;

/// A triangle mesh.
pub(super) struct Mesh {
    /// Its points are the vertices; their reflectance and emission are interpolated.
    vertices: PointCloud,
    triangles: Vec<[u32; 3]>,
}

impl Mesh {
    pub fn new(vertices: PointCloud, triangles: Vec<[u32; 3]>) -> Self {
        Mesh {
            vertices,
            triangles,
        }
    }

    /// Normals of the vertices: the mean of the faces around, weighted by area; zero where there is
    /// no face.
    pub fn normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
        let mut normals = vec![DVec3::ZERO; positions.len()];
        for triangle in triangles {
            let [a, b, c] = triangle.map(|i| positions[i as usize]);
            let area = (b - a).cross(c - a);
            if area.is_finite() {
                triangle.iter().for_each(|&i| normals[i as usize] += area);
            }
        }
        let unit = |n: DVec3| n.normalize_or_zero().as_vec3();
        normals.into_par_iter().map(unit).collect()
    }

    /// Points on the faces, with the normals of the faces; each stands for the same area.
    pub fn sample(
        self,
        path: &Path,
        options: &ReadOptions,
        progress: &dyn Progress,
    ) -> Result<PointCloud> {
        let faces = self.faces();
        let left_out = self.triangles.len() - faces.len();
        let below: Vec<f64> = faces
            .iter()
            .scan(0.0, |sum, face| {
                *sum += face.area;
                Some(*sum)
            })
            .collect();
        let total = below.last().copied().unwrap_or(0.0);
        if !(total > 0.0 && total.is_finite()) {
            return Err(Error::input(
                path,
                "the faces have no area (or too large a one)",
            ));
        }
        let wanted = match (options.points, options.spacing) {
            (Some(points), _) => points as f64,
            (None, Some(spacing)) => (total / (spacing * spacing)).round().max(1.0),
            (None, None) => DEFAULT_POINTS as f64,
        };
        memory::check_points(wanted as u64)
            .map_err(|error| Error::TooLarge(format!("{}: {error}", path.display())))?;
        let count = wanted as usize;
        progress.stage("sampling mesh", count as u64);
        progress.check()?;

        let share = total / wanted;
        let start: f64 = stream(options.seed, Purpose::Mesh, 0).random();
        let samples: Vec<(&Face, DVec3)> = (0..count)
            .into_par_iter()
            .map(|k| {
                let target = (k as f64 + start) * share;
                let i = below.partition_point(|&area| area <= target);
                let i = i.min(faces.len() - 1);
                let face = &faces[i];
                let part = (target - (below[i] - face.area)) / face.area;
                // Pieces of up to a share, so that no two samples get the same one.
                let steps = (face.area / share).log2().ceil().max(0.0) as u32;
                let piece = face.piece(part.clamp(0.0, 1.0), steps.min(DEEPEST));
                let random = &mut stream(options.seed, Purpose::Mesh, 1 + k as u64);
                let [u, v] = [(); 2].map(|()| random.random::<f64>());
                let [u, v] = if u + v > 1.0 {
                    [1.0 - u, 1.0 - v]
                } else {
                    [u, v]
                };
                let middle = DVec3::splat(1.0 / 3.0);
                let inside = middle.lerp(DVec3::new(1.0 - u - v, u, v), JITTER);
                let [a, b, c] = piece;
                (face, inside.x * a + inside.y * b + inside.z * c)
            })
            .collect();
        progress.advance(count as u64);

        let mix = |values: &[Vec3], face: &Face, weights: DVec3| {
            let [a, b, c] = face.vertices.map(|i| values[i as usize]);
            let [u, v, w] = weights.as_vec3().to_array();
            u * a + v * b + w * c
        };
        let each = |of: &(dyn Fn(&Face, DVec3) -> Vec3 + Sync)| {
            samples.par_iter().map(|&(face, at)| of(face, at)).collect()
        };
        let mut repairs = self.vertices.repairs.clone();
        if left_out > 0 {
            repairs.push(format!("{left_out} faces without area left out"));
        }
        Ok(PointCloud {
            positions: samples.par_iter().map(|&(face, at)| face.at(at)).collect(),
            normals: each(&|face, _| face.normal.as_vec3()),
            areas: vec![share as f32; count],
            reflectance: each(&|face, at| mix(&self.vertices.reflectance, face, at)),
            emission: each(&|face, at| mix(&self.vertices.emission, face, at)),
            repairs,
            ..PointCloud::default()
        })
    }

    /// The faces that have an area, in Morton order of their middles.
    fn faces(&self) -> Vec<Face> {
        let positions = &self.vertices.positions;
        let face = |&vertices: &[u32; 3]| {
            let corners = vertices.map(|i| positions[i as usize]);
            let [a, b, c] = corners;
            let normal = (b - a).cross(c - a);
            let area = 0.5 * normal.length();
            (area > 0.0 && area.is_finite()).then(|| Face {
                vertices,
                corners,
                normal: normal.normalize(),
                area,
            })
        };
        let faces: Vec<Face> = self.triangles.par_iter().filter_map(face).collect();
        let origin = faces.first().map_or(DVec3::ZERO, Face::middle);
        let middles: Vec<Vec3> = faces
            .par_iter()
            .map(|face| (face.middle() - origin).as_vec3())
            .collect();
        let mut sorted: Vec<(u64, Face)> = morton_codes(&middles).zip(faces).collect();
        sorted.par_sort_by_key(|&(code, _)| code);
        sorted.into_par_iter().map(|(_, face)| face).collect()
    }
}

struct Face {
    vertices: [u32; 3],
    corners: [DVec3; 3],
    normal: DVec3,
    area: f64,
}

impl Face {
    fn middle(&self) -> DVec3 {
        self.at(DVec3::splat(1.0 / 3.0))
    }

    /// The place with these weights of the corners.
    fn at(&self, weights: DVec3) -> DVec3 {
        let [a, b, c] = self.corners;
        // Relative to a corner, so that large coordinates keep their digits.
        a + weights.y * (b - a) + weights.z * (c - a)
    }

    /// The piece at a part of the area (0 to 1) along the way through the triangle that bisects it
    /// so many times: its corners as weights of those of the triangle.
    fn piece(&self, mut part: f64, steps: u32) -> [DVec3; 3] {
        let mut corners = [DVec3::X, DVec3::Y, DVec3::Z];
        for _ in 0..steps {
            let places = corners.map(|weights| self.at(weights));
            let length = |i: usize| places[(i + 1) % 3].distance_squared(places[(i + 2) % 3]);
            // The way comes in at the first corner; its half comes first.
            let apex = (1..3).fold(0, |best, i| if length(i) > length(best) { i } else { best });
            let [a, b] = match apex {
                0 => [corners[1], corners[2]],
                1 => [corners[0], corners[2]],
                _ => [corners[0], corners[1]],
            };
            let (c, middle) = (corners[apex], 0.5 * (a + b));
            part *= 2.0;
            corners = if part < 1.0 {
                [a, c, middle]
            } else {
                part -= 1.0;
                [c, b, middle]
            };
        }
        corners
    }
}
