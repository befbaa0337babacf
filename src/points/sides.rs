//! Which side of a surface faces the air, by what is seen from its two sides.

use std::collections::{BTreeMap, HashMap};
use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rand::RngExt;
use rayon::prelude::*;

use super::normals::Local;
use super::orient::{Facing, Told};
use super::rule::median;
use super::thin::spread_to;
use super::{PointCloud, Surfels};
use crate::error::Result;
use crate::progress::{Progress, Silent};
use crate::random::{Purpose, cosine_direction, stream};
use crate::visibility::{NO_SURFEL, Occluders, Segment, first_hit};

/// Points that stand for the whole surface, at most, and those that they are chosen from.
const COARSE: usize = 30_000;
const CHOSEN_FROM: usize = 200_000;
/// Points of the largest part, and of every other one, from which rays are cast.
const FROM_LARGEST: usize = 1500;
const FROM_OTHERS: usize = 16;
/// Rays to each side of each of them.
const RAYS: u64 = 16;
/// The outside of an object is seen from outside; where more than this part of it is not, the cloud is a
/// room with something in it.
const UNSEEN: f64 = 0.15;
/// Winding number about a lamp from which on it shines into the surface.
const INSIDE: f64 = 0.35;
/// Ground is a surface whose area, seen from above, is more than this part of the whole.
const GROUND: f64 = 0.25;
/// No point stands for more than the square of this many medians of the spacing: strays would outweigh
/// the surface.
const WIDEST: f64 = 5.0;
/// Shares that differ by less do not tell the sides apart.
const ALIKE: f64 = 0.05;

/// What rays from a part's two sides meet: [on the normal's side, on the other].
#[derive(Clone, Default)]
struct Views {
    points: usize,
    /// Rays that leave the cloud.
    escaped: [usize; 2],
    /// Points from which few do.
    enclosed: [usize; 2],
    /// Hits by part and whether they are on the side of its normals.
    hits: [BTreeMap<(u32, bool), usize>; 2],
}

/// Turns the parts of the surface, but for the one that is `decided`, to the side that faces the air;
/// says how.
pub(super) fn turn(
    positions: &[Vec3],
    local: &mut [Local],
    part_of: &[u32],
    decided: Option<u32>,
    told: &Told,
    progress: &dyn Progress,
) -> Result<String> {
    let views = views(positions, local, part_of, progress)?;
    let mut parts: Vec<(u32, usize)> = sizes(part_of).into_iter().collect();
    // What is decided first, then from the largest on.
    parts.sort_by_key(|&(part, size)| (Some(part) != decided, usize::MAX - size, part));
    let mut outward = false;
    let mut how = "turned to where they can have been seen from";
    let mut flipped: HashMap<u32, bool> = HashMap::with_capacity(parts.len());
    let seen_by = seen_by(&views);
    for &(part, _) in &parts {
        let view = &views[&part];
        let flip = if Some(part) == decided {
            false
        } else if flipped.is_empty() {
            let points = (0..positions.len()).filter(|&i| part_of[i] == part);
            let side;
            (side, outward, how) = of_largest(view, points, positions, local, told);
            side
        } else {
            of_other(part, view, &seen_by[&part], &flipped, outward)
        };
        flipped.insert(part, flip);
    }
    for (l, part) in local.iter_mut().zip(part_of) {
        if flipped[part] {
            l.flip();
        }
    }
    Ok(how.into())
}

fn sizes(part_of: &[u32]) -> BTreeMap<u32, usize> {
    let mut sizes = BTreeMap::new();
    for &part in part_of {
        *sizes.entry(part).or_default() += 1;
    }
    sizes
}

