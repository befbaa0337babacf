//! WGSL stages on a device and queue that the caller hands over.

pub mod adapter;
mod answers;
mod batch;
mod context;
mod form_factor;
mod lists;
mod mixed;
mod p2p;
mod pace;
mod point_visible;
mod shader;
mod stages;
mod table;
mod turns;
mod unroll;
mod visibility;
pub mod wgsl;

pub use batch::{Batch, Batches, Pieces};
pub use context::Gpu;
pub use form_factor::{Cell, GpuFormFactors};
pub use lists::Link;
pub use mixed::{Mixed, MixedItem, MixedPart};
pub use p2p::{P2p, PointItem, PointSpan};
pub use pace::Pace;
pub use point_visible::{GpuPointVisibility, PointTestUniform};
pub use shader::{MAX_ORDER, Pipeline, Shader, WORKGROUP};
pub use stages::{Facet, Stages, Surfel};
pub use table::{TABLE_WIDTH, Table};
pub use visibility::GpuVisibility;
pub use wgsl::SHADERS;
