//! The hierarchy as it is stored: its shape. Boxes and occluders follow from the cells.

use glam::Vec3A;
use rayon::prelude::*;

use super::bvh::{Bin, Item, Node, Occluder, Occluders, pad};
use super::wide::widened;
use crate::points::Surfels;

/// The shape of a hierarchy.
#[derive(Debug, Default)]
pub(crate) struct Shape {
    /// Occluders of each node, depth-first; none of a node with two others below.
    pub counts: Vec<u32>,
    /// Surfels of the occluders, leaf by leaf.
    pub order: Vec<u32>,
}

/// No hierarchy is deeper: it is halved below a depth of 64.
const DEEPEST: u32 = 128;
/// As many occluders as a leaf can say that it has.
const MOST: u32 = (1 << Node::COUNT_BITS) - 1;

impl Occluders {
    pub(crate) fn shape(&self) -> Shape {
        Shape {
            counts: self.nodes.iter().map(|n| n.leaf & MOST).collect(),
            order: self.occluders.iter().map(|o| o.surfel).collect(),
        }
    }

    /// The hierarchy of this shape over all cells; what is wrong with it, in words, if there is none.
    pub(crate) fn restored(surfels: &Surfels, shape: &Shape) -> Result<Occluders, &'static str> {
        let Shape { counts, order } = shape;
        let mut missing = vec![true; surfels.len()];
        for &surfel in order {
            match missing.get_mut(surfel as usize) {
                Some(missing) if *missing => *missing = false,
                _ => return Err("cells that are not there, or twice"),
            }
        }
        let cell = |i: usize| Item::cell(surfels, i);
        let left_out = (0..surfels.len()).into_par_iter().filter(|&i| missing[i]);
        if left_out.map(cell).any(|cell| cell.is_some()) {
            return Err("cells that are in no box");
        }
        let items: Option<Vec<Item>> = order.par_iter().map(|&i| cell(i as usize)).collect();
        let mut items = items.ok_or("cells without an area")?;
        pad(&mut items);
        let nodes = nodes(counts, &items).ok_or("boxes that are no hierarchy")?;
        Ok(Occluders {
            wide: widened(&nodes),
            nodes,
            occluders: order
                .par_iter()
                .map(|&i| Occluder::new(surfels, i as usize))
                .collect(),
        })
    }
}

/// Nodes from the last to the first, so that what is below a node is there before it.
fn nodes(counts: &[u32], items: &[Item]) -> Option<Vec<Node>> {
    if counts == [0] && items.is_empty() {
        return Some(vec![Node {
            skip: 1,
            ..Node::default()
        }]);
    }
    let mut nodes = vec![Node::default(); counts.len()];
    let mut heights = vec![0; counts.len()];
    let mut end = items.len();
    for (k, &count) in counts.iter().enumerate().rev() {
        let around = match count {
            0 => {
                let left = k + 1;
                let right = left + nodes.get(left)?.skip as usize;
                heights[k] = 1 + heights[left].max(*heights.get(right)?);
                nodes[k].skip = 1 + nodes[left].skip + nodes[right].skip;
                [left, right]
                    .map(|n| [Vec3A::from(nodes[n].min), Vec3A::from(nodes[n].max)])
                    .into_iter()
                    .reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?
            }
            1..=MOST => {
                let begin = end.checked_sub(count as usize)?;
                let all = items[begin..end]
                    .iter()
                    .fold(Bin::EMPTY, |bin, item| bin.with(item));
                nodes[k].skip = 1;
                nodes[k].leaf = (begin as u32) << Node::COUNT_BITS | count;
                end = begin;
                [all.min, all.max]
            }
            _ => return None,
        };
        [nodes[k].min, nodes[k].max] = around.map(|v| v.to_array());
        if heights[k] > DEEPEST {
            return None;
        }
    }
    (end == 0 && nodes.first()?.skip as usize == nodes.len()).then_some(nodes)
}
