//! A cave: a winding tunnel with rough walls, closed at both ends, and columns from its floor to
//! its ceiling.
//!
//! Everything here is in units of the tunnel's radius, from the start of its axis: x to the side,
//! y up, z along the tunnel.

use std::f64::consts::TAU;

use glam::DVec3;
use serde::Deserialize;

use super::surface::{Material, Model, Part, Solid, Surface};
use super::values::{Length, Vector};

/// Height of the tunnel over its width.
const FLATTENING: f64 = 0.8;
/// Depth to which the rock counts as solid; a column's ends lie in it everywhere.
const ROCK: f64 = 1.0;
/// Half height of a column: beyond the highest ceiling.
const COLUMN: f64 = 1.2;

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "RawCave")]
pub(super) struct Cave {
    place: Place,
    columns: u32,
}

#[derive(Deserialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table with the keys start, radius, length, columns"
)]
struct RawCave {
    start: Vector,
    radius: Length,
    length: Length,
    columns: i64,
}

impl TryFrom<RawCave> for Cave {
    type Error = String;

    fn try_from(raw: RawCave) -> Result<Self, String> {
        let length = raw.length.0 / raw.radius.0;
        if !(1.0..=100.0).contains(&length) {
            return Err("the length of a cave must be 1 to 100 times its radius".into());
        }
        match u32::try_from(raw.columns) {
            Ok(columns @ 0..=100) => Ok(Self {
                place: Place {
                    start: raw.start.0,
                    radius: raw.radius.0,
                    length,
                },
                columns,
            }),
            _ => Err(format!("columns {}: must be 0 to 100", raw.columns)),
        }
    }
}

impl Cave {
    pub fn build(&self, material: Material, model: &mut Model) {
        let place = self.place;
        let rock = model.add_solid(Rock(place));
        let mut add = |surface: Box<dyn Surface>, flipped, solid| {
            model.parts.push(Part {
                surface,
                flipped,
                material,
                solid: Some(solid),
            });
        };
        add(Box::new(Wall(place)), true, rock);
        add(Box::new(End { place, z: 0.0 }), true, rock);
        let z = place.length;
        add(Box::new(End { place, z }), false, rock);
        for k in 0..self.columns {
            let column = Column::new(place, k, self.columns);
            let solid = model.add_solid(column);
            model.parts.push(Part {
                surface: Box::new(column),
                flipped: false,
                material,
                solid: Some(solid),
            });
        }
    }
}

/// Where the cave is, and how long in radii.
#[derive(Clone, Copy, Debug)]
struct Place {
    start: DVec3,
    radius: f64,
    length: f64,
}

impl Place {
    fn to_world(self, q: DVec3) -> DVec3 {
        self.start + q * self.radius
    }

    fn to_cave(self, p: DVec3) -> DVec3 {
        (p - self.start) / self.radius
    }
}

/// Side step of the tunnel's axis at z.
fn axis(z: f64) -> f64 {
    0.35 * (0.9 * z).sin()
}

/// Distance of the wall from the axis, before flattening; between 0.57 and 1.43.
fn wall(angle: f64, z: f64) -> f64 {
    1.0 + 0.16 * (3.0 * angle + 1.3 * z).sin()
        + 0.12 * (5.0 * angle - 2.1 * z + 1.0).sin()
        + 0.10 * (2.7 * z + 0.5).sin()
        + 0.05 * (11.0 * angle + 6.0 * z).sin() * (9.0 * z).cos()
}

/// A place at `fraction` of the way from the axis to the wall.
fn cross_section(angle: f64, z: f64, fraction: f64) -> DVec3 {
    let r = wall(angle, z) * fraction;
    DVec3::new(axis(z) + r * angle.cos(), FLATTENING * r * angle.sin(), z)
}

/// u goes round the axis, v along it; u × v points into the rock.
#[derive(Debug)]
struct Wall(Place);

impl Surface for Wall {
    fn at(&self, u: f64, v: f64) -> DVec3 {
        self.0
            .to_world(cross_section(TAU * u, self.0.length * v, 1.0))
    }

    fn cells(&self) -> [usize; 2] {
        [256, (64.0 * self.0.length) as usize]
    }
}

/// The flat end of the tunnel at z: u goes round, v from the axis to the wall; u × v points
/// towards -z.
#[derive(Debug)]
struct End {
    place: Place,
    z: f64,
}

impl Surface for End {
    fn at(&self, u: f64, v: f64) -> DVec3 {
        self.place.to_world(cross_section(TAU * u, self.z, v))
    }

    fn cells(&self) -> [usize; 2] {
        [256, 256]
    }
}

/// The rock around the tunnel.
#[derive(Debug)]
struct Rock(Place);

impl Solid for Rock {
    fn contains(&self, p: DVec3) -> bool {
        let q = self.0.to_cave(p);
        let (x, y) = (q.x - axis(q.z), q.y / FLATTENING);
        let depth = x.hypot(y) - wall(y.atan2(x), q.z);
        // How far beyond the nearer end.
        let beyond = (-q.z).max(q.z - self.0.length);
        (depth > 0.0 || beyond > 0.0) && depth < ROCK && beyond < ROCK
    }

    fn size(&self) -> f64 {
        self.0.radius
    }
}

/// An upright column: u goes round, v upwards; u × v points outwards.
#[derive(Clone, Copy, Debug)]
struct Column {
    place: Place,
    x: f64,
    z: f64,
    radius: f64,
    phase: f64,
}

impl Column {
    /// Column `k` of `count`, spread along the tunnel.
    fn new(place: Place, k: u32, count: u32) -> Self {
        let z = place.length * (f64::from(k) + 0.7) / (f64::from(count) + 0.4);
        let k = f64::from(k);
        Self {
            place,
            x: axis(z) + 0.45 * (2.3 * k * k).sin(),
            z,
            radius: 0.13 + 0.04 * (1.7 * k).cos(),
            phase: k,
        }
    }

    fn radius_at(&self, angle: f64, y: f64) -> f64 {
        let waves = 0.25 * (3.0 * angle + 4.0 * y + self.phase).sin();
        self.radius * (1.0 + waves + 0.5 * y * y)
    }
}

impl Surface for Column {
    fn at(&self, u: f64, v: f64) -> DVec3 {
        let y = COLUMN * (2.0 * v - 1.0);
        let r = self.radius_at(TAU * u, y);
        let (sin, cos) = (TAU * u).sin_cos();
        let q = DVec3::new(self.x + r * sin, y, self.z + r * cos);
        self.place.to_world(q)
    }

    fn cells(&self) -> [usize; 2] {
        [64, 128]
    }
}

impl Solid for Column {
    fn contains(&self, p: DVec3) -> bool {
        let q = self.place.to_cave(p);
        let (x, z) = (q.x - self.x, q.z - self.z);
        q.y.abs() < COLUMN && x.hypot(z) < self.radius_at(x.atan2(z), q.y)
    }

    fn size(&self) -> f64 {
        self.radius * self.place.radius
    }
}
