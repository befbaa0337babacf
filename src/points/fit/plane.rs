//! The plane of the surface at a point: that of most of the points around, not of all of them.

use glam::{DVec3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::points::plane::least_axis;

/// Planes through the point and two of its neighbours that are tried.
const TRIALS: usize = 24;
/// No others are tried if one holds for this part of the neighbours: 0.82 is what noise leaves of all.
const CLEAR: f32 = 0.75;
/// Neighbours that are drawn from for that, and those that a trial is judged by.
const DRAWN_FROM: usize = 24;
const JUDGES: usize = 96;
/// Rounds of fitting and weighing.
const ROUNDS: usize = 4;
/// What noise is taken for, in deviations, by those who judge a flat surface, as the point itself is off by some, and in
/// the rounds.
const JUDGED: f32 = 2.0;
const WIDE: [f32; 3] = [4.0, 2.0, 1.0];
/// Points this many deviations off a plane are no part of it.
pub(super) const OFF: f32 = 2.5;
/// A surface bends away from its tangent plane by up to this part of r² / R within the radius R: one
/// whose radius of curvature is 2.5 R or more is met whole, a rounder one near the point.
const BENT: f32 = 0.2;
/// Points off a plane by this many deviations of their noise, in the mean, say that the surface bends.
const BENDING: f32 = 1.5;
/// A plane whose points lie within such a part of their length across is a line.
const LINE: f32 = 0.04;

/// Weighted sums of places.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Weighted {
    weight: f64,
    sum: DVec3,
    squares: [f64; 6],
}

/// A plane by least squares.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub normal: Vec3,
    pub centre: Vec3,
    /// Variances along the plane, the smaller one first.
    pub along: [f32; 2],
}

impl Weighted {
    pub fn of(places: impl Iterator<Item = (Vec3, f32)>) -> Weighted {
        let mut sums = Weighted::default();
        for (place, weight) in places {
            let (p, w) = (place.as_dvec3(), f64::from(weight));
            sums.weight += w;
            sums.sum += w * p;
            let terms = [
                p.x * p.x,
                p.y * p.y,
                p.z * p.z,
                p.x * p.y,
                p.x * p.z,
                p.y * p.z,
            ];
            (sums.squares.iter_mut().zip(terms)).for_each(|(s, t)| *s += w * t);
        }
        sums
    }

    /// The plane, if there is anything to lay one through.
    pub fn plane(&self) -> Option<Plane> {
        if self.weight <= 0.0 {
            return None;
        }
        let c = self.sum / self.weight;
        let of_mean = [
            c.x * c.x,
            c.y * c.y,
            c.z * c.z,
            c.x * c.y,
            c.x * c.z,
            c.y * c.z,
        ];
        let m = std::array::from_fn(|k| self.squares[k] / self.weight - of_mean[k]);
        let (normal, [_, middle, largest]) = least_axis(m);
        Some(Plane {
            normal: normal.as_vec3(),
            centre: c.as_vec3(),
            along: [middle, largest].map(|v| v as f32),
        })
    }
}

impl Plane {
    pub fn height(&self, place: Vec3) -> f32 {
        self.normal.dot(place - self.centre)
    }

    /// The same plane, where all places are moved.
    pub fn moved(self, by: Vec3) -> Plane {
        Plane {
            centre: self.centre + by,
            ..self
        }
    }

    /// Whether its points are spread in two directions.
    pub fn is_wide(&self) -> bool {
        self.along[0] > LINE * self.along[1]
    }
}

/// What a plane is fitted to: places around a point, which is the origin.
pub(super) struct Around<'a> {
    /// Nearest first.
    pub places: &'a [Vec3],
    /// Where they and the point were seen from: unit vectors, zero where that is unknown; empty if it is of all.
    pub views: &'a [Vec3],
    pub view: Vec3,
    /// No place is farther.
    pub radius: f32,
    pub noise: f32,
}

/// Cosine from which on a view tells the side: normals are off by a degree or two.
pub(super) const PLAIN: f32 = 0.03;

/// Whether a surface with this normal may have been seen from both of two directions: not from its two sides.
pub(super) fn same_side(normal: Vec3, a: Vec3, b: Vec3) -> bool {
    let [a, b] = [a, b].map(|view| normal.dot(view));
    a * b >= 0.0 || a.abs().min(b.abs()) < PLAIN
}

