//! The simple shapes: quad, box, sphere.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use glam::{DQuat, DVec3};
use serde::Deserialize;

use super::surface::{Material, Model, Part, Solid, Surface};
use super::values::{Interval, Length, Reflectance, Rotation, SMALLEST, Size, Vector};

/// A parallelogram, seen from the side that u × v points to.
#[derive(Debug, Deserialize)]
#[serde(try_from = "RawQuad")]
pub(super) struct Quad {
    /// The quad, or what is left of it around a hole.
    pieces: Vec<Plane>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table with the keys corner, u, v")]
struct RawQuad {
    corner: Vector,
    u: Vector,
    v: Vector,
    hole: Option<Hole>,
}

/// A parallelogram to leave out, by the distances along the two edges.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table with the keys u, v")]
struct Hole {
    u: Interval,
    v: Interval,
}

impl TryFrom<RawQuad> for Quad {
    type Error = String;

    fn try_from(raw: RawQuad) -> Result<Self, String> {
        let whole = Plane {
            corner: raw.corner.0,
            u: raw.u.0,
            v: raw.v.0,
        };
        let lengths = [whole.u.length(), whole.v.length()];
        let area = whole.u.cross(whole.v).length();
        if lengths.iter().any(|&l| l < SMALLEST) || area <= 1e-9 * lengths[0] * lengths[1] {
            return Err("the edges u and v of a quad must span an area".into());
        }
        let Some(hole) = raw.hole else {
            return Ok(Self {
                pieces: vec![whole],
            });
        };
        // In fractions of the edges; a hole may reach the edge of the quad, but not beyond it.
        let [u, v] = [
            hole.u.0.map(|x| x / lengths[0]),
            hole.v.0.map(|x| x / lengths[1]),
        ];
        if u[1] > 1.0 + 1e-9 || v[1] > 1.0 + 1e-9 {
            return Err(format!(
                "the hole must lie within the edges, which are {} and {} long",
                lengths[0], lengths[1]
            ));
        }
        let around = [
            ([0.0, 1.0], [0.0, v[0]]),
            ([0.0, 1.0], [v[1], 1.0]),
            ([0.0, u[0]], v),
            ([u[1], 1.0], v),
        ];
        let pieces: Vec<_> = around
            .into_iter()
            .filter(|(u, v)| u[1] - u[0] > 1e-9 && v[1] - v[0] > 1e-9)
            .map(|(u, v)| whole.piece(u, v))
            .collect();
        if pieces.is_empty() {
            return Err("the hole leaves nothing of the quad".into());
        }
        Ok(Self { pieces })
    }
}

impl Quad {
    pub fn build(&self, material: Material, model: &mut Model) {
        model.parts.extend(self.pieces.iter().map(|&plane| Part {
            surface: Box::new(plane),
            flipped: false,
            material,
            solid: None,
        }));
    }
}

#[derive(Clone, Copy, Debug)]
struct Plane {
    corner: DVec3,
    u: DVec3,
    v: DVec3,
}

impl Plane {
    fn piece(&self, u: [f64; 2], v: [f64; 2]) -> Self {
        Self {
            corner: self.at(u[0], v[0]),
            u: self.u * (u[1] - u[0]),
            v: self.v * (v[1] - v[0]),
        }
    }
}

impl Surface for Plane {
    fn at(&self, u: f64, v: f64) -> DVec3 {
        self.corner + self.u * u + self.v * v
    }

    fn tangents(&self, _: f64, _: f64) -> [DVec3; 2] {
        [self.u, self.v]
    }

    fn cells(&self) -> [usize; 2] {
        [1, 1]
    }
}

/// A face of a box before it is rotated: x to the right, y up, z towards the viewer.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, PartialOrd, Ord)]
#[serde(rename_all = "lowercase")]
enum Face {
    Left,
    Right,
    Bottom,
    Top,
    Back,
    Front,
}

impl Face {
    const ALL: [Face; 6] = [
        Face::Left,
        Face::Right,
        Face::Bottom,
        Face::Top,
        Face::Back,
        Face::Front,
    ];

