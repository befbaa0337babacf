//! The way down the targets on which lists without occlusion are found.
//!
//! A target visits the sources that its parent could not settle: some become links, some are left
//! to its children, which can be visited in parallel. So all entries of a row are found together,
//! and in the same order on any number of threads.

use rayon::prelude::*;

use super::csr::Part;
use super::{Links, Rows};
use crate::error::Result;
use crate::memory::Budget;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;

/// Facets with at most so many surfels are walked by one thread.
const GRAIN: usize = 1 << 12;

/// How one facet takes light from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interaction {
    /// Moments into local expansion, with this order.
    M2l(usize),
    /// Moments at each surfel of the target.
    M2p,
    /// Each surfel of the source into the local expansion.
    P2l,
    /// Surfel from surfel by the point kernel.
    P2p,
    /// P2P, and of the pairs that it leaves out the stored form factors.
    Near,
    /// Stored form factors of the pairs that see each other.
    Tested,
}

/// Lists of a part of the targets.
#[derive(Default)]
pub(super) struct Found {
    m2l: Vec<Part>,
    m2p: Part,
    p2l: Part,
    p2p: Part,
    near: Part,
}

impl Found {
    pub fn push(&mut self, target: u32, source: u32, interaction: Interaction) {
        let list = match interaction {
            Interaction::M2l(order) => {
                if self.m2l.len() <= order {
                    self.m2l.resize_with(order + 1, Part::default);
                }
                &mut self.m2l[order]
            }
            Interaction::M2p => &mut self.m2p,
            Interaction::P2l => &mut self.p2l,
            Interaction::P2p => &mut self.p2p,
            Interaction::Near => {
                self.p2p.push(target, source);
                &mut self.near
            }
            Interaction::Tested => &mut self.near,
        };
        list.push(target, source);
    }

    /// Bytes of its links, here and in their rows.
    fn bytes(&self) -> usize {
        let others = [&self.m2p, &self.p2l, &self.p2p, &self.near];
        self.m2l.iter().chain(others).map(Part::bytes).sum()
    }
}

/// A walk down an octree. `visit(target, sources, found)` settles the pairs of a target and sources
/// and returns the sources that are left to the target's children.
pub(super) struct Walk<'a, V> {
    pub octree: &'a Octree,
    pub visit: V,
    /// Largest order of the expansions: that of M2P and P2L.
    pub order: usize,
    pub budget: Budget,
    pub progress: &'a dyn Progress,
}

impl<V: Fn(u32, &[u32], &mut Found) -> Vec<u32> + Sync> Walk<'_, V> {
    /// The links of all surfels, from those of `roots` with all of `roots`; `near` makes those of
    /// surfels near each other.
    pub fn links(
        &self,
        surfels: &Surfels,
        roots: &[u32],
        near: impl FnOnce(&[Part], &Budget) -> Result<Rows>,
    ) -> Result<Links> {
        self.progress.stage("links", surfels.len() as u64);
        let found = self.branches(roots, roots)?;
        let facets = self.octree.facets.len();
        let mut m2l: Vec<Vec<Part>> = Vec::new();
        m2l.resize_with(self.order + 1, Vec::new);
        let (mut m2p, mut p2l, mut p2p, mut close) = (vec![], vec![], vec![], vec![]);
        for part in found {
            if m2l.len() < part.m2l.len() {
                m2l.resize_with(part.m2l.len(), Vec::new);
            }
            for (all, part) in m2l.iter_mut().zip(part.m2l) {
                all.push(part);
            }
            m2p.push(part.m2p);
            p2l.push(part.p2l);
            p2p.push(part.p2p);
            close.push(part.near);
        }
        let rows = |parts| Rows::gather(facets, parts);
        let m2l = m2l.into_iter().map(rows).collect::<Result<Vec<Rows>>>()?;
        Ok(Links {
            smooth: m2l.iter().map(|r| r.len() as u64).sum(),
            m2l,
            m2p: rows(m2p)?,
            p2l: rows(p2l)?,
            p2p: rows(p2p)?,
            near: near(&close, &self.budget)?,
            ..Links::none(facets, surfels.len())
        })
    }

    fn branches(&self, targets: &[u32], sources: &[u32]) -> Result<Vec<Found>> {
        let branches: Result<Vec<Vec<Found>>> = targets
            .par_iter()
            .map(|&target| self.branch(target, sources))
            .collect();
        Ok(branches?.into_iter().flatten().collect())
    }

    fn branch(&self, target: u32, sources: &[u32]) -> Result<Vec<Found>> {
        self.progress.check()?;
        let facet = &self.octree.facets[target as usize];
        let mut found = Found::default();
        if facet.is_leaf() || facet.len() <= GRAIN {
            self.descend(target, sources, &mut found);
            self.budget.take(found.bytes())?;
            self.progress.advance(facet.len() as u64);
            return Ok(vec![found]);
        }
        let left = (self.visit)(target, sources, &mut found);
        self.budget.take(found.bytes())?;
        let children: Vec<u32> = facet.children().collect();
        let mut all = vec![found];
        all.extend(self.branches(&children, &left)?);
        Ok(all)
    }

    fn descend(&self, target: u32, sources: &[u32], found: &mut Found) {
        let left = (self.visit)(target, sources, found);
        if !left.is_empty() {
            for child in self.octree.facets[target as usize].children() {
                self.descend(child, &left, found);
            }
        }
    }
}
