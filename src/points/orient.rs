//! Which side of the surface is lit.
//!
//! Signs spread from neighbour to neighbour, first where they are surest: a maximal spanning tree (H.
//! Hoppe et al., "Surface reconstruction from unorganized points", 1992), but of patches, between
//! which all neighbours vote. Points with given normals and points that a scanner saw are in the tree
//! from the start. What has neither is turned by what is seen from its sides
//! ([`sides`]).

use std::collections::HashMap;

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
    pub(super) fn viewpoint(&self, cloud: &PointCloud, i: usize) -> Option<DVec3> {
        match *self {
            Facing::Viewpoint(place) => Some(place),
            Facing::Auto => {
                let scan = cloud.scanners.partition_point(|s| s.points.end <= i);
                let scanner = cloud.scanners.get(scan)?;
                scanner.points.contains(&i).then_some(scanner.position)
            }
            _ => None,
        }
    }
}

/// How far points of a plane are off, of its roughness and of the spacing.
const UNSURE: f64 = 0.5;
const TOGETHER: f64 = 0.05;
/// Neighbours that agree as well as this, and whose normals do, are of one patch.
const ONE_PATCH: f64 = 0.95;
/// A scanner says to which side a surface points that it saw at a larger cosine.
const SEEN: f64 = 0.3;
/// Points done between two looks at whether the work should stop.
const BLOCK: usize = 1 << 16;

/// What orientations are told by.
pub(super) struct Told<'a> {
    pub given: &'a [Option<Vec3>],
    pub facing: &'a Facing,
    /// Relative to the same origin as the positions.
    pub lamps: &'a [DVec3],
    /// From where a point was seen.
    pub viewpoint: &'a (dyn Fn(usize) -> Option<DVec3> + Sync),
}

/// Turns the normals of points without a given one, and says how.
pub(super) fn orient(
    positions: &[Vec3],
    local: &mut [Local],
    linked: &[[u32; LINKED]],
    told: &Told,
    progress: &dyn Progress,
) -> Result<String> {
    let n = positions.len();
    progress.stage("orientation", 1);
    let mut patches = relative(positions, local, linked, told, progress)?;
    let found = patches.all();
    let (known, root_flipped) = found[n];
    // Relative to its patch each sign is right now, and in that of the root absolutely.
    for (l, &(patch, flipped)) in local.iter_mut().zip(&found) {
        if flipped != (patch == known && root_flipped) {
            l.flip();
        }
    }
    let patch_of: Vec<u32> = found[..n].iter().map(|f| f.0).collect();
    let free = patch_of.iter().filter(|&&patch| patch != known).count();
    let by_known = match told.facing {
        _ if told.given.iter().any(Option::is_some) => "turned as the given ones",
        Facing::Viewpoint(_) => "turned to the viewpoint",
        _ => "turned to the scanner",
    };
    if free == 0 {
        return Ok(by_known.into());
    }
    let decided = (free < n).then_some(known);
    let by_sides = sides::turn(positions, local, &patch_of, decided, told, progress)?;
    Ok(match decided {
        Some(_) => format!("{by_known}, {free} apart from those {by_sides}"),
        None => by_sides,
    })
}

/// The signs of all points relative to each other, and to what is known: that is point n.
fn relative(
    positions: &[Vec3],
    local: &[Local],
    linked: &[[u32; LINKED]],
    told: &Told,
    progress: &dyn Progress,
) -> Result<Patches> {
    let n = positions.len();
    let root = n as u32;
    let mut patches = Patches::new(n + 1);
    let seen = |i: usize| match told.given[i] {
        Some(_) => Some(1.0),
        None => {
            let way = (told.viewpoint)(i)? - positions[i].as_dvec3();
            Some(way.try_normalize()?.dot(local[i].normal.as_dvec3()))
        }
    };
    for i in 0..n {
        if let Some(cos) = seen(i).filter(|cos| cos.abs() > SEEN) {
            patches.join(i as u32, root, cos < 0.0);
        }
    }
    let linked_to = |i: usize| linked[i].iter().copied().filter(|&j| j != NOBODY);
    for begin in (0..n).step_by(BLOCK) {
        progress.check()?;
        let sure: Vec<(u32, u32, bool)> = (begin..(begin + BLOCK).min(n))
            .into_par_iter()
            .flat_map_iter(|i| {
                linked_to(i).filter_map(move |j| {
                    let sure = agreement(positions, local, i, j as usize);
                    let cos = local[i].normal.dot(local[j as usize].normal);
                    (sure.abs() > ONE_PATCH && f64::from(cos.abs()) > ONE_PATCH).then_some((
                        i as u32,
                        j,
                        sure < 0.0,
                    ))
                })
            })
            .collect();
        for (i, j, opposite) in sure {
            patches.join(i, j, opposite);
        }
    }
    let found = &patches.all();
    let votes = (0..n)
        .into_par_iter()
        .flat_map_iter(|i| {
            let others = linked_to(i).filter(move |&j| found[i].0 != found[j as usize].0);
            others.map(move |j| (i as u32, j, agreement(positions, local, i, j as usize)))
        })
        .chain(
            (0..n)
                .into_par_iter()
                .filter(|&i| found[i].0 != found[n].0)
                .filter_map(|i| Some((i as u32, root, seen(i)?))),
        )
        .collect();
    progress.check()?;
    patches.vote(votes);

    Ok(patches)
}

