//! What a facet's surfels have in common, measured: sums from the leaves up, bounds from all
//! surfels.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::cones::sine;
use super::{Facet, Octree};
use crate::points::Surfels;

/// Surfels that one task looks at.
const BLOCK: usize = 1 << 15;

/// Sums over a facet, weighted by area.
#[derive(Clone, Copy, Default)]
struct Sums {
    area: f64,
    position: DVec3,
    normal: DVec3,
}

/// Bounds relative to centre and axis of a facet.
#[derive(Clone, Copy)]
struct Bounds {
    /// Square of the radius.
    square: f64,
    slab: [f64; 2],
    spread: f64,
}

/// Measures all facets of an octree whose surfels are in its order.
pub(super) fn measure(octree: &mut Octree, surfels: &Surfels) {
    let mut below: Vec<Sums> = Vec::new();
    for level in (0..octree.depth()).rev() {
        let range = octree.level(level);
        let (upper, lower) = octree.facets.split_at_mut(range.end);
        below = upper[range.clone()]
            .par_iter_mut()
            .map(|facet| {
                let children = facet.children();
                match facet.is_leaf() {
                    true => facet.add_surfels(surfels),
                    false => {
                        let at = children.start as usize - range.end;
                        let children = at..at + children.len();
                        facet.add_children(&lower[children.clone()], &below[children])
                    }
                }
            })
            .collect();
    }
    let bound = |facet: &mut Facet| facet.bound(surfels);
    octree.facets.par_iter_mut().for_each(bound);
}

impl Facet {
    /// Sums and boxes over the surfels of a leaf.
    fn add_surfels(&mut self, surfels: &Surfels) -> Sums {
        let mut sums = Sums::default();
        let mut largest = 0.0_f32;
        let mut reach = 0.0_f32;
        (self.low, self.high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for i in self.surfels() {
            let (p, area) = (surfels.positions[i], f64::from(surfels.areas[i]));
            sums.area += area;
            sums.position += p.as_dvec3() * area;
            sums.normal += surfels.normals[i].as_dvec3() * area;
            self.low = self.low.min(p);
            self.high = self.high.max(p);
            largest = largest.max(surfels.areas[i]);
            let corners = surfels.cells.corners[i].iter();
            reach = corners.fold(reach, |reach, c| reach.max(c.length_squared()));
        }
        self.spacing = largest.sqrt();
        self.reach = reach.sqrt();
        self.place(&sums);
        sums
    }

    /// Sums and boxes from those of the children.
    fn add_children(&mut self, children: &[Facet], of_children: &[Sums]) -> Sums {
        let mut sums = Sums::default();
        (self.low, self.high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for (child, s) in children.iter().zip(of_children) {
            sums.area += s.area;
            sums.position += s.position;
            sums.normal += s.normal;
            self.low = self.low.min(child.low);
            self.high = self.high.max(child.high);
            self.spacing = self.spacing.max(child.spacing);
            self.reach = self.reach.max(child.reach);
        }
        self.place(&sums);
        sums
    }

    fn place(&mut self, sums: &Sums) {
        self.area = sums.area as f32;
        self.centre = (sums.position / sums.area).as_vec3();
        // Normals that cancel have no mean: any axis will do, all directions lie around it.
        self.axis = sums.normal.try_normalize().unwrap_or(DVec3::Z).as_vec3();
    }

    /// Radius, slab and spread: bounds for centre and axis as they are stored.
    fn bound(&mut self, surfels: &Surfels) {
        let facet = &*self;
        let blocks = facet.surfels().step_by(BLOCK).collect::<Vec<_>>();
        let over =
            |begin: usize| Bounds::over(facet, surfels, begin..facet.end().min(begin + BLOCK));
        let bounds = match blocks[..] {
            [begin] => over(begin),
            _ => blocks
                .into_par_iter()
                .map(over)
                .reduce(|| Bounds::NONE, Bounds::join),
        };
        self.radius = round_up(bounds.square.sqrt());
        self.slab = [-round_up(-bounds.slab[0]), round_up(bounds.slab[1])];
        self.spread = round_up(bounds.spread);
    }

    fn end(&self) -> usize {
        self.end as usize
    }
}

impl Bounds {
    const NONE: Bounds = Bounds {
        square: 0.0,
        slab: [f64::INFINITY, f64::NEG_INFINITY],
        spread: 0.0,
    };

    fn over(facet: &Facet, surfels: &Surfels, range: std::ops::Range<usize>) -> Bounds {
        let (centre, axis) = (facet.centre.as_dvec3(), facet.axis.as_dvec3());
        let places = surfels.positions[range.clone()].iter();
        let pairs = places.zip(&surfels.normals[range]);
        pairs.fold(Bounds::NONE, |b, (p, n)| {
            let way = p.as_dvec3() - centre;
            let height = axis.dot(way);
            Bounds {
                square: b.square.max(way.length_squared()),
                slab: [b.slab[0].min(height), b.slab[1].max(height)],
                spread: b.spread.max(sine(axis, n.as_dvec3())),
            }
        })
    }

    fn join(self, other: Bounds) -> Bounds {
        Bounds {
            square: self.square.max(other.square),
            slab: [
                self.slab[0].min(other.slab[0]),
                self.slab[1].max(other.slab[1]),
            ],
            spread: self.spread.max(other.spread),
        }
    }
}

/// The least f32 that is not less.
fn round_up(x: f64) -> f32 {
    let nearest = x as f32;
    match f64::from(nearest) < x {
        true => nearest.next_up(),
        false => nearest,
    }
}
