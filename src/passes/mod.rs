//! The stages of a solve on a device. (The CPU's stand with their subjects: `visibility` and so on.)

pub mod gpu;
