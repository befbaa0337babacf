//! WGSL stages on a device and queue that the caller hands over.

pub mod adapter;
mod context;
mod pace;
mod shader;
mod visibility;

pub use context::{Gpu, TABLE_WIDTH, Table};
pub use pace::Pace;
pub use shader::{Pipeline, SHADERS, Shader, WORKGROUP};
pub use visibility::GpuVisibility;
