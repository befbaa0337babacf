//! The surface at a point of something long and round: a pipe, a post, a rail.

use glam::{DVec3, Vec3};

use super::curved::{Curved, solve};
use super::plane::{Around, OFF, Plane, bell};

/// A cylinder.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    /// A place on its axis, next to the origin.
    centre: DVec3,
    axis: DVec3,
    radius: f64,
    /// Whether the point's normal is taken to point away from the axis.
    outward: bool,
}

/// Unknowns: the axis moves and turns in two directions each.
const UNKNOWN: usize = 5;
/// Rounds of fitting, and what noise is taken for in each, in deviations.
const WIDE: [f64; 8] = [16.0, 8.0, 4.0, 3.0, 2.0, 1.5, 1.0, 1.0];
/// Points that a cylinder is laid through, at least.
const AT_LEAST: usize = 12;
/// Radii, in radii of the footprint: of a larger one a paraboloid tells as much.
const RADII: std::ops::Range<f64> = 0.15..4.0;
/// Along its axis a cylinder bends by no more than this part of what it does around.
const STRAIGHT: f64 = 0.4;

impl Round {
    /// The cylinder near a paraboloid that most places agree with; `None` where they lie on none.
    pub fn fit(around: &Around, start: &Curved) -> Option<Round> {
        let [(bend, _), (other, axis)] = start.principal();
        let scale = f64::from(around.radius);
        if !RADII.contains(&(1.0 / (bend * scale).abs())) || other.abs() > STRAIGHT * bend.abs() {
            return None;
        }
        let tangent = start.tangent();
        let mut round = Round {
            centre: tangent.centre.as_dvec3() + tangent.normal.as_dvec3() / bend,
            axis: axis.normalize(),
            radius: 1.0 / bend.abs(),
            outward: bend < 0.0,
        };
        let normal = tangent.normal;
        for wide in WIDE {
            let deviation = wide * f64::from(around.noise);
            round = round.nearer(around, normal, deviation, scale)?;
        }
        let on = (0..around.places.len()).filter(|&k| round.off(around, k) <= 1.0);
        let in_range = RADII.contains(&(round.radius / scale));
        (in_range && on.count() >= AT_LEAST).then_some(round)
    }

    /// One step of Gauss and Newton, with places weighed by how far they are off.
    fn nearer(self, around: &Around, normal: Vec3, deviation: f64, scale: f64) -> Option<Round> {
        let (b, c) = self.axis.any_orthonormal_pair();
        let (mut matrix, mut right) = ([[0.0; UNKNOWN]; UNKNOWN], [0.0; UNKNOWN]);
        for (k, &place) in around.places.iter().enumerate() {
            if !around.is_seen_with(normal, k) {
                continue;
            }
            let (away, along, far) = self.away(place);
            let miss = far - self.radius;
            let weight = f64::from(bell((miss / deviation) as f32) * around.near(k));
            let way = away / far.max(f64::MIN_POSITIVE);
            let [y, z] = [b, c].map(|axis| axis.dot(way));
            let part = along / scale;
            let terms = [y, z, part * y, part * z, 1.0];
            for (j, term) in terms.iter().enumerate() {
                right[j] += weight * term * miss;
                (matrix[j].iter_mut().zip(terms)).for_each(|(m, t)| *m += weight * term * t);
            }
        }
        // What few places say nothing of stays.
        (0..UNKNOWN).for_each(|j| matrix[j][j] += 1e-3);
        let [y, z, turn_y, turn_z, wider] = solve(matrix, right)?;
        let round = Round {
            centre: self.centre + y * b + z * c,
            axis: (self.axis + (turn_y * b + turn_z * c) / scale).normalize(),
            radius: self.radius + wider,
            ..self
        };
        // The place on the axis next to the origin.
        let along = round.centre.dot(round.axis);
        let centre = round.centre - along * round.axis;
        (centre.is_finite() && round.radius > 0.0).then_some(Round { centre, ..round })
    }

    /// The same cylinder, where all places are moved.
    pub fn moved(self, by: Vec3) -> Round {
        Round {
            centre: self.centre + by.as_dvec3(),
            ..self
        }
    }

    /// How far a place is outside of it.
    pub fn height(&self, place: Vec3) -> f32 {
        (self.away(place).2 - self.radius) as f32
    }

    /// The tangent plane at the place next to another one.
    pub fn tangent_at(&self, place: Vec3) -> Plane {
        let away = self
            .away(place)
            .0
            .normalize_or(self.axis.any_orthonormal_vector());
        let height = f64::from(self.height(place));
        let normal = if self.outward { away } else { -away };
        Plane {
            normal: normal.as_vec3(),
            centre: (place.as_dvec3() - height * away).as_vec3(),
            along: [0.0; 2],
        }
    }

    /// From the axis to a place, how far along the axis that is, and how far away.
    fn away(&self, place: Vec3) -> (DVec3, f64, f64) {
        let way = place.as_dvec3() - self.centre;
        let along = way.dot(self.axis);
        let away = way - along * self.axis;
        (away, along, away.length())
    }

    /// How far place k is off it, in what noise allows.
    pub fn off(&self, around: &Around, k: usize) -> f32 {
        match around.is_seen_with(self.tangent().normal, k) {
            true => self.height(around.places[k]).abs() / (OFF * around.noise),
            false => f32::INFINITY,
        }
    }

    /// The tangent plane at the place next to the origin.
    pub fn tangent(&self) -> Plane {
        self.tangent_at(Vec3::ZERO)
    }

    /// Curvature, positive where it bends toward its normal.
    pub fn bend(&self) -> f32 {
        let bend = 1.0 / self.radius as f32;
        if self.outward { -bend } else { bend }
    }
}
