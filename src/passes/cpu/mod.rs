//! The stages on the CPU, generic: f64 is the reference, f32 the product and the twin of WGSL.

mod l2l;
mod l2p;
mod m2l;
mod m2m;
mod near_field;
mod p2m;
mod p2p;

pub use l2l::l2l;
pub use l2p::l2p;
pub use m2l::m2l;
pub use m2m::m2m;
pub use near_field::near_field;
pub use p2m::p2m;
pub use p2p::{all_pairs, p2p};
