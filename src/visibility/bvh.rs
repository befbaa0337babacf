//! The cells as occluders under a bounding volume hierarchy, in the layouts of GPU and CPU.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3, Vec3A};
use rayon::prelude::*;

use crate::points::{MAX_EDGES, Surfels};

use super::NO_SURFEL;
use super::wide::{WideNode, widened};

/// Most occluders in a leaf.
const LEAF: usize = 4;
/// Bins an axis, for the surface area heuristic.
const BINS: usize = 16;
/// Nodes this deep are halved by count instead, which bounds the depth for any input.
const SAH_DEPTH: u32 = 64;
/// Subtrees with fewer cells are built by one thread.
const PARALLEL: usize = 4096;
/// Boxes grow by this part of the cloud's extent (8 roundings of it), so that none shuts out a
/// meeting point that was rounded out of it.
const PADDING: f32 = 8.0 * f32::EPSILON;
/// The extent, in medians of the cells' largest coordinates: strays far away do not count.
const USUAL: f32 = 4.0;

/// A box of the hierarchy; two texels.
///
/// Nodes lie depth-first: from a box that is met the way goes on to the next node, from one that
/// is not to the node `skip` further on, behind its subtree. No stack is needed.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Node {
    pub min: [f32; 3],
    pub skip: u32,
    pub max: [f32; 3],
    /// Zero, or `first occluder << COUNT_BITS | number of occluders` in a leaf.
    pub leaf: u32,
}

/// A cell that blocks; seven texels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Occluder {
    pub position: [f32; 3],
    pub surfel: u32,
    pub normal: [f32; 3],
    /// Square of the distance of the farthest corner.
    pub radius_squared: f32,
    pub tangent: [f32; 3],
    /// The surfel on the other side of the cell, or [`NO_SURFEL`].
    pub back: u32,
    /// Corners along (tangent, normal × tangent), as in [`crate::points::Cells`].
    pub corners: [[f32; 2]; MAX_EDGES],
}

/// The cells of a cloud, ready for segments to be tested against.
#[derive(Clone, Debug)]
pub struct Occluders {
    /// At least one node; the root's `skip` is their number. Devices walk them.
    pub nodes: Vec<Node>,
    /// The same hierarchy for the CPU.
    pub wide: Vec<WideNode>,
    /// In the order of the leaves.
    pub occluders: Vec<Occluder>,
}

impl Node {
    /// Low bits of `leaf` that hold the number of occluders.
    pub const COUNT_BITS: u32 = 3;

    /// The occluders of a leaf, as `leaf` says them.
    #[inline(always)]
    pub(super) fn occluders_of(leaf: u32) -> Range<usize> {
        let first = (leaf >> Self::COUNT_BITS) as usize;
        first..first + (leaf & ((1 << Self::COUNT_BITS) - 1)) as usize
    }

    /// Half the surface of the box: its chance to be met, up to a factor.
    pub(super) fn area(&self) -> f32 {
        half_area(Vec3A::from(self.max) - Vec3A::from(self.min))
    }
}

impl Occluders {
    /// Builds the hierarchy over all cells, scaled about their surfels by `occluder_scale`.
    /// Cells without an area block nothing and are left out.
    ///
    /// The result depends on the input only, not on the number of threads.
    pub fn build(surfels: &Surfels) -> Occluders {
        let cells: Vec<Item> = (0..surfels.len())
            .into_par_iter()
            .filter_map(|i| Item::cell(surfels, i))
            .collect();
        let (nodes, cells) = hierarchy(cells);
        let occluders = cells
            .par_iter()
            .map(|item| Occluder::new(surfels, item.surfel as usize))
            .collect();
        Occluders {
            wide: widened(&nodes),
            nodes,
            occluders,
        }
    }
}

