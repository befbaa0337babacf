//! Points and what they stand for: surfels with their cells.

mod buried;
mod cells;
mod cloud;
mod facing;
mod fingerprint;
mod fit;
mod fitted;
mod neighbours;
mod plane;
mod prepare;
mod quality;
mod rule;
mod select;
mod smooth;
mod strays;
mod surfels;
mod survey;
mod thin;

pub use buried::buried;
pub use cells::{Cells, MAX_EDGES};
pub use cloud::{DEFAULT_REFLECTANCE, Grid, MAX_COLOUR_REFLECTANCE, PointCloud, Scanner};
pub use facing::Facing;
pub use fit::{Evidence, Half};
pub(crate) use neighbours::{Last, Neighbours, runs};
pub(crate) use prepare::check;
pub use prepare::{Prepared, Thinning};
pub use quality::{Openness, Quality};
pub use surfels::Surfels;
pub use survey::Survey;