    /// Outward normal and two edge directions with u × v along it.
    fn axes(self) -> [DVec3; 3] {
        let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
        match self {
            Face::Left => [-x, z, y],
            Face::Right => [x, y, z],
            Face::Bottom => [-y, x, z],
            Face::Top => [y, z, x],
            Face::Back => [-z, y, x],
            Face::Front => [z, x, y],
        }
    }
}

/// A box: a block seen from outside, which is solid, or a room seen from inside.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table with the keys centre, size")]
pub(super) struct Block {
    centre: Vector,
    size: Size,
    /// About the centre.
    #[serde(default)]
    rotate: Rotation,
    #[serde(default)]
    inward: bool,
    /// Faces to leave out.
    #[serde(default)]
    open: Vec<Face>,
    /// Instead of the shape's reflectance.
    #[serde(default)]
    faces: BTreeMap<Face, Reflectance>,
}

impl Block {
    pub fn build(&self, material: Material, model: &mut Model) {
        let half = self.size.0 / 2.0;
        let turn = self.rotate.0;
        let solid = (!self.inward).then(|| {
            model.add_solid(SolidBox {
                centre: self.centre.0,
                half,
                turn: turn.inverse(),
            })
        });
        for face in Face::ALL.into_iter().filter(|f| !self.open.contains(f)) {
            let [normal, u, v] = face.axes().map(|axis| axis * half);
            let plane = Plane {
                corner: self.centre.0 + turn * (normal - u - v),
                u: turn * u * 2.0,
                v: turn * v * 2.0,
            };
            let reflectance = self.faces.get(&face).map(|r| r.0);
            model.parts.push(Part {
                surface: Box::new(plane),
                flipped: self.inward,
                material: Material {
                    reflectance: reflectance.unwrap_or(material.reflectance),
                    ..material
                },
                solid,
            });
        }
    }
}

#[derive(Debug)]
struct SolidBox {
    centre: DVec3,
    half: DVec3,
    /// From the world's axes to the box's.
    turn: DQuat,
}

impl Solid for SolidBox {
    fn contains(&self, p: DVec3) -> bool {
        (self.turn * (p - self.centre)).abs().cmplt(self.half).all()
    }

    fn size(&self) -> f64 {
        self.half.min_element()
    }
}

/// A sphere, smooth or with bumps; seen from outside it is solid.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "RawSphere")]
pub(super) struct Sphere {
    centre: DVec3,
    radius: f64,
    /// Largest displacement as a fraction of the radius.
    bumps: f64,
    inward: bool,
}

#[derive(Deserialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table with the keys centre, radius"
)]
struct RawSphere {
    centre: Vector,
    radius: Length,
    #[serde(default)]
    bumps: f64,
    #[serde(default)]
    inward: bool,
}

impl TryFrom<RawSphere> for Sphere {
    type Error = String;

    fn try_from(raw: RawSphere) -> Result<Self, String> {
        if !(0.0..=0.8).contains(&raw.bumps) {
            return Err(format!("bumps {}: must be between 0 and 0.8", raw.bumps));
        }
        Ok(Self {
            centre: raw.centre.0,
            radius: raw.radius.0,
            bumps: raw.bumps,
            inward: raw.inward,
        })
    }
}

impl Sphere {
    pub fn build(&self, material: Material, model: &mut Model) {
        let solid = (!self.inward).then(|| model.add_solid(*self));
        model.parts.push(Part {
            surface: Box::new(*self),
            flipped: self.inward,
            material,
            solid,
        });
    }

    /// Distance of the surface from the centre in a direction of unit length.
    fn reach(&self, w: DVec3) -> f64 {
        if self.bumps == 0.0 {
            self.radius
        } else {
            self.radius * (1.0 + self.bumps * bumps(w))
        }
    }
}

/// Smooth noise on the unit sphere, in [-1, 1].
fn bumps(w: DVec3) -> f64 {
    let DVec3 { x, y, z } = w;
    let coarse = 0.18 * (4.0 * x + 1.0).sin() * (5.0 * y).sin();
    let medium = 0.12 * (7.0 * z + 2.0 * x).sin() * (6.0 * y - 1.0).cos();
    let fine = 0.05 * (15.0 * x).sin() * (13.0 * z).sin() * (14.0 * y + 0.5).sin();
    (coarse + medium + fine) / 0.35
}

impl Surface for Sphere {
    /// u goes round the y axis, v from the lower pole to the upper one.
    fn at(&self, u: f64, v: f64) -> DVec3 {
        let (sin_u, cos_u) = (2.0 * PI * u).sin_cos();
        let (sin_v, cos_v) = (PI * v).sin_cos();
        let w = DVec3::new(sin_v * sin_u, -cos_v, sin_v * cos_u);
        self.centre + w * self.reach(w)
    }

    fn cells(&self) -> [usize; 2] {
        if self.bumps == 0.0 {
            [1, 1024]
        } else {
            [256, 256]
        }
    }
}

impl Solid for Sphere {
    fn contains(&self, p: DVec3) -> bool {
        let d = p - self.centre;
        let distance = d.length();
        // Most points are farther away than any bump, which saves the noise.
        distance < self.radius * (1.0 + self.bumps)
            && distance < self.reach(d.normalize_or(DVec3::Y))
    }

    fn size(&self) -> f64 {
        self.radius
    }
}
