//! Links: which facet or surfel takes light from which, and how much of it gets through.

mod accuracy;
mod adaptive;
mod build;
mod classic;
mod close;
mod csr;
mod dual;
mod facing;
mod gather;
mod judge;
mod kept;
mod near;
pub mod open;
mod spans;
mod walk;

pub use accuracy::Accuracy;
pub(crate) use accuracy::LOCAL_TOLERANCE;
pub use adaptive::adaptive;
pub use build::build;
pub use classic::{CLASSIC_LEAF_SIZE, State, States, Tally, Thresholds, classic, classic_order};
pub use close::Close;
pub use csr::{Entry, Rows};
pub use dual::{Mac, THETA, Verdict, dual};
pub use facing::{CLAMPED, Cosines, Facing};
pub use gather::{gather, mean};
pub use kept::{Kept, SLACK};
pub use open::build_open;
pub use spans::Span;
pub use walk::Interaction;

use serde::{Deserialize, Serialize};

use crate::octree::Facet;

/// Largest order of mixed links: what they get wrong at the horizon, more terms do not mend.
pub const MIXED_ORDER: usize = 2;

/// The interaction lists of one operator. Every pair of surfels that see each other is in exactly
/// one of them, unless its source is dark or what it brings is too little to be seen by samples.
///
/// The weight of an entry is the part of the light that gets through, where nothing else is said.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Links {
    /// Facet from facet, moments into local expansion (M2L): `m2l[p]` are those of order p. The
    /// weight is the visible part, relative to the expansion.
    pub m2l: Vec<Rows>,
    /// How many of these are smooth: none of their segments met anything.
    pub smooth: u64,
    /// Facet from facet: moments of the source at each surfel of the target (M2P).
    pub m2p: Rows,
    /// Facet from facet: each surfel of the source into the local expansion of the target (P2L).
    pub p2l: Rows,
    /// Facet from facet, surfel from surfel by the point kernel (P2P).
    pub p2p: Rows,
    /// Facet from facet where only some surfels have the other in front: an expansion from those to
    /// those.
    pub mixed: Rows,
    /// Facet from facet where only some pairs face each other: the weight is the mean of the clamped
    /// kernel times visibility, which acts on the source's power.
    pub sampled: Rows,
    /// Surfel from surfel: the weight is the form factor times the visibility, or the part of the rays
    /// that stands for both.
    pub near: Rows,
    /// Error of the irradiance that is expected of the expansions where nothing is in the way: root
    /// mean square over the surfels, if errors of different links are independent. Sampled links, which
    /// bring too little to matter one by one, do not count.
    pub expected_error: f64,
}

impl Links {
    /// No links at all, between so many facets and so many surfels.
    pub fn none(facets: usize, surfels: usize) -> Links {
        Links {
            m2l: Vec::new(),
            smooth: 0,
            m2p: Rows::none(facets),
            p2l: Rows::none(facets),
            p2p: Rows::none(facets),
            mixed: Rows::none(facets),
            sampled: Rows::none(facets),
            near: Rows::none(surfels),
            expected_error: 0.0,
        }
    }

    /// Order of the expansions that these links need.
    pub fn order(&self) -> usize {
        self.m2l.len().saturating_sub(1)
    }

    /// Numbers of links by kind, as the stats show them.
    pub fn counts(&self) -> [(&'static str, u64); 8] {
        let m2l: usize = self.m2l.iter().map(Rows::len).sum();
        [
            ("smooth", self.smooth),
            ("fractional", m2l as u64 - self.smooth),
            ("m2p", self.m2p.len() as u64),
            ("p2l", self.p2l.len() as u64),
            ("p2p", self.p2p.len() as u64),
            ("mixed", self.mixed.len() as u64),
            ("sampled", self.sampled.len() as u64),
            ("near", self.near.len() as u64),
        ]
    }
}

/// Of two facets that make no link the larger one is split: is it the target?
fn splits_target(target: &Facet, source: &Facet) -> bool {
    source.is_leaf() || (!target.is_leaf() && target.radius >= source.radius)
}
