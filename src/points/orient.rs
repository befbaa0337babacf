//! Which side of the surface is lit.
//!
//! Signs spread from neighbour to neighbour, first where they are surest (H. Hoppe et al., "Surface
//! reconstruction from unorganized points", 1992): a maximal spanning tree. Points with given normals
//! and points that a scanner saw are part of the tree from the start. Whole parts that have neither
//! are turned by what is seen from their sides ([`sides`](super::sides)).

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::PointCloud;
use super::normals::{LINKED, Local, NOBODY};
use super::sides;
use crate::error::Result;
use crate::progress::Progress;

/// To which side estimated normals point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Facing {
    /// To the scanner, where the cloud knows where that was; otherwise to the side from which the
    /// surface can have been seen.
    #[default]
    Auto,
    /// Into the cloud: a room, a cave.
    Inward,
    /// Out of the cloud: an object.
    Outward,
    /// To the place, in the scan's coordinates, from which all was seen.
    Viewpoint(DVec3),
}

impl Facing {
    /// From where point `i` of the cloud was seen, if that is known.
    pub(super) fn viewpoint(&self, _cloud: &PointCloud, _i: usize) -> Option<DVec3> {
        match *self {
            Facing::Viewpoint(place) => Some(place),
            _ => None,
        }
    }
}

/// Levels of sureness that are told apart.
const LEVELS: usize = 1024;
/// Neighbours nearer than this part of the spacing have no direction between them.
const TOGETHER: f64 = 0.1;

/// Turns the normals of points without a given one, and says how.
pub(super) fn orient(
    positions: &[Vec3],
    given: &[Option<Vec3>],
    local: &mut [Local],
    linked: &[[u32; LINKED]],
    facing: &Facing,
    viewpoint: &(dyn Fn(usize) -> Option<DVec3> + Sync),
    progress: &dyn Progress,
) -> Result<String> {
    let n = positions.len();
    progress.stage("orientation", 1);
    let seen = |i: usize| {
        let to = (viewpoint(i)? - positions[i].as_dvec3()).try_normalize()?;
        Some(to.dot(local[i].normal.as_dvec3()))
    };
    let root = n as u32;
    let edges = Edges::sorted(n, &|i| {
        // What is known of the point itself, then its neighbours.
        let own = given[i].map(|_| 1.0).or_else(|| seen(i));
        let others = linked[i].map(|j| {
            let twice = j < i as u32 && linked[j as usize].contains(&(i as u32));
            (j != NOBODY && !twice).then(|| agreement(positions, local, i, j as usize))
        });
        std::array::from_fn(|k| match k {
            0 => own,
            k => others[k - 1],
        })
    });
    progress.check()?;
    let mut parts = Parts::new(n + 1);
    for (i, slot, sign) in edges.iter() {
        let other = match slot {
            0 => root,
            k => linked[i as usize][k - 1],
        };
        parts.join(i, other, sign);
    }
    let found: Vec<(u32, bool)> = (0..=root).map(|i| parts.find(i)).collect();
    let (known, root_flipped) = found[n];
    // The tree's own sign first; then the points that hang on the root are right.
    for (l, &(part, flipped)) in local.iter_mut().zip(&found) {
        if flipped != (part == known && root_flipped) {
            l.flip();
        }
    }
    let part_of: Vec<u32> = found[..n].iter().map(|f| f.0).collect();
    let free = part_of.iter().filter(|&&part| part != known).count();
    let by_known = match facing {
        Facing::Viewpoint(_) => "turned to the viewpoint",
        _ if given.iter().any(Option::is_some) => "turned as the given ones",
        _ => "turned to the scanner",
    };
    if free == 0 {
        return Ok(by_known.into());
    }
    let decided = (free < n).then_some(known);
    let told = sides::turn(positions, local, &part_of, decided, facing, progress)?;
    Ok(match decided {
        Some(_) => format!("{by_known}, {free} without connection to them {told}"),
        None => told,
    })
}

