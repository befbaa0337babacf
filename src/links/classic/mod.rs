//! The report's own way with occlusion (2.2.4): adaptive lists whose pairs are kept, dropped or
//! postponed by the visibility of the leaves below them.
//!
//! Its nodes are facets, so that those of one place whose normals differ have states of their own.
//! A pair of the lists interacts if all leaves of one see all of the other (valid), is dropped if
//! none do (invalid), and otherwise (partial) goes down to the children, of a leaf and an inner facet
//! to those of the inner one. Leaves that touch, or are in the near range, are in no list: their
//! surfels are linked one by one, by the form factors of those that see each other. Leaves that are
//! apart but face each other in part only interact by P2P, if they see each other.
//!
//! All pairs of surfels are tested that the cones leave: the work grows as the square of their number.

mod bits;
mod cones;
mod leaves;
mod near;
mod states;

pub use leaves::Tally;
pub use states::{State, States};

use super::adaptive::Lists;
use super::{CLAMPED, Links};
use crate::error::Result;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::{PointTest, PointVisibility};

/// At most so many surfels a leaf: leaves see each other as a whole or not at all, so that shadows
/// are as coarse as they are.
///
/// Measured for 3,000 points in cornell, two_rooms and organic, irradiance by one application against
/// the sum over all pairs of points that see each other, relative L2 of light from everywhere and from
/// a lamp: leaves of 2 surfels 0.4 to 1.4% and 1.9 to 2.7%, of 4 0.5 to 2.2% and 2.4 to 4.0%, of 8 1.0
/// to 2.9% and 3.8 to 6.6%.
pub const CLASSIC_LEAF_SIZE: usize = 2;

/// Largest order of the expansions for a tolerance: 2 down to 0.003, 4 to 0.0003, then 6. Order 1 errs to one side.
pub fn classic_order(tolerance: f64) -> usize {
    match tolerance {
        3e-3.. => 2,
        3e-4.. => 4,
        _ => 6,
    }
}

/// When points and leaves see each other.
///
/// The thresholds of leaves are parts of their points, not numbers of points as in the report, so
/// that they mean the same whatever the size of a leaf. Below 0 they let all pairs pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// When points see each other (t1).
    pub point: PointTest,
    /// A point sees a leaf if it sees more than this part (t2) of the leaf's points.
    pub point_leaf: f32,
    /// Two leaves see each other if more than this part (t3) of the points of both, taken together,
    /// see the other leaf. (The report counts the points of one leaf: then light would go one way
    /// and not come back.)
    pub leaf_leaf: f32,
}

impl Default for Thresholds {
    /// In small leaves halves are common, and ¾ and ¼ let as much light through as there is: of light
    /// from everywhere 0.1 to 0.3% more in the scenes above. One half for both, which no half
    /// passes, loses 0.3 to 1.8%, a little less than half adds 0.3 to 1.4%.
    fn default() -> Self {
        Thresholds {
            point: PointTest::default(),
            point_leaf: 0.75,
            leaf_leaf: 0.25,
        }
    }
}

/// Finds the lists of pairs that see each other, with expansions of one order.
pub fn classic(
    octree: &Octree,
    surfels: &Surfels,
    order: usize,
    states: &States,
    points: &dyn PointVisibility,
    progress: &dyn Progress,
) -> Result<Links> {
    let lists = Lists {
        octree,
        cosines: CLAMPED,
        order,
        states: Some(states),
    };
    lists.find(surfels, progress, |close, budget| {
        near::seen(octree, surfels, close, points, budget, progress)
    })
}
