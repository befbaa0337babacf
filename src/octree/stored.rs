//! The octree as it is stored: numbers of surfels and children, from which the rest follows.

use bytemuck::{Pod, Zeroable};
use glam::UVec3;

use super::measure::measure;
use super::{Cell, Facet, Octree};
use crate::points::Surfels;

/// A facet in the order of [`Octree::facets`], in which children lie behind those of the facets before.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct StoredFacet {
    pub surfels: u32,
    pub children: u32,
    pub level: u32,
    pub corner: [u32; 3],
}

/// No octree is deeper: 21 levels of the Morton code, halves of 2²⁹ surfels, splits by normal.
const DEEPEST: usize = 100;
/// Leaves where visibility is tested are not nearly as large.
const LARGEST_LEAF: u32 = 64;

impl Octree {
    pub(crate) fn stored(&self) -> Vec<StoredFacet> {
        let stored = |f: &Facet| StoredFacet {
            surfels: f.end - f.begin,
            children: f.child_count,
            level: f.cell.level,
            corner: f.cell.corner.to_array(),
        };
        self.facets.iter().map(stored).collect()
    }

    /// The octree of surfels in its order; what is wrong, in words, if there is none.
    pub(crate) fn restored(
        stored: &[StoredFacet],
        cones: Vec<u32>,
        surfels: &Surfels,
    ) -> Result<Octree, &'static str> {
        let ensure = |fits: bool, what| if fits { Ok(()) } else { Err(what) };
        let root = stored.first().ok_or("no facets")?;
        ensure(
            root.surfels as usize == surfels.len(),
            "the root does not have all surfels",
        )?;
        let mut facets: Vec<Facet> = vec![Facet::default(); stored.len()];
        facets[0].end = root.surfels;
        let mut levels = vec![0, 1];
        let mut next = 1;
        for (i, s) in stored.iter().enumerate() {
            if i == levels[levels.len() - 1] {
                levels.push(next);
                ensure(levels.len() <= DEEPEST, "too many levels")?;
            }
            let (first, count) = (next, s.children as usize);
            ensure(
                i < first && count <= stored.len() - first,
                "children that are not there",
            )?;
            next += count;
            let fits = s.level < u32::BITS * 2 && s.corner.iter().all(|c| *c < 1 << 21);
            ensure(fits, "cells that are not in the octree's cube")?;
            facets[i].first_child = first as u32;
            facets[i].child_count = s.children;
            facets[i].cell = Cell {
                level: s.level,
                corner: UVec3::from_array(s.corner),
            };
            let Facet { mut begin, end, .. } = facets[i];
            ensure(
                count > 0 || s.surfels <= LARGEST_LEAF,
                "leaves that are too large",
            )?;
            for (child, s) in facets[first..next].iter_mut().zip(&stored[first..]) {
                ensure(
                    0 < s.surfels && s.surfels <= end - begin,
                    "children with other surfels than their parent",
                )?;
                *child = Facet {
                    begin,
                    end: begin + s.surfels,
                    parent: i as u32,
                    ..Facet::default()
                };
                begin += s.surfels;
            }
            ensure(
                count == 0 || begin == end,
                "children without all surfels of their parent",
            )?;
        }
        ensure(next == stored.len(), "facets without a parent")?;
        let ordered = cones.is_sorted_by(|a, b| a < b);
        let there = cones.last().is_none_or(|c| (*c as usize) < stored.len());
        ensure(ordered && there, "cones that are not there")?;
        let levels = levels.iter().map(|l| *l as u32).collect();
        let mut octree = Octree::unmeasured(facets, levels, cones);
        measure(&mut octree, surfels);
        Ok(octree)
    }
}
