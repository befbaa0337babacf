//! Points and what they stand for: surfels with their cells.

mod cells;
mod cloud;
mod fingerprint;
mod neighbours;
mod rule;
mod select;
mod smooth;
mod surfels;

pub use cells::{Cells, MAX_EDGES};
pub use cloud::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud, Scanner};
pub(crate) use surfels::check;
pub use surfels::{Prepared, Surfels};
