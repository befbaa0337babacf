//! The octree of facets: cells of space, split by normal as well.

mod build;
mod cell;
mod cones;
mod facet;
mod measure;
mod stored;

pub use cell::Cell;
pub(crate) use cell::{codes as morton_codes, morton};
pub use facet::Facet;
pub(crate) use stored::StoredFacet;

use rayon::prelude::*;

use crate::points::Surfels;

/// A Morton-ordered adaptive octree whose cells hold surfels of similar normal.
///
/// The root splits by normal until every part lies within a cone of [`MAX_HALF_ANGLE`]; each part
/// then has an octree of its own over the common cube. So every facet has exactly one parent, and
/// a link between two facets knows whether they face each other. Levels follow one another in
/// `facets`, children of a facet lie side by side.
#[derive(Clone, Debug, PartialEq)]
pub struct Octree {
    /// The root first, then level by level.
    pub facets: Vec<Facet>,
    /// First facet of each level, and the number of facets at the end.
    pub levels: Vec<u32>,
    /// Facets below which all splits are by place: their normals keep to a cone, and every surfel
    /// is in one of them. In increasing order.
    pub cones: Vec<u32>,
    /// Facets without children, in the order of their surfels.
    pub leaves: Vec<u32>,
}

/// Largest half-angle, in radians, of the cone of a facet's normals below the orientation splits.
///
/// 45-degree cones leave 2 to 12% of the links neither facing nor averted; 30-degree cones cost
/// up to 1.7 times the pairs for little gain.
pub const MAX_HALF_ANGLE: f64 = 0.7;

/// At most so many surfels a leaf where visibility is tested. With 4 of them links take one more round as often as
/// not (organic, cornell), with 12 they take longer in the cave.
pub const LEAF_SIZE: usize = 8;

impl Octree {
    /// Builds the octree, with at most `leaf_size` surfels a leaf (the paper's s); returns it with
    /// the surfels in its order, in which each facet's surfels lie side by side.
    pub fn build(surfels: &Surfels, leaf_size: usize) -> (Octree, Surfels) {
        build::build(surfels, leaf_size)
    }

    /// The octree of facets that are not measured yet.
    fn unmeasured(facets: Vec<Facet>, levels: Vec<u32>, cones: Vec<u32>) -> Octree {
        let all = 0..facets.len() as u32;
        let mut leaves: Vec<u32> = all.filter(|&f| facets[f as usize].is_leaf()).collect();
        leaves.par_sort_unstable_by_key(|&f| facets[f as usize].begin);
        Octree {
            facets,
            levels,
            cones,
            leaves,
        }
    }

    /// Facets of one level.
    pub fn level(&self, level: usize) -> std::ops::Range<usize> {
        self.levels[level] as usize..self.levels[level + 1] as usize
    }

    /// Number of levels.
    pub fn depth(&self) -> usize {
        self.levels.len() - 1
    }
}