impl Around<'_> {
    /// Whether place k was seen on the same side of a plane as the point.
    pub fn is_seen_with(&self, normal: Vec3, k: usize) -> bool {
        self.views.is_empty() || same_side(normal, self.view, self.views[k])
    }

    /// How far place k is off the surface with this tangent plane, in what is allowed.
    pub fn off(&self, plane: &Plane, k: usize) -> f32 {
        let place = self.places[k];
        match self.is_seen_with(plane.normal, k) {
            true => plane.height(place).abs() / allowed(place, self.radius, self.noise),
            false => f32::INFINITY,
        }
    }

    /// Whether the surface does not bend: places on it are off the plane as the noise is, and no more.
    pub fn is_flat(&self, plane: &Plane) -> bool {
        let on = (0..self.places.len()).filter(|&k| self.off(plane, k) <= 1.0);
        let (square, count) = on.fold((0.0, 0.0), |(square, count), k| {
            (square + plane.height(self.places[k]).powi(2), count + 1.0)
        });
        square <= (BENDING * self.noise).powi(2) * count
    }

    /// How far place k is off this plane, in what noise allows.
    pub fn off_flat(&self, plane: &Plane, k: usize) -> f32 {
        match self.is_seen_with(plane.normal, k) {
            true => plane.height(self.places[k]).abs() / (OFF * self.noise),
            false => f32::INFINITY,
        }
    }

    /// How far places on a flat surface are off it, in deviations of the noise (root mean square).
    pub fn rough(&self, plane: &Plane) -> f32 {
        let offs = (0..self.places.len()).map(|k| self.off_flat(plane, k));
        let on = offs.filter(|off| *off <= 1.0);
        let (squares, count) = on.fold((0.0, 0.0_f32), |(squares, count), off| {
            (squares + off * off, count + 1.0)
        });
        OFF * (squares / count.max(1.0)).sqrt()
    }

    fn weight(&self, plane: &Plane, k: usize) -> f32 {
        bell(OFF * self.off(plane, k)) * self.near(k)
    }

    /// What place k counts for its distance.
    pub fn near(&self, k: usize) -> f32 {
        let part = self.places[k].length_squared() / (self.radius * self.radius);
        (1.0 - part).max(0.05)
    }

    /// The planes through the point that most places agree with, as a tangent plane from which the surface may
    /// bend away and as all of a flat surface; `None` where they lie on none.
    pub fn planes(&self, random: &mut Pcg64Mcg) -> Option<[Plane; 2]> {
        let (places, n) = (self.places, self.places.len());
        if n < 3 {
            return None;
        }
        let step = n.div_ceil(JUDGES);
        let flat = |plane: &Plane, k: usize, wide: f32| bell(OFF * self.off_flat(plane, k) / wide);
        let agreement = |plane: &Plane| {
            let judges = (0..n).step_by(step);
            judges.fold([0.0; 2], |[bent, straight], k| {
                let weight = self.weight(plane, k);
                [bent + weight, straight + flat(plane, k, JUDGED)]
            })
        };
        let through = |normal: Vec3| Plane {
            normal,
            centre: Vec3::ZERO,
            along: [0.0; 2],
        };
        let even = |count: usize| {
            let of = places[..count.min(n)].iter().map(|&p| (p, 1.0));
            Weighted::of(of).plane()
        };
        let first = even(n).or_else(|| even(AT_LEAST))?;
        let (mut best, mut most) = ([first; 2], agreement(&first));
        let consider = |plane: Plane, best: &mut [Plane; 2], most: &mut [f32; 2]| {
            for (which, agree) in agreement(&plane).into_iter().enumerate() {
                if agree > most[which] {
                    (best[which], most[which]) = (plane, agree);
                }
            }
        };
        if let Some(plane) = even(2 * AT_LEAST) {
            consider(plane, &mut best, &mut most);
        }
        let drawn_from = n.min(DRAWN_FROM);
        // In a dense footprint the nearest are too near to tell a direction in the noise.
        let stride = (n / DRAWN_FROM).max(1);
        for _ in 0..TRIALS {
            if most[1] > CLEAR * n.div_ceil(step) as f32 {
                break;
            }
            let [a, b] = [(); 2].map(|()| places[stride * random.random_range(0..drawn_from)]);
            let across = a.cross(b);
            if across.length_squared() > 0.05 * a.length_squared() * b.length_squared() {
                consider(through(across.normalize()), &mut best, &mut most);
            }
        }
        let [mut bent, mut straight] = best;
        for _ in 0..ROUNDS {
            let weighted = (0..n).map(|k| (places[k], self.weight(&bent, k)));
            bent = Weighted::of(weighted).plane()?;
        }
        for wide in WIDE {
            let weighted = (0..n).map(|k| (places[k], flat(&straight, k, wide)));
            straight = Weighted::of(weighted).plane().unwrap_or(bent);
        }
        Some([bent, straight])
    }
}

/// What a place counts that is so many deviations off (Tukey's biweight): nothing from three on.
pub(super) fn bell(off: f32) -> f32 {
    let rest = (1.0 - off * off / 9.0).max(0.0);
    rest * rest
}

/// How far a place may be off a tangent plane, with a footprint of this radius, and still be of the surface.
pub(super) fn allowed(place: Vec3, radius: f32, noise: f32) -> f32 {
    OFF * noise + BENT * place.length_squared() / radius
}

/// Places that a plane is laid through, at least.
pub(super) const AT_LEAST: usize = 6;
