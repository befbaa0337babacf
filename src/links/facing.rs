//! Bounds of which way two facets face.

use crate::expansion::NEAR_SPACINGS;
use crate::octree::Facet;

/// Which cosines count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cosines {
    /// Positive ones: max(0, cos). Sources nearby are cells.
    Clamped {
        /// Expansions cannot clamp: of facets that do not face each other entirely they bring light
        /// from below the horizon, where there is none. That is accepted up to this form factor.
        /// At 0 all around the horizon of a curved surface is refined down to leaves, for every leaf
        /// that sees it.
        tolerance: f32,
    },
    /// Those of either sign, as in (C.2): every pair counts. Sources are points, however near.
    Signed,
}

/// Positive cosines only, without any light from below the horizon.
pub const CLAMPED: Cosines = Cosines::Clamped { tolerance: 0.0 };

impl Cosines {
    /// How two facets face each other where these cosines count.
    pub fn facing(self, target: &Facet, source: &Facet) -> Facing {
        match self {
            Cosines::Clamped { .. } => Facing::between(target, source),
            Cosines::Signed => Facing::everything(target, source),
        }
    }

    /// May an expansion, which is of point sources and signed cosines, stand for the source?
    pub fn expand(self, facing: &Facing, source: &Facet) -> bool {
        match self {
            Cosines::Clamped { tolerance } => {
                !facing.near && (facing.full() || facing.below_horizon(source) <= tolerance)
            }
            Cosines::Signed => true,
        }
    }
}

/// What holds for every surfel x of a target facet and y of a source facet.
#[derive(Clone, Copy, Debug)]
pub struct Facing {
    /// Distance of the centres.
    pub distance: f32,
    /// Least distance of an x and a y.
    pub gap: f32,
    /// Some pairs may be in the near range, where sources are cells and not points.
    pub near: bool,
    /// Bounds of n_x · (y - x): the target's normals against the way to the source.
    pub target: [f32; 2],
    /// Bounds of n_y · (x - y).
    pub source: [f32; 2],
}

impl Facing {
    pub fn between(target: &Facet, source: &Facet) -> Facing {
        let distance = target.centre.distance(source.centre);
        let reach = target.radius + source.radius;
        let farthest = distance + reach;
        let apart = (target.low - source.high)
            .max(source.low - target.high)
            .max(glam::Vec3::ZERO)
            .length();
        let gap = apart.max(distance - reach);
        let mut facing = Facing {
            distance,
            gap,
            near: gap < 1.00001 * NEAR_SPACINGS as f32 * target.spacing.max(source.spacing),
            target: heights(target, source, farthest),
            source: heights(source, target, farthest),
        };
        if facing.near {
            // In the near range a source is its cell, part of which may rise above the horizon.
            facing.target[0] -= source.reach;
            facing.target[1] += source.reach;
        }
        facing
    }

    /// As if all surfels faced each other.
    fn everything(target: &Facet, source: &Facet) -> Facing {
        let distance = target.centre.distance(source.centre);
        Facing {
            distance,
            gap: (distance - target.radius - source.radius).max(0.0),
            near: false,
            target: [0.0, f32::INFINITY],
            source: [0.0, f32::INFINITY],
        }
    }

    /// No surfel of one faces any surfel of the other.
    pub fn averted(&self) -> bool {
        // A height that is rounding noise does not count as facing.
        let least = 1e-6 * self.distance;
        self.target[1] <= least || self.source[1] <= least
    }

    /// All surfels of one face all surfels of the other.
    pub fn full(&self) -> bool {
        self.target[0] >= 0.0 && self.source[0] >= 0.0
    }

    /// Mean cosine that is wrongly taken or left out if surfels on one side, whose heights over the other
    /// are within these bounds, take all of the other side or nothing of it. A surfel whose horizon
    /// cuts the other side is wrong by about opening / 8; of normals that differ, few are such.
    pub fn cut(&self, heights: [f32; 2], opening: f32) -> f32 {
        if heights[0] >= 0.0 {
            return 0.0;
        }
        let range = (heights[1] - heights[0]) / self.distance;
        0.125 * opening * (2.0 * opening / range).min(1.0)
    }

    /// Whether it is places more than normals that keep facets from facing each other entirely: then
    /// most of their parts do, or are averted.
    pub fn cut_by_place(&self, opening: f32) -> bool {
        [self.target, self.source]
            .iter()
            .any(|h| h[0] < 0.0 && h[1] - h[0] < 3.0 * opening * self.distance)
    }

    /// Largest form factor of the source where signed cosines give one but clamped ones do not.
    fn below_horizon(&self, source: &Facet) -> f32 {
        let [t, s] = [self.target, self.source];
        let product = f32::max(-t[0] * s[1].max(-s[0]), -s[0] * t[1].max(-t[0]));
        let square = self.gap * self.gap;
        match square > 0.0 {
            true => source.area * (product.max(0.0) / square) / (std::f32::consts::PI * square),
            false => f32::INFINITY,
        }
    }

    /// Upper bounds of the cosines at target and source.
    pub fn cosines(&self) -> [f32; 2] {
        let gap = self.gap.max(f32::MIN_POSITIVE);
        [
            (self.target[1] / gap).min(1.0),
            (self.source[1] / gap).min(1.0),
        ]
    }
}

/// Bounds of n_a · (b - a) over all surfels a and b of two facets that are at most `farthest` apart.
///
/// Along the axis of a the way b - a has a height h within known bounds, and across it at most
/// √(farthest² - h²); a normal leans from the axis by an angle θ whose sine is the spread. So
/// n_a · (b - a) is at most h cos θ + √(farthest² - h²) sin θ, which grows with h up to its largest
/// value, `farthest`.
fn heights(a: &Facet, b: &Facet, farthest: f32) -> [f32; 2] {
    if a.spread >= 1.0 {
        return [-farthest, farthest];
    }
    let cos = (1.0 - a.spread * a.spread).sqrt();
    let highest = |h: f32| {
        if h >= farthest * cos {
            farthest
        } else {
            h * cos + (farthest * farthest - h * h).max(0.0).sqrt() * a.spread
        }
    };
    let [least, most] = along(a, b);
    [-highest(a.slab[1] - least), highest(most - a.slab[0])]
}

/// Bounds of a's axis · (b - a's centre): from the box of b, and from its slab and radius, which are
/// tighter where b is flat and lies askew in its box.
fn along(a: &Facet, b: &Facet) -> [f32; 2] {
    let (low, high) = (a.axis * (b.low - a.centre), a.axis * (b.high - a.centre));
    let centre = a.axis.dot(b.centre - a.centre);
    let cos = a.axis.dot(b.axis);
    let across = a.axis.cross(b.axis).length() * b.radius;
    let slab = b.slab.map(|s| cos * s);
    [
        (low.min(high).element_sum()).max(centre + slab[0].min(slab[1]) - across),
        (low.max(high).element_sum()).min(centre + slab[0].max(slab[1]) + across),
    ]
}
