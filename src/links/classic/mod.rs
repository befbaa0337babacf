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
use super::{Cosines, Links};
use crate::error::Result;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::{PointTest, PointVisibility};

/// Surfels a leaf: what leaves do not see all of, the thresholds decide as a whole.
pub const CLASSIC_LEAF_SIZE: usize = 4;

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

impl Thresholds {
    /// All pairs pass.
    pub fn open() -> Thresholds {
        Thresholds {
            point: PointTest {
                threshold: -1.0,
                ..PointTest::default()
            },
            point_leaf: -1.0,
            leaf_leaf: -1.0,
        }
    }
}

impl Default for Thresholds {
    fn default() -> Self {
        Thresholds {
            point: PointTest::default(),
            point_leaf: 0.5,
            leaf_leaf: 0.5,
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
        cosines: Cosines::Clamped { tolerance: 0.0 },
        order,
        states: Some(states),
    };
    lists.find(surfels, progress, |close, budget| {
        near::seen(octree, surfels, close, points, budget, progress)
    })
}
