//! What a scene file says: its tables, checked while they are read.

use std::path::PathBuf;

use serde::Deserialize;

use super::cave::Cave;
use super::shapes::{Block, Quad, Sphere};
use super::surface::{Material, Model};
use super::values::{Count, Length, Light, Reflectance, Rotation, Tolerance, Vector};
use super::{Camera, PointLight};
use crate::points::DEFAULT_REFLECTANCE;

/// A scene file. `scenes/cornell.toml` explains the keys.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a scene")]
pub(super) struct SceneFile {
    pub points: Option<Count>,
    pub tolerance: Option<Tolerance>,
    #[serde(default)]
    pub sky: Light,
    pub camera: Option<CameraTable>,
    #[serde(default)]
    pub light: Vec<LightTable>,
    #[serde(default)]
    pub shape: Vec<Shape>,
    #[serde(default)]
    pub cloud: Vec<CloudTable>,
}

/// `[[cloud]]`: points of a scan, scaled, then turned, then moved.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table with the key file")]
pub(super) struct CloudTable {
    /// Relative to the folder of the scene file.
    pub file: PathBuf,
    pub scale: Option<Length>,
    #[serde(default)]
    pub rotate: Rotation,
    #[serde(default)]
    pub translate: Vector,
    /// Instead of the colours of the scan.
    pub reflectance: Option<Reflectance>,
    /// Instead of the emission of the scan.
    pub emission: Option<Light>,
    /// Sample the faces of a PLY file.
    #[serde(default)]
    pub mesh: bool,
    /// Number of points on a mesh.
    pub points: Option<Count>,
    /// Mean distance of points on a mesh, in the unit of the scene.
    pub spacing: Option<Length>,
}

/// `[[light]]`
#[derive(Debug, Deserialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table with the keys position, intensity"
)]
pub(super) struct LightTable {
    position: Vector,
    intensity: Light,
}

impl From<&LightTable> for PointLight {
    fn from(table: &LightTable) -> Self {
        PointLight {
            position: table.position.0,
            intensity: table.intensity.0,
        }
    }
}

/// `[camera]`
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "RawCamera")]
pub(super) struct CameraTable(pub Camera);

#[derive(Deserialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table with the keys position, look_at"
)]
struct RawCamera {
    position: Vector,
    look_at: Vector,
    up: Option<Vector>,
    fov: Option<f64>,
}

impl TryFrom<RawCamera> for CameraTable {
    type Error = String;

    fn try_from(raw: RawCamera) -> Result<Self, String> {
        let camera = Camera {
            position: raw.position.0,
            look_at: raw.look_at.0,
            up: raw.up.map_or(glam::DVec3::Y, |up| up.0),
            fov: raw.fov.unwrap_or(45.0),
        };
        if !(1.0..=179.0).contains(&camera.fov) {
            return Err(format!(
                "fov {}: must be between 1 and 179 degrees",
                camera.fov
            ));
        }
        let view = (camera.look_at - camera.position).try_normalize();
        let Some(view) = view else {
            return Err("position and look_at are the same place".into());
        };
        match camera.up.try_normalize() {
            None => Err("up must not be zero".into()),
            Some(up) if view.cross(up).length() < 1e-6 => {
                Err("up must not point along the view, from position to look_at".into())
            }
            Some(_) => Ok(Self(camera)),
        }
    }
}

/// `[[shape]]`
#[derive(Debug, Deserialize)]
#[serde(try_from = "RawShape")]
pub(super) struct Shape {
    geometry: Geometry,
    material: Material,
}

#[derive(Debug)]
enum Geometry {
    Quad(Quad),
    Box(Block),
    Sphere(Sphere),
    Cave(Cave),
}

#[derive(Deserialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table with one of the keys quad, box, sphere, cave"
)]
struct RawShape {
    quad: Option<Quad>,
    r#box: Option<Block>,
    sphere: Option<Sphere>,
    cave: Option<Cave>,
    reflectance: Option<Reflectance>,
    #[serde(default)]
    emission: Light,
}

impl TryFrom<RawShape> for Shape {
    type Error = String;

    fn try_from(raw: RawShape) -> Result<Self, String> {
        let given = [
            raw.quad.map(Geometry::Quad),
            raw.r#box.map(Geometry::Box),
            raw.sphere.map(Geometry::Sphere),
            raw.cave.map(Geometry::Cave),
        ];
        let mut given = given.into_iter().flatten();
        let (Some(geometry), None) = (given.next(), given.next()) else {
            return Err("a shape has exactly one of quad, box, sphere, cave".into());
        };
        Ok(Self {
            geometry,
            material: Material {
                reflectance: raw
                    .reflectance
                    .map_or(glam::Vec3::splat(DEFAULT_REFLECTANCE), |r| r.0),
                emission: raw.emission.0,
            },
        })
    }
}

impl Shape {
    /// Adds the shape's surfaces and what is solid behind them.
    pub fn build(&self, model: &mut Model) {
        match &self.geometry {
            Geometry::Quad(quad) => quad.build(self.material, model),
            Geometry::Box(block) => block.build(self.material, model),
            Geometry::Sphere(sphere) => sphere.build(self.material, model),
            Geometry::Cave(cave) => cave.build(self.material, model),
        }
    }
}
