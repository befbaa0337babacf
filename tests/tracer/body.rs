//! Rays against the bumpy body: |p - centre| = radius (1 + bumps noise(direction)).

use glam::DVec3;

use super::shape::through;
use super::{Hit, Ray};

/// A sphere with bumps, seen from outside.
pub struct Body {
    centre: DVec3,
    radius: f64,
    bumps: f64,
    /// Distances of the surface from the centre at the corners of a grid on a cube around it: six
    /// faces of (SIDE + 1)².
    table: Vec<f32>,
    /// Largest distance of the surface from the centre.
    reach: f64,
}

/// Cells along an edge of the cube. The table is off by less than `DOUBT`, as a test shows.
const SIDE: usize = 512;
/// Heights nearer to 0 than this, in radii, are calculated and not looked up.
const DOUBT: f64 = 1e-4;
/// Shortest step of a march, in radii: it jumps over crests of 1e-7 radii or so.
const STEP: f64 = 3e-4;
/// Upper bound of the slope of the height along a ray: 1 outwards, and across that of the bumps,
/// for bumps of 0.35 as the same test shows.
const SLOPE: f64 = 3.0;

/// Halvings of the last step, which is about as short as the shortest.
const HALVINGS: usize = 12;

/// As `scenes/organic.toml` has it: the noise of bumpy spheres, in [-1, 1].
fn noise(w: DVec3) -> f64 {
    let DVec3 { x, y, z } = w;
    let coarse = 0.18 * (4.0 * x + 1.0).sin() * (5.0 * y).sin();
    let medium = 0.12 * (7.0 * z + 2.0 * x).sin() * (6.0 * y - 1.0).cos();
    let fine = 0.05 * (15.0 * x).sin() * (13.0 * z).sin() * (14.0 * y + 0.5).sin();
    (coarse + medium + fine) / 0.35
}

/// Its gradient.
fn noise_gradient(w: DVec3) -> DVec3 {
    let DVec3 { x, y, z } = w;
    let (a, b) = ((4.0 * x + 1.0).sin_cos(), (5.0 * y).sin_cos());
    let coarse = 0.18 * DVec3::new(4.0 * a.1 * b.0, 5.0 * a.0 * b.1, 0.0);
    let (a, b) = ((7.0 * z + 2.0 * x).sin_cos(), (6.0 * y - 1.0).sin_cos());
    let medium = 0.12 * DVec3::new(2.0 * a.1 * b.1, -6.0 * a.0 * b.0, 7.0 * a.1 * b.1);
    let (a, b, c) = (
        (15.0 * x).sin_cos(),
        (13.0 * z).sin_cos(),
        (14.0 * y + 0.5).sin_cos(),
    );
    let fine = 0.05
        * DVec3::new(
            15.0 * a.1 * b.0 * c.0,
            14.0 * a.0 * b.0 * c.1,
            13.0 * a.0 * b.1 * c.0,
        );
    (coarse + medium + fine) / 0.35
}

impl Body {
    pub fn new(centre: DVec3, radius: f64, bumps: f64) -> Body {
        let corner = |k: usize| 2.0 * k as f64 / SIDE as f64 - 1.0;
        let mut table = Vec::with_capacity(6 * (SIDE + 1) * (SIDE + 1));
        for face in 0..6 {
            for i in 0..=SIDE {
                for j in 0..=SIDE {
                    let mut w = DVec3::ZERO;
                    let axis = face / 2;
                    w[axis] = if face % 2 == 0 { 1.0 } else { -1.0 };
                    w[(axis + 1) % 3] = corner(i);
                    w[(axis + 2) % 3] = corner(j);
                    let distance = radius * (1.0 + bumps * noise(w.normalize()));
                    table.push(distance as f32);
                }
            }
        }
        let most = table.iter().fold(0.0_f32, |m, r| r.max(m));
        Body {
            centre,
            radius,
            bumps,
            table,
            reach: f64::from(most) + DOUBT * radius,
        }
    }

