//! The surface at a point where it bends: a paraboloid over its tangent plane.

use glam::{DVec3, Vec3};

use super::plane::{Around, OFF, Plane, Weighted, bell};

/// Height over a plane: f + d x + e y + a x² + b x y + c y², with lengths in radii of the footprint.
#[derive(Clone, Copy, Debug)]
pub(super) struct Curved {
    frame: [DVec3; 3],
    radius: f64,
    coefficients: [f64; TERMS],
}

const TERMS: usize = 6;
/// Rounds of fitting and weighing.
const ROUNDS: usize = 6;
/// Points that a paraboloid is laid through, at least.
const AT_LEAST: usize = 9;
/// Curvature counts as so many points that say that there is none, at the rim.
const STIFF: f64 = 0.02;
/// Of a surface with a radius of curvature below this part of the footprint's a tangent plane says nothing.
const ROUNDEST: f64 = 0.45;
/// Points may be off by this part of the footprint's radius: surfaces are no paraboloids.
const SLACK: f32 = 0.02;

impl Curved {
    /// The paraboloid near a plane that most places agree with; `None` where they lie on none, or it bends too
    /// much.
    pub fn fit(around: &Around, start: &Plane) -> Option<Curved> {
        let normal = start.normal.as_dvec3();
        let (x, y) = normal.any_orthonormal_pair();
        let mut curved = Curved {
            frame: [x, y, normal],
            radius: f64::from(around.radius),
            coefficients: [0.0; TERMS],
        };
        curved.coefficients[0] = -f64::from(start.height(Vec3::ZERO)) / curved.radius;
        let tolerance = tolerance(around);
        for round in 0..ROUNDS {
            // From far off to as near as points are.
            let wide = (1 << (ROUNDS - 1 - round).min(4)) as f32;
            let weighted = (0..around.places.len()).map(|k| {
                let miss = curved.miss(around.places[k]) / (wide * tolerance);
                let seen = f32::from(around.is_seen_with(start.normal, k));
                (around.places[k], seen * bell(miss) * around.near(k))
            });
            curved.coefficients = curved.through(weighted, STIFF)?;
        }
        let on = (0..around.places.len()).filter(|&k| curved.off(around, k) <= 1.0);
        let on = on.count();
        (on >= AT_LEAST && curved.roundest() < 1.0 / ROUNDEST).then_some(curved)
    }

    /// The coefficients by least squares.
    fn through(
        &self,
        places: impl Iterator<Item = (Vec3, f32)>,
        stiff: f64,
    ) -> Option<[f64; TERMS]> {
        let mut matrix = [[0.0; TERMS]; TERMS];
        let mut right = [0.0; TERMS];
        for (place, weight) in places {
            let weight = f64::from(weight);
            let (terms, height) = self.terms(place);
            for (k, term) in terms.iter().enumerate() {
                right[k] += weight * term * height;
                (matrix[k].iter_mut().zip(terms)).for_each(|(m, t)| *m += weight * term * t);
            }
        }
        for (k, row) in matrix.iter_mut().enumerate().skip(3) {
            row[k] += stiff;
        }
        solve(matrix, right)
    }

    /// How far place k is off it, in what is allowed.
    pub fn off(&self, around: &Around, k: usize) -> f32 {
        match around.is_seen_with(self.frame[2].as_vec3(), k) {
            true => self.miss(around.places[k]).abs() / (OFF * tolerance(around)),
            false => f32::INFINITY,
        }
    }

    /// The tangent plane over the origin.
    pub fn tangent(&self) -> Plane {
        let [x, y, normal] = self.frame;
        let [f, d, e, ..] = self.coefficients;
        Plane {
            normal: (normal - d * x - e * y).normalize().as_vec3(),
            centre: (f * self.radius * normal).as_vec3(),
            along: [0.0; 2],
        }
    }

    /// The principal curvatures where it is over the origin, the larger one first, with their directions; positive
    /// where the surface bends toward its normal.
    pub fn principal(&self) -> [(f64, DVec3); 2] {
        let [x, y, _] = self.frame;
        let [.., a, b, c] = self.coefficients;
        let angle = 0.5 * b.atan2(a - c);
        let (mean, half) = (a + c, ((a - c).powi(2) + b * b).sqrt());
        let along = angle.cos() * x + angle.sin() * y;
        let across = angle.cos() * y - angle.sin() * x;
        let both = [(mean + half, along), (mean - half, across)];
        let both = both.map(|(bend, way)| (bend / self.radius, way));
        match both[0].0.abs() < both[1].0.abs() {
            true => [both[1], both[0]],
            false => both,
        }
    }

    /// How far a place is off, along the normal of the plane.
    fn miss(&self, place: Vec3) -> f32 {
        let (terms, height) = self.terms(place);
        let on: f64 = terms
            .iter()
            .zip(self.coefficients)
            .map(|(t, c)| t * c)
            .sum();
        ((height - on) * self.radius) as f32
    }

    /// What the coefficients of a place are multiplied with, and its height.
    fn terms(&self, place: Vec3) -> ([f64; TERMS], f64) {
        let [x, y, z] = self
            .frame
            .map(|axis| axis.dot(place.as_dvec3()) / self.radius);
        ([1.0, x, y, x * x, x * y, y * y], z)
    }

    /// The larger principal curvature, over the radius.
    fn roundest(&self) -> f64 {
        let [.., a, b, c] = self.coefficients;
        (a + c).abs() + ((a - c).powi(2) + b * b).sqrt()
    }
}

/// How far points may be off, as one deviation.
fn tolerance(around: &Around) -> f32 {
    around.noise + SLACK * around.radius
}

/// Standard deviation of places from the paraboloid through all of them; `None` if they lie along a line.
pub(super) fn deviation(places: &[Vec3]) -> Option<f32> {
    let plane = Weighted::of(places.iter().map(|&p| (p, 1.0))).plane()?;
    let radius = places.iter().map(|p| p.length()).fold(0.0, f32::max);
    if !plane.is_wide() || places.len() <= TERMS {
        return None;
    }
    let (x, y) = plane.normal.as_dvec3().any_orthonormal_pair();
    let mut curved = Curved {
        frame: [x, y, plane.normal.as_dvec3()],
        radius: f64::from(radius),
        coefficients: [0.0; TERMS],
    };
    curved.coefficients = curved.through(places.iter().map(|&p| (p, 1.0)), 0.0)?;
    let square: f32 = places.iter().map(|&p| curved.miss(p).powi(2)).sum();
    Some((square / (places.len() - TERMS) as f32).sqrt())
}

/// Solves a symmetric positive definite system (Cholesky); `None` if it is none.
pub(super) fn solve<const N: usize>(mut m: [[f64; N]; N], mut x: [f64; N]) -> Option<[f64; N]> {
    for k in 0..N {
        for j in 0..k {
            let dot: f64 = (0..j).map(|l| m[k][l] * m[j][l]).sum();
            m[k][j] = (m[k][j] - dot) / m[j][j];
        }
        let rest = m[k][k] - (0..k).map(|l| m[k][l] * m[k][l]).sum::<f64>();
        if rest <= 1e-12 {
            return None;
        }
        m[k][k] = rest.sqrt();
    }
    for k in 0..N {
        let dot: f64 = (0..k).map(|l| m[k][l] * x[l]).sum();
        x[k] = (x[k] - dot) / m[k][k];
    }
    for k in (0..N).rev() {
        let dot: f64 = (k + 1..N).map(|l| m[l][k] * x[l]).sum();
        x[k] = (x[k] - dot) / m[k][k];
    }
    Some(x)
}
