//! Light on point clouds.

pub mod colour;
pub mod compare;
pub mod error;
pub mod expansion;
pub mod illuminate;
pub mod lights;
pub mod links;
pub mod map;
pub mod math;
pub mod memory;
pub mod octree;
pub mod operator;
pub mod output;
pub mod passes;
pub mod points;
pub mod progress;
pub mod render;
pub mod scan;
pub mod scene;
pub mod solve;
pub mod stats;
pub mod visibility;

pub use error::{Error, Result};
pub use illuminate::{Backend, Illumination, Method, Occlusion, Options, illuminate};
pub use map::IlluminationMap;
pub use points::{PointCloud, Surfels};
pub use progress::Progress;
pub use scene::Scene;
pub use stats::Stats;
