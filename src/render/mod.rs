//! The picture of a lit cloud: a camera that fits it, surfels as discs with depth, PNG bytes.

pub mod camera;
mod false_colour;
mod image;
mod splat;
pub mod tone;
mod view;

pub use self::image::{Image, encode_png};
pub use camera::fit;
pub use false_colour::{as_radiosity, encode_false_colour, false_colour};
pub use splat::picture;
