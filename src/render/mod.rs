//! The picture of a lit cloud.

pub mod tone;
