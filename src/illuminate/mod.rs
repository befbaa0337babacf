//! The main job: scene in, illumination map and what it took out.

mod amplified;
mod bright;
mod checkpoint;
pub mod checks;
mod even;
mod file;
mod fmm;
mod geometry;
mod holes;
mod linked;
mod measured;
mod model;
mod options;
mod quantiles;
mod rays;
mod receivers;
pub mod stats;
mod surface;
mod task;
mod transport;
mod verified;
pub mod verify;
mod work;

use std::sync::Arc;

use glam::DVec3;

pub(crate) use self::bright::Spots;
pub use self::checkpoint::Checkpoint;
use self::geometry::Geometry;
pub use self::holes::HoleShares;
pub use self::options::{Backend, DEFAULT_TOLERANCE, Method, Occlusion, Options};
pub(crate) use self::options::{check, tolerance};
pub use self::quantiles::Interval;
pub use self::rays::RAYS;
pub(crate) use self::rays::SPARED;
use self::stats::Stats;
pub use self::surface::{SurfaceError, surface_error};
pub use self::transport::Transport;
use crate::error::Result;
use crate::map::IlluminationMap;
use crate::octree::LEAF_SIZE;
use crate::plan::Plan;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::Occluders;

/// The map and what it took.
#[derive(Clone, Debug, Default)]
pub struct Illumination {
    /// Light at every point.
    pub map: IlluminationMap,
    /// The surfels that the points stood for, in the order of the octree. Of a fitted surface the reflectance
    /// includes what directions through holes are taken to bring.
    pub surfels: Arc<Surfels>,
    /// Irradiance of the surfels straight from lights, by the methods fmm and gather, which find it
    /// apart; otherwise empty.
    pub direct: Vec<DVec3>,
    /// What it took and how well it went.
    pub stats: Stats,
}

/// Computes the illumination map of a scene, as a [`Plan`] of it says.
///
/// # Errors
/// [`Error::TooLarge`](crate::Error::TooLarge) before the work starts where it would not fit into memory;
/// [`Error::Usage`](crate::Error::Usage) for options that do not fit together;
/// [`Error::Invalid`](crate::Error::Invalid) for a scene that cannot be lit.
pub fn illuminate(
    scene: &Scene,
    options: &Options,
    backend: Backend,
    progress: &dyn Progress,
) -> Result<Illumination> {
    Transport::new(scene, options, backend, progress)?.illuminate(scene, progress)
}

/// The surfels that solves with occlusion make of a cloud, and what stands in the way.
pub(crate) fn prepared(
    scene: &Scene,
    progress: &dyn Progress,
) -> Result<(Arc<Surfels>, Arc<Occluders>)> {
    let plan = Plan {
        tolerance: DEFAULT_TOLERANCE,
        leaf_size: LEAF_SIZE,
        ..Plan::default()
    };
    let (geometry, _) = Geometry::prepare(scene, &Options::default(), &plan, progress)?;
    let occluders = geometry.occluders.expect("occlusion is the default");
    Ok((geometry.surfels, occluders))
}
