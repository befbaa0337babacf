//! Light straight from its sources, computed per surfel with tested visibility and outside the
//! links: shadows are as sharp as the points can show them.

mod emitters;
mod points;
mod sky;

pub use emitters::{EXPANSIONS, Emitted, emitted, emitters};
pub use points::{Illuminated, point_lights};
pub use sky::sky;
pub(crate) use sky::visible_sky;

/// Surfels whose segments are tested in one batch.
const BATCH: usize = 1 << 14;
