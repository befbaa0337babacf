//! What is to be lit: points, lights, camera; read from a scene file, a scan, or both.

mod cave;
mod doubts;
mod file;
mod load;
mod sample;
mod shapes;
mod surface;
mod values;

use std::ops::Range;
use std::path::PathBuf;

use glam::{DVec3, Vec3};

pub use doubts::Bounds;
pub(crate) use load::DEFAULT_POINTS;
pub use values::{BRIGHTEST, LARGEST, TOLERANCES};

use crate::math::is_grey;
use crate::points::PointCloud;
use crate::scan::ColourSpace;

/// A light of zero size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointLight {
    /// In the scan's unit and coordinates.
    pub position: DVec3,
    /// Radiant intensity (linear RGB): irradiance at distance r on a facing surface is I / r².
    pub intensity: Vec3,
}

/// A pinhole camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Where it stands, in the coordinates of the scan.
    pub position: DVec3,
    /// A place in the middle of the picture.
    pub look_at: DVec3,
    /// A direction that is upwards in the picture, of any length.
    pub up: DVec3,
    /// Vertical field of view in degrees.
    pub fov: f64,
}

/// Everything that a solve needs to know about the world.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// All points, of shapes and of scans.
    pub cloud: PointCloud,
    /// Point lights.
    pub lights: Vec<PointLight>,
    /// Irradiance that an open plane gets from the uniform sky (linear RGB).
    pub sky: Vec3,
    /// Camera of the scene file; without one it is fitted to the cloud.
    pub camera: Option<Camera>,
    /// Tolerance of the scene file.
    pub tolerance: Option<f64>,
    /// The files it was read from.
    pub sources: Vec<Source>,
}

impl Scene {
    /// Whether all light and all surfaces are grey.
    pub fn is_grey(&self) -> bool {
        let cloud = &self.cloud;
        let lights = self.lights.iter().map(|light| light.intensity);
        let colours = cloud.reflectance.iter().chain(&cloud.emission).copied();
        (lights.chain([self.sky]).chain(colours)).all(|colour| is_grey(colour.to_array()))
    }
}

/// A file of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    pub path: PathBuf,
    /// What kind of file it is, see [`Scan`](crate::scan::Scan).
    pub format: String,
    /// What it says of each point, in its own names.
    pub fields: Vec<String>,
    /// What of it was taken for what.
    pub taken: String,
    /// Its points in the cloud of the scene; of a scene file those of its shapes.
    pub points: Range<usize>,
    /// Whether the points were made on its triangles or shapes.
    pub sampled: bool,
    /// Whether a scene file scales, turns or moves its points.
    pub moved: bool,
}

/// What the caller of [`Scene::load`] can set.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SceneOptions {
    /// Points to put on the built-in shapes, and on each mesh whose number the scene file does not
    /// say; `None` takes the scene file's number, or 20000.
    pub points: Option<usize>,
    /// Moves the points of shapes and meshes within their strata; the surfaces stay what they are.
    pub seed: u64,
    /// Samples the faces of PLY files, as [`ReadOptions::faces`](crate::scan::ReadOptions::faces).
    pub mesh: bool,
    /// What the colours of scans are, instead of what their values tell.
    pub colours: Option<ColourSpace>,
    /// Takes files that lie thousands of their sizes apart.
    pub far_apart: bool,
    /// Takes points that files flag as withheld or noise.
    pub keep_flagged: bool,
    /// What the columns of texts are, instead of what they tell; empty if nothing is said.
    pub columns: Vec<String>,
}
