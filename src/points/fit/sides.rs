//! Which side of each surfel is lit, by evidence.
//!
//! Both sides of every piece of surface are asked what they see. What sees each other lies in one space: it is
//! free for both, or solid for both. Where the rays leave the cloud, that is the space around. Told sides and
//! lamps, which hang in free space, say which is which. These are votes on pairs of smooth pieces; the signs
//! that agree with most of them are taken, and a piece that is torn between both gets light on both
//! sides: a plate seen from one side only, whose other side looks into the same room.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};
use rand::RngExt;
use rayon::prelude::*;

use super::patch::Patch;
use super::signs::{Signs, Vote, summed};
use crate::error::Result;
use crate::points::cells::MAX_EDGES;
use crate::points::neighbours::Neighbours;
use crate::points::{Cells, Facing, Surfels};
use crate::progress::Progress;
use crate::random::{Purpose, cosine_direction, stream};
use crate::visibility::{NO_SURFEL, Occluders, Segment, blocked, first_hit};

/// Neighbours of a surfel that tell which way its surface goes on.
const LINKED: usize = 8;
/// Neighbours that agree as well as this, and whose normals do, are of one smooth piece.
const ONE_PIECE: f32 = 0.95;
/// Surfels farther apart than this, in sizes, tell nothing of each other.
const APART: f32 = 2.5;
/// What neighbours of two pieces say counts this part of what rays from both of them do.
const BESIDE: f64 = 0.3;
/// Surfels of a piece from which rays are cast: all of the first few, then of so many.
const FIRST: usize = 8;
const ONE_OF: usize = 6;
/// Rays to each side of each.
const RAYS: usize = 12;
/// Height of a ray's start over its surfel, in sizes.
const ABOVE: f32 = 0.3;
/// Discs of this radius, in sizes, close the surface.
const DISC: f32 = 1.4;
/// Lamps that are asked.
const LAMPS: usize = 16;
/// What is told says as much as this many sides' rays.
const TOLD: f64 = 4.0;
/// A side is sure if the votes for it outweigh those against it by this part of all.
const SURE: f64 = 0.3;
/// A piece of fewer points than this, both sides of which look into the same space, is none: mixed pixels along an
/// edge.
const FEW: u32 = 32;
/// Of a closed surface fewer rays than this leave the inside.
const CLOSED: f64 = 0.08;
/// Outside of a body is what more rays than this leave from; where this part of the area or more has no such side,
/// the cloud is a room with something in it.
const SEEN_OUT: f64 = 0.05;
const UNSEEN: f64 = 0.15;
/// Shares that differ by less do not tell the sides apart.
const ALIKE: f64 = 0.05;
/// A piece is round if this part of it is.
const ALL_OVER: f64 = 0.6;
/// Ground is a surface whose area, seen from above, is more than this part of the whole.
const GROUND: f64 = 0.25;
/// Normals point inward or outward as a whole if this part of the ways from the middle goes along them.
const SIDED: f64 = 0.01;

/// What was found.
pub(super) struct Sides {
    /// Whether a patch's normal is to be turned.
    pub flipped: Vec<bool>,
    /// Whether nothing says which side is the lit one.
    pub unsure: Vec<bool>,
    /// Whether that of a patch is the outside of something round, as nothing else says which.
    pub round: Vec<bool>,
    /// Whether a patch is one of few points that hang in free space: no surface.
    pub hanging: Vec<bool>,
    /// What the sides as a whole were decided by.
    pub how: &'static str,
}

/// What is known beforehand.
pub(super) struct Known<'a> {
    /// Of each patch: from 1, its normal points to the lit side, to -1, it does not; 0 if nothing is told.
    pub told: &'a [f32],
    /// Points of each patch.
    pub points: &'a [u32],
    pub told_by: &'static str,
    pub facing: &'a Facing,
    /// Relative to the origin of the patches.
    pub lamps: &'a [Vec3],
}