/// The hierarchy over some boxes, at least one node, and the boxes in the order of its leaves.
pub(super) fn hierarchy(mut items: Vec<Item>) -> (Vec<Node>, Vec<Item>) {
    pad(&mut items);
    let mut nodes = Vec::with_capacity(items.len());
    if items.is_empty() {
        nodes.push(Node {
            skip: 1,
            ..Node::default()
        });
    } else {
        subtree(&mut items, 0, 0, &mut nodes);
    }
    (nodes, items)
}

/// Moves the sides of all boxes out by the padding.
pub(super) fn pad(items: &mut [Item]) {
    let mut reaches: Vec<f32> = items.par_iter().map(Item::reach).collect();
    let middle = reaches.len() / 2;
    let extent = match reaches.is_empty() {
        true => 0.0,
        false => USUAL * *reaches.select_nth_unstable_by(middle, f32::total_cmp).1,
    };
    items.par_iter_mut().for_each(|item| {
        let padding = Vec3A::splat(PADDING * item.reach().max(extent));
        item.min -= padding;
        item.max += padding;
    });
}

impl Occluder {
    pub(super) fn new(surfels: &Surfels, i: usize) -> Occluder {
        let corners = scaled_corners(surfels, i);
        let radius_squared = corners.iter().map(|c| c.length_squared());
        Occluder {
            position: surfels.below(i).to_array(),
            surfel: i as u32,
            normal: surfels.normals[i].to_array(),
            radius_squared: radius_squared.fold(0.0, f32::max),
            tangent: surfels.cells.tangents[i].to_array(),
            back: surfels.back(i).map_or(NO_SURFEL, |back| back as u32),
            corners: corners.map(|c| c.to_array()),
        }
    }
}

fn scaled_corners(surfels: &Surfels, i: usize) -> [Vec2; MAX_EDGES] {
    surfels.cells.corners[i].map(|c| c * surfels.occluder_scale)
}

/// The box of a surfel's cell, or of what else is to be met, while the tree is being built.
#[derive(Clone, Copy)]
pub(super) struct Item {
    pub min: Vec3A,
    pub max: Vec3A,
    pub surfel: u32,
}

impl Item {
    /// `None` for a cell without an area, and for the second side of one.
    pub(super) fn cell(surfels: &Surfels, i: usize) -> Option<Item> {
        if surfels.back(i).is_some_and(|back| back < i) {
            return None;
        }
        let corners = scaled_corners(surfels, i);
        let twice_area: f32 = (0..MAX_EDGES)
            .map(|k| corners[k].perp_dot(corners[(k + 1) % MAX_EDGES]))
            .sum();
        if twice_area <= 0.0 {
            return None;
        }
        let position = surfels.below(i);
        let tangent = surfels.cells.tangents[i];
        let bitangent = surfels.normals[i].cross(tangent);
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for c in corners {
            let corner = position + c.x * tangent + c.y * bitangent;
            min = min.min(corner);
            max = max.max(corner);
        }
        Some(Item {
            min: min.into(),
            max: max.into(),
            surfel: i as u32,
        })
    }

    /// Largest coordinate.
    fn reach(&self) -> f32 {
        self.min.abs().max(self.max.abs()).max_element()
    }

    /// Twice the centre of the box.
    #[inline(always)]
    fn centre(&self) -> Vec3A {
        self.min + self.max
    }
}

/// Appends the subtree over `items`, the first of which is occluder number `first`.
fn subtree(items: &mut [Item], first: usize, depth: u32, nodes: &mut Vec<Node>) {
    let all = items.iter().fold(Bin::EMPTY, |bin, item| bin.with(item));
    let mut node = Node {
        min: all.min.to_array(),
        skip: 1,
        max: all.max.to_array(),
        leaf: 0,
    };
    if items.len() <= LEAF {
        node.leaf = (first as u32) << Node::COUNT_BITS | items.len() as u32;
        nodes.push(node);
        return;
    }
    let at = nodes.len();
    nodes.push(node);
    let middle = split(items, depth);
    let parallel = items.len() >= PARALLEL;
    let (left, right) = items.split_at_mut(middle);
    if parallel {
        let tree = |items: &mut [Item], first| {
            let mut nodes = Vec::with_capacity(items.len());
            subtree(items, first, depth + 1, &mut nodes);
            nodes
        };
        let (left, right) = rayon::join(|| tree(left, first), || tree(right, first + middle));
        nodes.extend(left);
        nodes.extend(right);
    } else {
        subtree(left, first, depth + 1, nodes);
        subtree(right, first + middle, depth + 1, nodes);
    }
    nodes[at].skip = (nodes.len() - at) as u32;
}