/// Whether the largest part is to be flipped, whether its normals then point outwards, and that in words.
fn of_largest(
    view: &Views,
    points: impl Iterator<Item = usize> + Clone,
    positions: &[Vec3],
    local: &[Local],
    told: &Told,
) -> (bool, bool, &'static str) {
    let place = |i: usize| positions[i].as_dvec3();
    let (sum, count) = points
        .clone()
        .fold((DVec3::ZERO, 0.0), |(s, c), i| (s + place(i), c + 1.0));
    let middle = sum / count;
    let (mut flow, mut up, mut area) = (0.0, 0.0, 0.0);
    let mut around = vec![0.0; told.lamps.len()];
    let usual = median(
        points
            .clone()
            .map(|i| f64::from(local[i].spacing))
            .collect(),
    );
    let widest = WIDEST * usual.unwrap_or(0.0);
    for i in points {
        let size = f64::from(local[i].spacing).min(widest).powi(2);
        let normal = local[i].normal.as_dvec3() * size;
        flow += normal.dot(place(i) - middle);
        up += normal.z;
        area += size;
        for (lamp, around) in told.lamps.iter().zip(&mut around) {
            let way = *lamp - place(i);
            *around += normal.dot(way) / (4.0 * PI * way.length().powi(3).max(size.powf(1.5)));
        }
    }
    const INWARD: &str = "turned inward as in a room (--normals outward turns them)";
    const OUTWARD: &str = "turned outward as on an object (--normals inward turns them)";
    match told.facing {
        Facing::Inward => return (flow > 0.0, false, "turned inward"),
        Facing::Outward => return (flow < 0.0, true, "turned outward"),
        _ => {}
    }
    // The winding number of the surface about a lamp: 1 or -1 inside of a closed one.
    let lamp = around
        .into_iter()
        .max_by(|a: &f64, b| a.abs().total_cmp(&b.abs()));
    if let Some(winding) = lamp.filter(|w| w.abs() > INSIDE) {
        return (winding < 0.0, false, "turned to the lamps");
    }
    let share = |counts: [usize; 2], of: usize| counts.map(|n| n as f64 / of.max(1) as f64);
    let unseen = share(view.enclosed, view.points);
    let escaped = share(view.escaped, view.points * RAYS as usize);
    if (unseen[0] - unseen[1]).abs() > ALIKE {
        // The side that is seen from outside is the lit one, if all of it is seen.
        let out = usize::from(unseen[1] < unseen[0]);
        let outward = unseen[out] <= UNSEEN;
        return (
            (out == 1) == outward,
            outward,
            if outward { OUTWARD } else { INWARD },
        );
    }
    // An open surface: ground, or what a scanner saw around it.
    let how = match up.abs() > GROUND * area {
        true => "turned up (--normals viewpoint:X,Y,Z tells where it was seen from)",
        false => {
            "turned to the hollow side (--normals viewpoint:X,Y,Z tells where it was seen from)"
        }
    };
    let flip = match up.abs() > GROUND * area {
        true => up < 0.0,
        false => escaped[0] > escaped[1],
    };
    (flip, false, how)
}

/// Rays from one side of a part that meet another one.
struct Sight {
    by: u32,
    side: usize,
    front: bool,
    count: usize,
}

/// By whom each part is seen.
fn seen_by(views: &BTreeMap<u32, Views>) -> HashMap<u32, Vec<Sight>> {
    let mut seen_by: HashMap<u32, Vec<Sight>> =
        views.keys().map(|&part| (part, Vec::new())).collect();
    for (&by, view) in views {
        for (side, hits) in view.hits.iter().enumerate() {
            for (&(part, front), &count) in hits {
                seen_by.entry(part).or_default().push(Sight {
                    by,
                    side,
                    front,
                    count,
                });
            }
        }
    }
    seen_by
}

/// Whether another part is to be flipped: it should see fronts, and fronts should see its front.
fn of_other(
    part: u32,
    view: &Views,
    seen_by: &[Sight],
    flipped: &HashMap<u32, bool>,
    outward: bool,
) -> bool {
    let score = |side: usize| {
        let own = side == 1;
        let mut score = match outward {
            true => view.escaped[side] as f64,
            false => 0.0,
        };
        for (&(other, front), &count) in &view.hits[side] {
            let flip = if other == part {
                Some(&own)
            } else {
                flipped.get(&other)
            };
            if let Some(&flip) = flip {
                score += if front != flip {
                    count as f64
                } else {
                    -(count as f64)
                };
            }
        }
        // Of the many rays of a large part few meet a small one, but those count.
        for sight in seen_by {
            if flipped
                .get(&sight.by)
                .is_some_and(|&flip| sight.side == usize::from(flip))
            {
                let count = sight.count as f64;
                score += if sight.front != own { count } else { -count };
            }
        }
        score
    };
    score(1) > score(0)
}