    /// Height of a place, relative to the centre, above the surface in its direction.
    fn height(&self, p: DVec3) -> f64 {
        let distance = p.length();
        distance - self.radius * (1.0 + self.bumps * noise(p / distance))
    }

    /// The same from the table.
    fn about(&self, p: DVec3) -> f64 {
        let axis = p.abs().max_position();
        let face = 2 * axis + usize::from(p[axis] < 0.0);
        let scale = 1.0 / p[axis].abs();
        let cell = |x: f64| {
            let x = 0.5 * SIDE as f64 * (x * scale + 1.0);
            let k = (x as usize).min(SIDE - 1);
            (k, x - k as f64)
        };
        let (i, s) = cell(p[(axis + 1) % 3]);
        let (j, t) = cell(p[(axis + 2) % 3]);
        let row = |i: usize| {
            let k = (face * (SIDE + 1) + i) * (SIDE + 1) + j;
            let [low, high] = [k, k + 1].map(|k| f64::from(self.table[k]));
            low + t * (high - low)
        };
        p.length() - (row(i) + s * (row(i + 1) - row(i)))
    }

    fn normal(&self, p: DVec3) -> DVec3 {
        let distance = p.length();
        let w = p / distance;
        let slope = self.radius * self.bumps * noise_gradient(w) / distance;
        (w - (slope - w * slope.dot(w))).normalize()
    }

    pub fn meet(&self, ray: Ray, limit: f64) -> Option<Hit> {
        let [mut above, mut below] = self.march(ray, limit)?;
        let at = |t: f64| ray.from + ray.way * t - self.centre;
        for _ in 0..HALVINGS {
            let middle = 0.5 * (above + below);
            if self.height(at(middle)) < 0.0 {
                below = middle;
            } else {
                above = middle;
            }
        }
        Some(Hit {
            distance: above,
            normal: self.normal(at(above)),
        })
    }

    pub fn blocks(&self, ray: Ray, limit: f64) -> bool {
        self.march(ray, limit).is_some()
    }

    /// Goes along the ray by steps that the slope makes safe, up to the one that ends below the
    /// surface.
    fn march(&self, ray: Ray, limit: f64) -> Option<[f64; 2]> {
        let length = ray.way.length();
        let [enter, leave] = through(self.centre, self.reach, ray)?;
        let (mut before, mut t) = (0.0, enter.max(0.0));
        while t <= leave.min(limit) {
            let p = ray.from + ray.way * t - self.centre;
            let mut height = self.about(p);
            if height.abs() < DOUBT * self.radius {
                height = self.height(p);
            }
            if height < 0.0 {
                return Some([before, t]);
            }
            before = t;
            t += (height / SLOPE).max(STEP * self.radius) / length;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn table_and_slope_are_as_good_as_said() {
        use super::*;
        use rand::{RngExt, SeedableRng};

        let body = Body::new(DVec3::ZERO, 1.0, 0.35);
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(1);
        let (mut off, mut steepest, mut gradient) = (0.0_f64, 0.0_f64, 0.0_f64);
        for _ in 0..100_000 {
            let w = DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0)));
            let w = w.normalize();
            off = off.max((body.about(w) - body.height(w)).abs());
            let slope = 0.35 * noise_gradient(w) / (1.0 + 0.35 * noise(w));
            let across = (slope - w * slope.dot(w)).length();
            steepest = steepest.max(across.hypot(1.0));
            let step = DVec3::new(1e-5, -2e-5, 1.5e-5);
            let difference = noise(w + step) - noise(w - step);
            gradient = gradient.max((difference - 2.0 * noise_gradient(w).dot(step)).abs());
        }
        println!("table off by {off:.1e}, slope up to {steepest:.2}, gradient {gradient:.1e}");
        assert!(off < 0.5 * DOUBT && steepest < SLOPE && gradient < 1e-9);
    }
}
