//! Points and what they stand for: surfels with their cells.

mod cells;
mod cloud;
mod neighbours;
mod normals;
mod orient;
mod plane;
mod rule;
mod select;
mod sides;
mod smooth;
mod surfels;
mod thin;

pub use cells::{Cells, MAX_EDGES};
pub use cloud::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud};
pub use orient::Facing;
pub use surfels::{Prepared, Surfels};