/// What is seen from a sample of each part's points, of the surface in few points.
fn views(
    positions: &[Vec3],
    local: &[Local],
    part_of: &[u32],
    progress: &dyn Progress,
) -> Result<BTreeMap<u32, Views>> {
    let few = positions.len().div_ceil(CHOSEN_FROM);
    let some: Vec<usize> = (0..positions.len()).step_by(few).collect();
    let pick = |of: &dyn Fn(usize) -> Vec3| some.iter().map(|&i| of(i)).collect::<Vec<Vec3>>();
    let (places, normals) = (pick(&|i| positions[i]), pick(&|i| local[i].normal));
    let keepers = spread_to(&places, &normals, COARSE, progress)?;
    let kept: Vec<usize> = (0..some.len())
        .filter(|&k| keepers[k] as usize == k)
        .collect();
    progress.check()?;
    let coarse = PointCloud {
        positions: kept.iter().map(|&k| places[k].as_dvec3()).collect(),
        normals: kept.iter().map(|&k| normals[k]).collect(),
        reflectance: vec![Vec3::ZERO; kept.len()],
        emission: vec![Vec3::ZERO; kept.len()],
        ..PointCloud::default()
    };
    let coarse = Surfels::prepare(&coarse, &Silent)?.surfels;
    let occluders = Occluders::build(&coarse);
    let origin = coarse.origin.as_vec3();
    // As wide as cells where points are sparse.
    let mut areas = coarse.areas.clone();
    let wide = areas.len() * 4 / 5;
    let spacing = areas.select_nth_unstable_by(wide, f32::total_cmp).1.sqrt();
    let reach = coarse.reach() + 2.0 * spacing;
    let part_of_surfel = |s: u32| part_of[some[kept[coarse.points[s as usize] as usize]]];

    let sizes = sizes(part_of);
    let largest = sizes.values().max().copied().unwrap_or(0);
    let mut passed: HashMap<u32, usize> = HashMap::with_capacity(sizes.len());
    let from: Vec<usize> = (0..positions.len())
        .filter(|&i| {
            let size = sizes[&part_of[i]];
            let wanted = if size == largest {
                FROM_LARGEST
            } else {
                FROM_OTHERS
            };
            let passed = passed.entry(part_of[i]).or_default();
            *passed += 1;
            (*passed - 1).is_multiple_of(size.div_ceil(wanted))
        })
        .collect();
    // What one ray meets: part and front, or nothing.
    type Met = Option<(u32, bool)>;
    let seen: Vec<[Vec<Met>; 2]> = from
        .par_iter()
        .map(|&i| {
            let mut random = stream(0, Purpose::Sides, i as u64);
            [1.0, -1.0].map(|side| {
                let normal = local[i].normal * side;
                let tangent = normal.any_orthonormal_vector();
                let mut ray = || {
                    let way = cosine_direction(normal, tangent, random.random(), random.random());
                    let start = positions[i] - origin + (way + 0.3 * normal) * spacing;
                    let segment = Segment {
                        from: start.to_array(),
                        skip_from: NO_SURFEL,
                        to: (start + way * reach).to_array(),
                        skip_to: NO_SURFEL,
                    };
                    first_hit::<f32>(&occluders, &segment)
                        .map(|hit| (part_of_surfel(hit.surfel), hit.front))
                };
                (0..RAYS).map(|_| ray()).collect()
            })
        })
        .collect();
    let mut views: BTreeMap<u32, Views> = BTreeMap::new();
    for (&i, sides) in from.iter().zip(&seen) {
        let view = views.entry(part_of[i]).or_default();
        view.points += 1;
        for (side, met) in sides.iter().enumerate() {
            let escaped = met.iter().filter(|m| m.is_none()).count();
            view.escaped[side] += escaped;
            view.enclosed[side] += usize::from(escaped as u64 <= RAYS / 4);
            for &hit in met.iter().flatten() {
                *view.hits[side].entry(hit).or_default() += 1;
            }
        }
    }
    Ok(views)
}
