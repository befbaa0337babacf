//! The main job: scene in, illumination map and what it took out.

pub mod checks;
mod file;
mod geometry;
mod linked;
mod options;
mod rays;
pub mod stats;
mod task;
mod transport;
mod work;

use std::sync::Arc;

pub use self::options::{Backend, DEFAULT_TOLERANCE, Method, Occlusion, Options};
pub use self::rays::RAYS;
use self::stats::Stats;
pub use self::transport::Transport;
use crate::error::Result;
use crate::map::IlluminationMap;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::scene::Scene;

/// The map and what it took.
#[derive(Clone, Debug, Default)]
pub struct Illumination {
    /// Light at every point.
    pub map: IlluminationMap,
    /// The surfels that the points stood for, in the order of the octree.
    pub surfels: Arc<Surfels>,
    /// What it took and how well it went.
    pub stats: Stats,
}

/// Computes the illumination map of a scene.
pub fn illuminate(
    scene: &Scene,
    options: &Options,
    backend: Backend,
    progress: &dyn Progress,
) -> Result<Illumination> {
    Transport::new(scene, options, backend, progress)?.illuminate(scene, progress)
}