impl Local {
    pub fn flip(&mut self) {
        self.normal = -self.normal;
        self.height = -self.height;
    }
}

/// How surely the normals of two neighbours point to the same side, from 1 to -1, which is to opposite
/// ones: on a circular arc through both, one normal is the mirror image of the other.
fn agreement(positions: &[Vec3], local: &[Local], i: usize, j: usize) -> f64 {
    let [(p, n, s), (q, m, t)] = [i, j].map(|k| {
        let l = &local[k];
        let normal = l.normal.as_dvec3();
        let on_surface = positions[k].as_dvec3() - normal * f64::from(l.height);
        (on_surface, normal, f64::from(l.spacing))
    });
    let between = q - p;
    let cos = n.dot(m);
    if between.length() <= TOGETHER * s.min(t) {
        return cos;
    }
    let way = between.normalize();
    cos - 2.0 * way.dot(n) * way.dot(m)
}

/// Edges of the graph, the surest first.
struct Edges {
    /// Point and slot in one number; the last bit is set where the two signs are opposite.
    packed: Vec<u64>,
}

/// What is known of a point itself, and its neighbours.
const SLOTS: usize = 1 + LINKED;

impl Edges {
    fn sorted(
        n: usize,
        sureness: &(dyn Fn(usize) -> [Option<f64>; SLOTS] + Sync),
    ) -> Edges {
        let mut packed: Vec<u64> = (0..n)
            .into_par_iter()
            .flat_map_iter(|i| {
                let slots = sureness(i).into_iter().enumerate();
                slots.filter_map(move |(slot, sure)| {
                    let sure = sure?;
                    let level = ((1.0 - sure.abs()).max(0.0) * LEVELS as f64) as u64;
                    let edge = (i * SLOTS + slot) as u64;
                    Some(level << 48 | edge << 1 | u64::from(sure < 0.0))
                })
            })
            .collect();
        packed.par_sort_unstable();
        Edges { packed }
    }

    /// Point, slot, and whether the signs are opposite.
    fn iter(&self) -> impl Iterator<Item = (u32, usize, bool)> {
        self.packed.iter().map(|&packed| {
            let edge = (packed << 16 >> 17) as usize;
            ((edge / SLOTS) as u32, edge % SLOTS, packed & 1 == 1)
        })
    }
}

/// Parts of the graph that hang together, with the sign of each point relative to its part.
struct Parts {
    parents: Vec<u32>,
    /// Whether a point has the sign opposite to its parent's.
    opposite: Vec<bool>,
    sizes: Vec<u32>,
}

impl Parts {
    fn new(n: usize) -> Parts {
        Parts {
            parents: (0..n as u32).collect(),
            opposite: vec![false; n],
            sizes: vec![1; n],
        }
    }

    /// The part of a point, and whether its sign is opposite to that of the part.
    fn find(&mut self, mut i: u32) -> (u32, bool) {
        let mut opposite = false;
        loop {
            let parent = self.parents[i as usize];
            if parent == i {
                return (i, opposite);
            }
            // Halves the way.
            let above = self.parents[parent as usize];
            let signs = [i, parent].map(|k| self.opposite[k as usize]);
            if above != parent {
                self.parents[i as usize] = above;
                self.opposite[i as usize] = signs[0] != signs[1];
                opposite ^= signs[0] != signs[1];
                i = above;
            } else {
                return (parent, opposite ^ signs[0]);
            }
        }
    }

    /// Joins the parts of two points whose signs are opposite or the same.
    fn join(&mut self, i: u32, j: u32, opposite: bool) {
        let ((a, flip_a), (b, flip_b)) = (self.find(i), self.find(j));
        if a == b {
            return;
        }
        let (large, small) = match self.sizes[a as usize] >= self.sizes[b as usize] {
            true => (a, b),
            false => (b, a),
        };
        self.parents[small as usize] = large;
        self.opposite[small as usize] = opposite ^ flip_a ^ flip_b;
        self.sizes[large as usize] += self.sizes[small as usize];
    }
}
