//! Polygons to triangles.

use earcut::Earcut;
use glam::{DVec2, DVec3};

/// The polygons of a mesh, as indices of vertices.
#[derive(Default)]
pub struct Polygons {
    corners: Vec<u32>,
    /// Where each polygon ends.
    ends: Vec<usize>,
}

impl Polygons {
    /// Adds a corner to the last polygon, which is not closed yet.
    pub fn add(&mut self, corner: u32) {
        self.corners.push(corner);
    }

    /// Closes the last polygon; returns the number of its corners.
    pub fn close(&mut self) -> usize {
        let begin = self.ends.last().copied().unwrap_or(0);
        self.ends.push(self.corners.len());
        self.corners.len() - begin
    }

    /// Triangles of all polygons: around the first corner, or cut off ear by ear where a polygon is not
    /// convex. What has fewer than three corners is left out and told in `repairs`.
    pub fn triangles(self, positions: &[DVec3], repairs: &mut Vec<String>) -> Vec<[u32; 3]> {
        let mut triangles = Vec::with_capacity(self.ends.len());
        let mut ears = Ears::default();
        let (mut begin, mut odd) = (0, 0);
        for &end in &self.ends {
            let corners = &self.corners[begin..end];
            begin = end;
            match corners {
                [] | [_] | [_, _] => odd += 1,
                &[a, b, c] => triangles.push([a, b, c]),
                [first, others @ ..] => {
                    if !ears.cut(corners, positions, &mut triangles) {
                        let fan = others.windows(2).map(|pair| [*first, pair[0], pair[1]]);
                        triangles.extend(fan);
                    }
                }
            }
        }
        if odd > 0 {
            repairs.push(format!("{odd} faces of fewer than three corners left out"));
        }
        triangles
    }
}

/// What cutting needs, kept from polygon to polygon.
#[derive(Default)]
struct Ears {
    earcut: Earcut<f64>,
    flat: Vec<DVec2>,
    found: Vec<u32>,
}

impl Ears {
    /// Cuts a polygon that is not convex; returns whether it did.
    fn cut(&mut self, corners: &[u32], positions: &[DVec3], to: &mut Vec<[u32; 3]>) -> bool {
        let place = |i: usize| positions[corners[i % corners.len()] as usize];
        let origin = place(0);
        let of_corner = |i: usize| (place(i) - origin).cross(place(i + 1) - origin);
        let normal: DVec3 = (1..corners.len() - 1).map(of_corner).sum();
        let Some(normal) = normal.try_normalize() else {
            return false;
        };
        let (u, v) = normal.any_orthonormal_pair();
        self.flat.clear();
        self.flat.extend((0..corners.len()).map(|i| {
            let p = place(i) - origin;
            DVec2::new(p.dot(u), p.dot(v))
        }));
        if !self.flat.iter().all(|p| p.is_finite()) {
            return false;
        }
        let n = self.flat.len();
        let turns_left = |i: usize| {
            let [a, b, c] = [i, i + 1, i + 2].map(|k| self.flat[k % n]);
            let (one, next) = (b - a, c - b);
            one.perp_dot(next) >= -1e-9 * one.length() * next.length()
        };
        if (0..n).all(turns_left) {
            return false;
        }
        let points = self.flat.iter().map(|p| p.to_array());
        self.earcut.earcut(points, &[], &mut self.found);
        let whole = self.found.chunks_exact(3).map(|ear| {
            let [a, b, c] = [0, 1, 2].map(|k| ear[k] as usize);
            // The side of the polygon is that of its triangles.
            let area = (self.flat[b] - self.flat[a]).perp_dot(self.flat[c] - self.flat[a]);
            match area < 0.0 {
                true => [a, c, b],
                false => [a, b, c],
            }
        });
        to.extend(whole.map(|ear| ear.map(|k| corners[k])));
        true
    }
}
