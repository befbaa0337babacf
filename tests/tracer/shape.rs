//! Rays against quads and spheres.

use glam::DVec3;

use super::{Hit, Ray};

/// A parallelogram, less a hole with edges along its own.
pub struct Quad {
    corner: DVec3,
    u: DVec3,
    v: DVec3,
    /// Vectors whose products with a way from the corner are its parts along u and v.
    along: [DVec3; 2],
    /// [[from, to]; 2] in parts of u and v.
    hole: Option<[[f64; 2]; 2]>,
    pub normal: DVec3,
    /// Without the hole.
    pub area: f64,
}

impl Quad {
    /// Seen from the side that u × v points to.
    pub fn new(corner: DVec3, u: DVec3, v: DVec3) -> Quad {
        let across = u.cross(v);
        let square = across.length_squared();
        Quad {
            corner,
            u,
            v,
            along: [v.cross(across) / square, across.cross(u) / square],
            hole: None,
            normal: across.normalize(),
            area: across.length(),
        }
    }

    /// With a hole from..to, in lengths along u and v.
    pub fn with_hole(mut self, u: [f64; 2], v: [f64; 2]) -> Quad {
        let part = |range: [f64; 2], edge: DVec3| range.map(|x| x / edge.length());
        self.hole = Some([part(u, self.u), part(v, self.v)]);
        self
    }

    /// Place at parts s and t of the edges.
    pub fn at(&self, [s, t]: [f64; 2]) -> DVec3 {
        self.corner + self.u * s + self.v * t
    }

    pub fn meet(&self, ray: Ray) -> Option<Hit> {
        let distance = self.normal.dot(self.corner - ray.from) / self.normal.dot(ray.way);
        // Neither behind, nor NaN or infinite where the ray runs along the plane.
        if !(distance > 0.0 && distance < f64::INFINITY) {
            return None;
        }
        let way = ray.from + ray.way * distance - self.corner;
        let parts = self.along.map(|a| a.dot(way));
        let within = |k: usize, [from, to]: [f64; 2]| parts[k] > from && parts[k] < to;
        let inside = (0..2).all(|k| within(k, [0.0, 1.0]));
        let in_hole = self
            .hole
            .is_some_and(|hole| (0..2).all(|k| within(k, hole[k])));
        (inside && !in_hole).then_some(Hit {
            distance,
            normal: self.normal,
        })
    }
}

/// A sphere seen from inside or outside.
pub struct Ball {
    pub centre: DVec3,
    pub radius: f64,
    pub inward: bool,
}

impl Ball {
    pub fn meet(&self, ray: Ray) -> Option<Hit> {
        let distance = through(self.centre, self.radius, ray)?
            .into_iter()
            .find(|&t| t > 0.0)?;
        let out = (ray.from + ray.way * distance - self.centre) / self.radius;
        Some(Hit {
            distance,
            normal: if self.inward { -out } else { out },
        })
    }
}

/// The two distances at which the line of a ray goes through a sphere.
pub fn through(centre: DVec3, radius: f64, ray: Ray) -> Option<[f64; 2]> {
    let offset = ray.from - centre;
    let a = ray.way.length_squared();
    let b = offset.dot(ray.way);
    let c = offset.length_squared() - radius * radius;
    let root = (b * b - a * c).sqrt(); // NaN where the line passes by
    // Of the two roots the one without cancellation gives the other.
    let q = -b - root.copysign(b);
    let (s, t) = (q / a, c / q);
    (root >= 0.0 && q != 0.0).then_some([s.min(t), s.max(t)])
}
