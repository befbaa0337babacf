//! The kernel of diffuse transport and its expansions.
//!
//! Between two surfels the form factor per area is
//! K(x, y) = max(0, n_x · (y-x)) max(0, n_y · (x-y)) / (π |x-y|⁴).
//! Where both face each other it is linear in the **vector charge** q = A B n_y of the source and
//! in n_x: irradiance = n_x · F(x), with the field F(x) = -R (R · q) / (π R⁴), R = x - y. Far from
//! a facet F is expanded in Cartesian tensors about its centre, red, green and blue together.
//!
//! [`hausner`] is the basis of the report that this project began with, as a reference.

mod bound;
mod form_factor;
pub mod hausner;
mod kernel;
mod tensor;

pub use bound::{expected_error, least_order, remainder};
pub use form_factor::polygon_form_factor;
pub use kernel::{NEAR_SPACINGS, Surface, point_kernel};
pub use tensor::{Expansions, Indices, Link, Workspace, coefficients, count, position};
