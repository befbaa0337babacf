//! The hierarchy as the CPU walks it: four boxes a node, tested at once.

use std::ops::Range;

use glam::{Vec3, Vec4};

use super::Node;

/// The far side of a box moves out by this, so that rounding never loses a box that is met
/// (Ize 2013, "Robust BVH ray traversal").
const ROUNDING: f32 = 1.0 + 4.0 * f32::EPSILON;
/// Smallest component of a direction that boxes are tested with: its inverse stays finite.
const SMALLEST: f32 = 1e-20;
/// Entries of the stack of one call.
const STACK: usize = 64;

/// Four boxes of the hierarchy.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WideNode {
    /// Bounds, axis by axis. A box that is not there lies at infinity, where nothing meets it.
    min: [Vec4; 3],
    max: [Vec4; 3],
    /// What is in each box: occluders as in [`Node::leaf`], or, where their number is zero, another
    /// of these nodes.
    content: [u32; 4],
}

impl WideNode {
    const NONE: WideNode = WideNode {
        min: [Vec4::INFINITY; 3],
        max: [Vec4::INFINITY; 3],
        content: [0; 4],
    };
}

/// The same boxes, level by level or two at once: of the boxes in a node the largest are opened.
pub(super) fn widened(nodes: &[Node]) -> Vec<WideNode> {
    let mut wide = Vec::with_capacity(nodes.len() / 3);
    if nodes[0].skip > 1 || nodes[0].leaf != 0 {
        widen(nodes, 0, &mut wide);
    }
    wide
}

/// Appends the subtree below a node, and returns the place of its root.
fn widen(nodes: &[Node], root: usize, wide: &mut Vec<WideNode>) -> usize {
    let mut boxes = vec![root];
    while boxes.len() < 4 {
        let inner = (0..boxes.len()).filter(|&k| nodes[boxes[k]].leaf == 0);
        let area = |&k: &usize| nodes[boxes[k]].area();
        let Some(k) = inner.max_by(|a, b| area(a).total_cmp(&area(b))) else {
            break;
        };
        let first = boxes[k] + 1;
        boxes[k] = first;
        boxes.insert(k + 1, first + nodes[first].skip as usize);
    }
    let at = wide.len();
    wide.push(WideNode::NONE);
    for (k, &i) in boxes.iter().enumerate() {
        let node = &nodes[i];
        for axis in 0..3 {
            wide[at].min[axis][k] = node.min[axis];
            wide[at].max[axis][k] = node.max[axis];
        }
        wide[at].content[k] = match node.leaf {
            0 => (widen(nodes, i, wide) as u32) << Node::COUNT_BITS,
            leaf => leaf,
        };
    }
    at
}

/// A segment as boxes are tested with it, four at a time.
pub(super) struct Line {
    /// Where it begins, as seen from the low and the high sides of boxes.
    start: [[Vec4; 3]; 2],
    /// The inverse of its direction.
    inverse: [Vec4; 3],
}

impl Line {
    /// Boxes are met that are within a margin of it.
    pub fn new(from: Vec3, to: Vec3, margin: f32) -> Line {
        Line {
            start: [from + margin, from - margin].map(|v| v.to_array().map(Vec4::splat)),
            inverse: (to - from).to_array().map(|x| Vec4::splat(inverse(x))),
        }
    }
}

fn inverse(x: f32) -> f32 {
    1.0 / if x.abs() >= SMALLEST {
        x
    } else {
        SMALLEST.copysign(x)
    }
}

/// Hands all occluders in boxes that a line meets, up to the part `limit` of it, to `meet`, which
/// may lower the limit; below zero nothing is left to find. Nearest boxes first, if that is asked
/// for. Boxes may err on the side of being met.
pub(super) fn walk<const NEAREST_FIRST: bool>(
    nodes: &[WideNode],
    line: &Line,
    limit: &mut f32,
    meet: &mut impl FnMut(&mut f32, Range<usize>),
) {
    if !nodes.is_empty() {
        descend::<NEAREST_FIRST>(nodes, 0, line, limit, meet);
    }
}

/// The same below one box, of which `content` is said.
fn descend<const NEAREST_FIRST: bool>(
    nodes: &[WideNode],
    mut content: u32,
    line: &Line,
    limit: &mut f32,
    meet: &mut impl FnMut(&mut f32, Range<usize>),
) {
    // What is in boxes that are met, and where they are met.
    let mut stack = [(0, 0.0); STACK];
    let mut top = 0;
    loop {
        let occluders = Node::occluders_of(content);
        if occluders.is_empty() {
            let node = &nodes[(content >> Node::COUNT_BITS) as usize];
            let (near, mut met) = boxes_met(node, line, *limit);
            let bottom = top;
            while met != 0 {
                let k = met.trailing_zeros() as usize;
                met &= met - 1;
                if top == STACK {
                    // So deep a tree is walked by another call.
                    descend::<NEAREST_FIRST>(nodes, node.content[k], line, limit, meet);
                    continue;
                }
                let mut at = top;
                while NEAREST_FIRST && at > bottom && stack[at - 1].1 < near[k] {
                    stack[at] = stack[at - 1];
                    at -= 1;
                }
                stack[at] = (node.content[k], near[k]);
                top += 1;
            }
        } else {
            meet(limit, occluders);
            if *limit < 0.0 {
                return;
            }
        }
        loop {
            if top == 0 {
                return;
            }
            top -= 1;
            let (next, near) = stack[top];
            if near <= *limit * ROUNDING {
                content = next;
                break;
            }
        }
    }
}

/// Where a line meets four boxes, and, as bits, which of them it meets.
#[inline(always)]
fn boxes_met(node: &WideNode, line: &Line, limit: f32) -> ([f32; 4], u32) {
    let mut near = Vec4::ZERO;
    let mut far = Vec4::splat(limit);
    for axis in 0..3 {
        let a = (node.min[axis] - line.start[0][axis]) * line.inverse[axis];
        let b = (node.max[axis] - line.start[1][axis]) * line.inverse[axis];
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    (near.to_array(), near.cmple(far * ROUNDING).bitmask())
}