/// Sorts `items` into two parts, neither empty, and returns the length of the first: where the
/// surface area heuristic finds the least cost among the bins of all three axes (Wald 2007,
/// "On fast construction of SAH-based bounding volume hierarchies"); in halves where it has
/// nothing to say.
fn split(items: &mut [Item], depth: u32) -> usize {
    let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    for item in items.iter() {
        low = low.min(item.centre());
        high = high.max(item.centre());
    }
    let scale = BINS as f32 / (high - low);
    let bin_of = |item: &Item| {
        // Casts take NaN to 0 and infinity to the largest value.
        ((item.centre() - low) * scale)
            .to_array()
            .map(|x| (x as usize).min(BINS - 1))
    };

    let mut best = (f32::INFINITY, 0, 0);
    if depth < SAH_DEPTH {
        let mut bins = [[Bin::EMPTY; BINS]; 3];
        for item in items.iter() {
            let at = bin_of(item);
            for axis in 0..3 {
                bins[axis][at[axis]] = bins[axis][at[axis]].with(item);
            }
        }
        for (axis, bins) in bins.iter().enumerate() {
            let mut right_cost = [0.0; BINS];
            let mut right = Bin::EMPTY;
            for k in (1..BINS).rev() {
                right = right.join(&bins[k]);
                right_cost[k] = right.cost();
            }
            let mut left = Bin::EMPTY;
            for k in 1..BINS {
                left = left.join(&bins[k - 1]);
                let cost = left.cost() + right_cost[k];
                let divides = left.count > 0 && left.count < items.len() as u32;
                if divides && cost < best.0 {
                    best = (cost, axis, k);
                }
            }
        }
    }
    let (cost, axis, bin) = best;
    if cost < f32::INFINITY {
        return partition(items, |item| bin_of(item)[axis] < bin);
    }
    let axis = (high - low).max_position();
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| a.centre()[axis].total_cmp(&b.centre()[axis]));
    middle
}

/// Moves the items that belong to the left to the front and returns their number.
fn partition(items: &mut [Item], is_left: impl Fn(&Item) -> bool) -> usize {
    let mut end = 0;
    for i in 0..items.len() {
        if is_left(&items[i]) {
            items.swap(i, end);
            end += 1;
        }
    }
    end
}

/// The box around some items, and their number.
#[derive(Clone, Copy)]
pub(super) struct Bin {
    pub min: Vec3A,
    pub max: Vec3A,
    count: u32,
}

impl Bin {
    pub const EMPTY: Bin = Bin {
        min: Vec3A::INFINITY,
        max: Vec3A::NEG_INFINITY,
        count: 0,
    };

    #[inline(always)]
    pub fn with(&self, item: &Item) -> Bin {
        Bin {
            min: self.min.min(item.min),
            max: self.max.max(item.max),
            count: self.count + 1,
        }
    }

    fn join(&self, other: &Bin) -> Bin {
        Bin {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
            count: self.count + other.count,
        }
    }

    /// Chance to be met, up to a factor, times the tests that follow.
    fn cost(&self) -> f32 {
        if self.count == 0 {
            return 0.0;
        }
        half_area(self.max - self.min) * self.count as f32
    }
}

/// Half the surface of a box of this size.
fn half_area(d: Vec3A) -> f32 {
    d.x * d.y + d.y * d.z + d.z * d.x
}