/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
pub(super) fn sides(patches: &[Patch], known: &Known, progress: &dyn Progress) -> Result<Sides> {
    progress.stage("sides", 1);
    let (pieces, beside) = pieces(patches)?;
    progress.check()?;
    let views = Views::of(patches, &pieces, known.lamps);
    progress.check()?;
    let truth = pieces.count as u32 + 1;
    let mut votes = views.votes.clone();
    votes.extend_from_slice(&beside);
    let mut told = vec![0.0; pieces.count];
    for (i, &(piece, flip)) in pieces.of.iter().enumerate() {
        let told_here = f64::from(known.told[i]) * area(&patches[i]);
        told[piece as usize] += TOLD * if flip { -told_here } else { told_here };
    }
    votes.extend(
        (0..)
            .zip(told)
            .filter(|t| t.1 != 0.0)
            .map(|(p, t)| (p, truth, t)),
    );
    let mut votes = summed(votes);
    votes.retain(|v| v.0 != v.1);
    let mut signs = decided(pieces.count + 2, &votes);
    let evident = votes.iter().any(|v| v.1 == truth);
    let (turned, how) = whole(patches, &pieces, &views, &signs, known, evident);
    if turned {
        signs.iter_mut().for_each(|s| *s = -*s);
    }
    // What is said for the sign of a piece, of all that is said: by what it sees, and by all.
    let count = |votes: &[Vote]| {
        let mut sums = vec![(0.0, 0.0); pieces.count + 2];
        for &(p, q, vote) in votes {
            let agree = vote * signs[p as usize] * signs[q as usize];
            for k in [p, q] {
                let (sum, whole) = &mut sums[k as usize];
                *sum += agree;
                *whole += vote.abs();
            }
        }
        sums
    };
    let add = |a: (f64, f64), b: (f64, f64)| (a.0 + b.0, a.1 + b.1);
    let [seen, by_all] = [&views.votes, &votes].map(|votes| count(votes));
    let mut points = vec![0; pieces.count];
    for (&(p, _), count) in pieces.of.iter().zip(known.points) {
        points[p as usize] += count;
    }
    let torn = |(sum, whole): (f64, f64)| sum < SURE * whole;
    let outside = outside(patches, &pieces);
    let mut round = vec![false; pieces.count];
    for p in 0..pieces.count {
        if outside[p] != 0.0 && torn(add(by_all[p], views.own[p])) {
            (signs[p], round[p]) = (outside[p], true);
        }
    }
    let flipped = pieces
        .of
        .iter()
        .map(|&(p, flip)| flip != (signs[p as usize] < 0.0));
    let unsure = |p: usize| !round[p] && torn(add(by_all[p], views.own[p]));
    let hanging =
        |p: usize| outside[p] == 0.0 && torn(add(seen[p], views.own[p])) && points[p] < FEW;
    let of_pieces = |is: &dyn Fn(usize) -> bool| -> Vec<bool> {
        let of: Vec<bool> = (0..pieces.count).map(is).collect();
        pieces.of.iter().map(|&(p, _)| of[p as usize]).collect()
    };
    Ok(Sides {
        flipped: flipped.collect(),
        unsure: of_pieces(&unsure),
        round: of_pieces(&|p| round[p]),
        hanging: of_pieces(&hanging),
        how,
    })
}

/// Of each piece that is of thin cylinders: the sign of its normals with which they point outward, the side from which
/// alone pipes, posts and rails are seen. 0 of the others.
fn outside(patches: &[Patch], pieces: &Pieces) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); pieces.count];
    for (patch, &(p, flip)) in patches.iter().zip(&pieces.of) {
        let (sum, whole) = &mut sums[p as usize];
        *whole += area(patch);
        if let Some(outward) = patch.points_outward() {
            *sum += if outward != flip {
                area(patch)
            } else {
                -area(patch)
            };
        }
    }
    let of = |(sum, whole): (f64, f64)| match sum.abs() > ALL_OVER * whole {
        true => sum.signum(),
        false => 0.0,
    };
    sums.into_iter().map(of).collect()
}

