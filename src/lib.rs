//! Light on point clouds.

pub mod error;
pub mod illuminate;
pub mod map;
pub mod math;
pub mod passes;
pub mod points;
pub mod progress;
pub mod scene;
pub mod visibility;

pub use error::{Error, Result};
pub use illuminate::{Backend, Illumination, Method, Occlusion, Options, Stats, illuminate};
pub use map::IlluminationMap;
pub use points::{PointCloud, Surfels};
pub use progress::Progress;
pub use scene::Scene;