impl Local {
    pub fn flip(&mut self) {
        self.normal = -self.normal;
        self.height = -self.height;
    }
}

/// How surely the normals of two neighbours point to the same side, from 1 to -1, which is to opposite
/// ones: on a circular arc through both, one normal is the mirror image of the other. The nearer they
/// are, the less noise leaves of the direction between them.
fn agreement(positions: &[Vec3], local: &[Local], i: usize, j: usize) -> f64 {
    let [(p, n, s), (q, m, t)] = [i, j].map(|k| {
        let l = &local[k];
        let normal = l.normal.as_dvec3();
        let on_surface = positions[k].as_dvec3() - normal * f64::from(l.height);
        (
            on_surface,
            normal,
            UNSURE * f64::from(l.rms) + TOGETHER * f64::from(l.spacing),
        )
    });
    let way = q - p;
    let size = way.length_squared() + (0.5 * (s + t)).powi(2);
    n.dot(m) - 2.0 * way.dot(n) * way.dot(m) / size.max(f64::MIN_POSITIVE)
}

/// Points whose signs are known relative to each other.
struct Patches {
    parents: Vec<u32>,
    /// Whether a point has the sign opposite to its parent's.
    opposite: Vec<bool>,
    sizes: Vec<u32>,
}

impl Patches {
    fn new(n: usize) -> Patches {
        Patches {
            parents: (0..n as u32).collect(),
            opposite: vec![false; n],
            sizes: vec![1; n],
        }
    }

    /// The patch of a point, and whether its sign is opposite to that of the patch.
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

    /// Joins the patches of two points whose signs are opposite or the same.
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

    fn all(&mut self) -> Vec<(u32, bool)> {
        (0..self.parents.len() as u32)
            .map(|i| self.find(i))
            .collect()
    }

    /// Joins patches as pairs of their points say, who agree (1) or not (-1): each patch with the one
    /// that has most to say about it, then what came out of that (Borůvka's algorithm, with votes added
    /// up between patches).
    fn vote(&mut self, mut votes: Vec<(u32, u32, f64)>) {
        loop {
            for (i, j, agree) in &mut votes {
                let ((a, flip_a), (b, flip_b)) = (self.find(*i), self.find(*j));
                (*i, *j) = (a.min(b), a.max(b));
                *agree = if flip_a != flip_b { -*agree } else { *agree };
            }
            votes.retain(|&(a, b, _)| a != b);
            votes.par_sort_by_key(|&(a, b, _)| (a, b));
            votes.dedup_by(|next, sum| {
                let same = (next.0, next.1) == (sum.0, sum.1);
                sum.2 += if same { next.2 } else { 0.0 };
                same
            });
            if votes.is_empty() {
                return;
            }
            let mut best: HashMap<u32, usize> = HashMap::new();
            for (k, &(a, b, agree)) in votes.iter().enumerate() {
                for patch in [a, b] {
                    let best = best.entry(patch).or_insert(k);
                    if votes[*best].2.abs() < agree.abs() {
                        *best = k;
                    }
                }
            }
            let mut chosen: Vec<usize> = best.into_values().collect();
            chosen.sort_unstable_by(|&k, &l| {
                let sureness = |k: usize| votes[k].2.abs();
                sureness(l).total_cmp(&sureness(k)).then(k.cmp(&l))
            });
            for k in chosen {
                let (a, b, agree) = votes[k];
                self.join(a, b, agree < 0.0);
            }
        }
    }
}