fn area(patch: &Patch) -> f64 {
    f64::from(patch.size * patch.size)
}

/// Smooth pieces of surface, within which signs are known.
struct Pieces {
    count: usize,
    /// For each patch its piece, and whether its normal is opposite to that of the piece.
    of: Vec<(u32, bool)>,
    members: Vec<Vec<u32>>,
}

/// The pieces, and what neighbours in two of them say.
fn pieces(patches: &[Patch]) -> Result<(Pieces, Vec<Vote>)> {
    let places: Vec<Vec3> = patches.iter().map(|p| p.position).collect();
    let neighbours = Neighbours::new(&places)?;
    let pairs: Vec<(u32, u32, f32, bool)> = (0..patches.len())
        .into_par_iter()
        .flat_map_iter(|i| {
            let mut near = Vec::new();
            neighbours.nearest(i, LINKED, &mut near);
            let own = patches[i];
            near.into_iter().filter_map(move |(j, way)| {
                let (other, way) = (patches[j as usize], way.as_vec3());
                let reach = 0.5 * APART * (own.size + other.size);
                let agree = agreement(&own, &other, way);
                let flat =
                    way.dot(own.normal).abs().max(way.dot(other.normal).abs()) < 0.3 * way.length();
                let smooth = own.normal.dot(other.normal).abs() > ONE_PIECE && flat
                    || own.is_round_with(&other);
                (way.length() < reach).then_some((i as u32, j, agree, smooth))
            })
        })
        .collect();
    let mut signs = Signs::new(patches.len());
    for &(i, j, agree, smooth) in &pairs {
        if smooth && agree.abs() > ONE_PIECE {
            signs.join(i, j, agree < 0.0);
        }
    }
    let mut number = vec![u32::MAX; patches.len()];
    let mut members: Vec<Vec<u32>> = Vec::new();
    let of = (0..).zip(signs.all()).map(|(i, (group, flip))| {
        let number = &mut number[group as usize];
        if *number == u32::MAX {
            *number = members.len() as u32;
            members.push(Vec::new());
        }
        members[*number as usize].push(i);
        (*number, flip)
    });
    let of: Vec<(u32, bool)> = of.collect();
    let beside = pairs.iter().filter_map(|&(i, j, agree, _)| {
        let [(p, flip_p), (q, flip_q)] = [i, j].map(|k| of[k as usize]);
        let [a, b] = [i, j].map(|k| area(&patches[k as usize]));
        let vote = BESIDE * f64::from(agree) * a.min(b) / LINKED as f64;
        let vote = if flip_p != flip_q { -vote } else { vote };
        (p != q).then_some((p.min(q), p.max(q), vote))
    });
    let beside = summed(beside.collect());
    let pieces = Pieces {
        count: members.len(),
        of,
        members,
    };
    Ok((pieces, beside))
}

/// How surely the normals of two neighbours point to the same side, from 1 to -1, which is to opposite
/// ones: on a circular arc through both, one normal is the mirror image of the other. The nearer they
/// are, the less noise leaves of the direction between them.
fn agreement(own: &Patch, other: &Patch, way: Vec3) -> f32 {
    let noise = own.noise + other.noise;
    let size = (way.length_squared() + noise * noise).max(f32::MIN_POSITIVE);
    own.normal.dot(other.normal) - 2.0 * way.dot(own.normal) * way.dot(other.normal) / size
}

/// What is seen from both sides of the pieces.
struct Views {
    /// Votes on pairs of pieces, and on pieces with the space around.
    votes: Vec<Vote>,
    /// Votes of a piece on itself: for its being one, and all.
    own: Vec<(f64, f64)>,
    /// Which side lamps shine on.
    lit: Vec<f64>,
    /// Of each piece the shares of rays that leave the cloud: on the side of its normals, and on the other.
    leave: Vec<[f64; 2]>,
}

