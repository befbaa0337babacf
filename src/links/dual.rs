//! Dual traversal of the octree with a multipole acceptance criterion (MAC).
//!
//! Both facets start at the root; of a pair that is not accepted the larger one is split.

use super::near::near;
use super::walk::{Found, Walk};
use super::{Cosines, Interaction, Links, splits_target};
use crate::error::Result;
use crate::memory::Budget;
use crate::octree::{Facet, Octree};
use crate::points::Surfels;
use crate::progress::Progress;

/// Default of [`Mac::theta`].
pub const THETA: f32 = 0.45;

/// What is to be done with a pair of facets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// No light passes.
    Drop,
    /// Look at the children of the larger one. Two leaves have none: they are linked by P2P.
    Split,
    /// They are linked.
    Link(Interaction),
}

/// Accepts a pair where both radii together are at most θ times the distance.
#[derive(Clone, Copy, Debug)]
pub struct Mac {
    pub theta: f32,
    /// Order of the expansions.
    pub order: usize,
    pub cosines: Cosines,
}

/// Finds the lists that a rule makes, `judge(target, source)` for facets of these numbers. No M2L is
/// of a higher `order`, which is that of M2P and P2L.
pub fn dual(
    octree: &Octree,
    surfels: &Surfels,
    order: usize,
    judge: impl Fn(u32, u32) -> Verdict + Sync,
    progress: &dyn Progress,
) -> Result<Links> {
    let facets = &octree.facets;
    let visit = |t: u32, sources: &[u32], found: &mut Found| {
        let target = &facets[t as usize];
        let mut left = Vec::new();
        let mut pairs: Vec<u32> = sources.iter().rev().copied().collect();
        while let Some(s) = pairs.pop() {
            let source = &facets[s as usize];
            match judge(t, s) {
                Verdict::Drop => {}
                Verdict::Link(interaction) => found.push(t, s, interaction),
                Verdict::Split if target.is_leaf() && source.is_leaf() => {
                    found.push(t, s, Interaction::P2p);
                }
                Verdict::Split if splits_target(target, source) => left.push(s),
                Verdict::Split => pairs.extend(source.children().rev()),
            }
        }
        left
    };
    let walk = Walk {
        octree,
        visit,
        order,
        budget: Budget::new(),
        progress,
    };
    walk.links(surfels, &[0], |close, budget| {
        near(octree, surfels, close, budget)
    })
}

impl Mac {
    /// Facets that are averted are dropped. Those that do not face each other entirely, or are near,
    /// are split down to leaves, which are linked surfel by surfel. Others are linked in the cheapest
    /// way.
    pub fn judge(&self, target: &Facet, source: &Facet) -> Verdict {
        let facing = self.cosines.facing(target, source);
        if facing.averted() {
            return Verdict::Drop;
        }
        let reach = target.radius + source.radius;
        let apart = facing.distance > 0.0 && reach <= self.theta * facing.distance;
        if apart && self.cosines.expand(&facing, source) {
            Verdict::Link(cheapest(target.len(), source.len(), self.order))
        } else if target.is_leaf() && source.is_leaf() && facing.near {
            Verdict::Link(Interaction::Near)
        } else {
            Verdict::Split
        }
    }
}

/// The interaction of order p with the fewest multiply-adds, all three colours together, between
/// facets of so many surfels.
///
/// With n(p) = C(p+3, 3): derivatives of the kernel, six components, take about 24 n(p). M2L pairs
/// them with all |α + β| ≤ p, C(p+6, 6) pairs of 9 products a colour. At one surfel its normal is
/// contracted first, 9 n(p), then 3 n(p) products a colour. A pair of surfels takes about 12.
pub(super) fn cheapest(targets: usize, sources: usize, order: usize) -> Interaction {
    let tensors = 24 * choose(order + 3, 3);
    let at_surfel = tensors + 18 * choose(order + 3, 3);
    let costs = [
        (Interaction::P2p, 12 * targets * sources),
        (Interaction::M2l(order), tensors + 27 * choose(order + 6, 6)),
        (Interaction::M2p, at_surfel * targets),
        (Interaction::P2l, at_surfel * sources),
    ];
    let least = costs.into_iter().min_by_key(|&(_, cost)| cost);
    least.map_or(Interaction::P2p, |(interaction, _)| interaction)
}

/// Binomial coefficient.
fn choose(n: usize, k: usize) -> usize {
    (1..=k).fold(1, |c, i| c * (n + 1 - i) / i)
}
