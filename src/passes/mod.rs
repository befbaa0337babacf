//! The stages of one application of the operator: one name in Rust and in WGSL.

pub mod cpu;
pub mod gpu;