impl Views {
    fn of(patches: &[Patch], pieces: &Pieces, lamps: &[Vec3]) -> Views {
        let surfels = discs(patches);
        let occluders = Occluders::build(&surfels);
        let reach = surfels.reach();
        let lamps = &lamps[..lamps.len().min(LAMPS)];
        let around = pieces.count as u32;
        let of_piece = |p: usize| {
            let members = &pieces.members[p];
            let whole: f64 = members.iter().map(|&i| area(&patches[i as usize])).sum();
            let count = members.len().min(FIRST + members.len() / ONE_OF);
            let weight = whole / count as f64;
            let (mut votes, mut own, mut lit, mut leave) = (Vec::new(), (0.0, 0.0), 0.0, [0.0; 2]);
            for k in 0..count {
                let i = members[k * members.len() / count] as usize;
                let patch = &patches[i];
                let mut random = stream(0, Purpose::Sides, u64::from(patch.sample));
                // On the side of the piece's normals first.
                let normal = if pieces.of[i].1 {
                    -patch.normal
                } else {
                    patch.normal
                };
                let tangent = surfels.cells.tangents[i];
                for (side, sign) in [1.0_f32, -1.0].into_iter().enumerate() {
                    let from = patch.position + sign * ABOVE * patch.size * normal;
                    let segment = |to: Vec3| Segment {
                        from: from.to_array(),
                        skip_from: i as u32,
                        to: to.to_array(),
                        skip_to: NO_SURFEL,
                    };
                    for _ in 0..RAYS {
                        let way = cosine_direction(
                            sign * normal,
                            tangent,
                            random.random(),
                            random.random(),
                        );
                        let hit = first_hit::<f32>(&occluders, &segment(from + reach * way));
                        let vote = f64::from(sign) * weight / RAYS as f64;
                        let Some(hit) = hit else {
                            leave[side] += 1.0 / (RAYS * count) as f64;
                            votes.push((p as u32, around, vote));
                            continue;
                        };
                        let (q, flip) = pieces.of[hit.surfel as usize];
                        let vote = if hit.front == flip { -vote } else { vote };
                        match q as usize == p {
                            true => own = (own.0 + vote, own.1 + vote.abs()),
                            false => votes.push((q.min(p as u32), q.max(p as u32), vote)),
                        }
                    }
                    for &lamp in lamps {
                        let faces = (lamp - from).dot(sign * normal) > 0.0;
                        if faces && !blocked::<f32>(&occluders, &segment(lamp)) {
                            lit += f64::from(sign) * weight / lamps.len() as f64;
                        }
                    }
                }
            }
            (summed(votes), own, lit, leave)
        };
        let found: Vec<_> = (0..pieces.count).into_par_iter().map(of_piece).collect();
        let mut views = Views {
            votes: Vec::new(),
            own: Vec::new(),
            lit: Vec::new(),
            leave: Vec::new(),
        };
        for (votes, own, lit, leave) in found {
            views.votes.extend(votes);
            views.own.push(own);
            views.lit.push(lit);
            views.leave.push(leave);
        }
        views
    }
}

/// The patches as discs that block light.
fn discs(patches: &[Patch]) -> Surfels {
    let corners = |p: &Patch| {
        let corner = |k: usize| Vec2::from_angle(TAU * k as f32 / MAX_EDGES as f32) * DISC * p.size;
        std::array::from_fn(corner)
    };
    let n = patches.len();
    Surfels {
        positions: patches.iter().map(|p| p.position).collect(),
        normals: patches.iter().map(|p| p.normal).collect(),
        areas: patches.iter().map(|p| p.size * p.size).collect(),
        cells: Cells {
            tangents: patches
                .iter()
                .map(|p| p.normal.any_orthonormal_vector())
                .collect(),
            corners: patches.iter().map(corners).collect(),
        },
        offsets: vec![0.0; n],
        depths: vec![0.0; n],
        occluder_scale: 1.0,
        ..Surfels::default()
    }
}

