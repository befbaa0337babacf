//! Links: which facet or surfel takes light from which, and how much of it gets through.

mod build;
mod csr;
mod facing;
mod judge;

pub use build::{Accuracy, build};
pub use csr::{Entry, Rows};
pub use facing::Facing;

/// The interaction lists of one operator. Every pair of surfels that see each other is in exactly
/// one of the three, unless its source is dark or what it brings is too little to be seen by samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Links {
    /// Facet from facet by expansion; the weight is the visible part, relative to the expansion.
    pub far: Rows,
    /// How many far links are smooth: none of their segments met anything.
    pub smooth: u64,
    /// Facet from facet where only some pairs face each other: the weight is the mean of the clamped
    /// kernel times visibility, which acts on the source's power.
    pub sampled: Rows,
    /// Surfel from surfel: the weight is the form factor times the visibility.
    pub near: Rows,
}

impl Links {
    /// Numbers of links by kind, as the stats show them.
    pub fn counts(&self) -> [(&'static str, u64); 4] {
        [
            ("smooth", self.smooth),
            ("fractional", self.far.len() as u64 - self.smooth),
            ("sampled", self.sampled.len() as u64),
            ("near", self.near.len() as u64),
        ]
    }
}
