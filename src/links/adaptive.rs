//! The four lists of the adaptive method (appendix B.6), for facets.
//!
//! Cells of one level interact by M2L if they do not touch while their parents do. Where one of the
//! two is a leaf, and larger, the other is refined until it does not touch the leaf: then its moments
//! act on the leaf's surfels (M2P), and the leaf's surfels on its local expansion (P2L). (In the
//! paper these two lists are interchanged.) Leaves that touch interact surfel by surfel (P2P).
//!
//! A facet stands for all cells in which it is alone, from the octant as which it was split off down
//! to its own. Each cone has an octree of its own over the common cube, so that all of this holds
//! for facets of two cones as well.

use super::classic::{State, States};
use super::csr::Part;
use super::near::near;
use super::walk::{Found, Walk};
use super::{Cosines, Facing, Interaction, Links, Rows};
use crate::error::Result;
use crate::memory::Budget;
use crate::octree::{Facet, Octree};
use crate::points::Surfels;
use crate::progress::Progress;

/// What cubes that do not touch guarantee to expansions about their middles: of both radii to the
/// distance, for cubes of one size (√3 sides to 2), and of the smaller cube's radius to the distance
/// of its middle from the larger (√3/2 to 3/2). A facet's centre is that of its surfels and may lie
/// anywhere in the cube, so that this is asked for as well.
const OPENINGS: [f32; 2] = [0.866_025_4, 0.577_350_3];

/// Finds the adaptive lists, with expansions of one order.
///
/// Facets that are averted are in no list. Those that do not face each other entirely, or are near,
/// are refined down to leaves, which interact surfel by surfel.
pub fn adaptive(
    octree: &Octree,
    surfels: &Surfels,
    cosines: Cosines,
    order: usize,
    progress: &dyn Progress,
) -> Result<Links> {
    let lists = Lists {
        octree,
        cosines,
        order,
        states: None,
    };
    lists.find(surfels, progress, |close, budget| {
        near(octree, surfels, close, budget)
    })
}

/// What the adaptive lists follow from.
pub(super) struct Lists<'a> {
    pub octree: &'a Octree,
    pub cosines: Cosines,
    pub order: usize,
    /// Who sees whom; nothing is in the way where there are none.
    pub states: Option<&'a States>,
}

impl Lists<'_> {
    /// Finds the lists; `near` links the surfels of neighbouring leaves.
    pub fn find(
        &self,
        surfels: &Surfels,
        progress: &dyn Progress,
        near: impl FnOnce(&[Part], &Budget) -> Result<Rows>,
    ) -> Result<Links> {
        let visit = |target: u32, sources: &[u32], found: &mut Found| {
            let visit = Visit {
                lists: self,
                target,
            };
            visit.settle(sources, found)
        };
        let walk = Walk {
            octree: self.octree,
            visit,
            order: self.order,
            budget: Budget::new(),
            progress,
        };
        walk.links(surfels, &self.octree.cones, near)
    }
}

struct Visit<'a> {
    lists: &'a Lists<'a>,
    target: u32,
}

/// What comes of a pair of facets.
enum Outcome {
    Link(Interaction),
    /// None sees any.
    Drop,
    Split,
}

impl Visit<'_> {
    /// Settles pairs of the target and sources; returns the sources left to its children.
    fn settle(&self, sources: &[u32], found: &mut Found) -> Vec<u32> {
        let octree = self.lists.octree;
        let facets = &octree.facets;
        let target = &facets[self.target as usize];
        // Levels above have been looked at with the target's parent.
        let first = match octree.cones.binary_search(&self.target) {
            Ok(_) => 0,
            Err(_) => facets[target.parent as usize].cell.level + 1,
        };
        let mut left = Vec::new();
        let mut pairs: Vec<(u32, u32)> = sources.iter().rev().map(|&s| (s, first)).collect();
        while let Some((s, level)) = pairs.pop() {
            let source = &facets[s as usize];
            let facing = self.lists.cosines.facing(target, source);
            if facing.averted() {
                continue;
            }
            match self.follow(s, &facing, level) {
                (_, Outcome::Link(interaction)) => found.push(self.target, s, interaction),
                (_, Outcome::Drop) => {}
                (level, Outcome::Split) if !splits(target, level) => {
                    pairs.extend(source.children().rev().map(|child| (child, level + 1)));
                }
                (level, Outcome::Split) if splits(source, level) => left.extend(source.children()),
                (_, Outcome::Split) => left.push(s),
            }
        }
        left
    }

    /// Follows two facets down from a level, to where they interact or one of them has to be split.
    fn follow(&self, s: u32, facing: &Facing, mut level: u32) -> (u32, Outcome) {
        let facets = &self.lists.octree.facets;
        let (target, source) = (&facets[self.target as usize], &facets[s as usize]);
        let last = target.cell.level.max(source.cell.level);
        let mut postponed = false;
        loop {
            let separated = self.separated(source, facing, level);
            if let Some(interaction) = separated
                && !postponed
            {
                match self.state(s) {
                    State::Valid => return (level, Outcome::Link(interaction)),
                    State::Invalid => return (level, Outcome::Drop),
                    State::Partial => postponed = true,
                }
            }
            if splits(target, level) || splits(source, level) {
                return (level, Outcome::Split);
            }
            if level >= last {
                return (level, self.leaves(s, facing));
            }
            level += 1;
        }
    }

    fn state(&self, source: u32) -> State {
        let states = self.lists.states;
        states.map_or(State::Valid, |states| states.of(self.target, source))
    }

    /// How two leaves interact that are not separated. Where things are in the way, neighbours are
    /// tested surfel by surfel.
    fn leaves(&self, s: u32, facing: &Facing) -> Outcome {
        let facets = &self.lists.octree.facets;
        let touch = || {
            facets[self.target as usize]
                .cell
                .touches(facets[s as usize].cell)
        };
        if self.lists.states.is_some() && (facing.near || touch()) {
            return Outcome::Link(Interaction::Tested);
        }
        match (self.state(s), facing.near) {
            (State::Valid, true) => Outcome::Link(Interaction::Near),
            (State::Valid, false) => Outcome::Link(Interaction::P2p),
            (State::Invalid | State::Partial, _) => Outcome::Drop,
        }
    }

    /// How the cells of this level interact, or the leaf of a higher level and a cell of this one;
    /// `None` if they are not separated.
    fn separated(&self, source: &Facet, facing: &Facing, level: u32) -> Option<Interaction> {
        let target = &self.lists.octree.facets[self.target as usize];
        let cells = [target, source].map(|f| f.cell.ancestor(level));
        if !self.lists.cosines.expand(facing, source) || cells[0].touches(cells[1]) {
            return None;
        }
        let apart =
            |small: &Facet, large: &Facet| small.radius < OPENINGS[1] * distance(small, large);
        match (target.cell.level < level, source.cell.level < level) {
            (false, false) => (target.radius + source.radius < OPENINGS[0] * facing.distance)
                .then_some(Interaction::M2l(self.lists.order)),
            (true, false) => apart(source, target).then_some(Interaction::M2p),
            (false, true) => apart(target, source).then_some(Interaction::P2l),
            (true, true) => None,
        }
    }
}

/// Whether a facet has to be split for the level below this one.
fn splits(facet: &Facet, level: u32) -> bool {
    !facet.is_leaf() && facet.cell.level <= level
}

/// Distance of a facet's centre from the box of another.
fn distance(a: &Facet, b: &Facet) -> f32 {
    a.centre.distance(a.centre.clamp(b.low, b.high))
}