/// Signs that agree with most votes: joined from the surest on, then turned one by one while that helps.
fn decided(n: usize, votes: &[Vote]) -> Vec<f64> {
    let mut joined = Signs::new(n);
    joined.vote(votes.to_vec());
    let sign = |(_, flip): (u32, bool)| if flip { -1.0 } else { 1.0 };
    let mut signs: Vec<f64> = joined.all().into_iter().map(sign).collect();
    let mut of = vec![Vec::new(); n];
    for &(p, q, vote) in votes {
        of[p as usize].push((q as usize, vote));
        of[q as usize].push((p as usize, vote));
    }
    for _ in 0..100 {
        let mut still = true;
        for p in 0..n {
            let field: f64 = of[p].iter().map(|&(q, vote)| vote * signs[q]).sum();
            if field * signs[p] < 0.0 {
                signs[p] = -signs[p];
                still = false;
            }
        }
        if still {
            break;
        }
    }
    signs
}

/// Whether the sides as a whole are to be turned, and what says so.
fn whole(
    patches: &[Patch],
    pieces: &Pieces,
    views: &Views,
    signs: &[f64],
    known: &Known,
    evident: bool,
) -> (bool, &'static str) {
    let (mut middle, mut all) = (glam::DVec3::ZERO, 0.0);
    for patch in patches {
        middle += area(patch) * patch.position.as_dvec3();
        all += area(patch);
    }
    middle /= all;
    let (mut flow, mut most, mut up) = (0.0, 0.0, 0.0);
    let (mut leave, mut enclosed) = ([0.0; 2], [0.0; 2]);
    for (patch, &(p, flip)) in patches.iter().zip(&pieces.of) {
        let sign = signs[p as usize] * if flip { -1.0 } else { 1.0 };
        let normal = sign * area(patch) * patch.normal.as_dvec3();
        let way = patch.position.as_dvec3() - middle;
        flow += normal.dot(way);
        most += area(patch) * way.length();
        up += normal.z;
        let of_piece = views.leave[p as usize];
        let of_sides = if signs[p as usize] < 0.0 {
            [of_piece[1], of_piece[0]]
        } else {
            of_piece
        };
        for side in 0..2 {
            leave[side] += area(patch) / all * of_sides[side];
            enclosed[side] += area(patch) / all * f64::from(u8::from(of_sides[side] < SEEN_OUT));
        }
    }
    let sided = flow.abs() > SIDED * most;
    match known.facing {
        Facing::Inward if sided => return (flow > 0.0, "turned inward, as told"),
        Facing::Outward if sided => return (flow < 0.0, "turned outward, as told"),
        _ => {}
    }
    if evident {
        let by = known.told_by;
        return (signs[pieces.count + 1] < 0.0, by);
    }
    // Lamps hang in free space.
    let lit: f64 = views
        .lit
        .iter()
        .zip(signs)
        .map(|(lit, sign)| lit * sign)
        .sum();
    if lit != 0.0 {
        return (lit < 0.0, "turned to the lamps");
    }
    let [front, back] = leave;
    if (front - back).abs() < ALIKE && up.abs() > GROUND * all {
        return (
            up < 0.0,
            "turned up (--normals viewpoint:X,Y,Z tells where it was seen from)",
        );
    }
    let out = usize::from(back > front);
    match front.min(back) < CLOSED {
        true if enclosed[out] > UNSEEN => (
            front > back,
            "turned inward as in a room (--normals outward turns them)",
        ),
        true => (
            front < back,
            "turned outward as on a closed body (--normals inward turns them)",
        ),
        false => (
            front > back,
            "turned to the hollow side (--normals viewpoint:X,Y,Z tells where it was seen from)",
        ),
    }
}
