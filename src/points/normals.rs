//! Normals of points that have none.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::PointCloud;
use super::neighbours::{Last, Neighbours, runs};
use super::orient::{self, Facing, Told};
use super::plane::Plane;
use super::rule::median;
use super::select::middle;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scene::LARGEST;

/// Neighbours that a plane is laid through: of a clean cloud, and at most.
const NEIGHBOURS: [usize; 2] = [16, 64];
/// Between the two, for noise as large as the spacing.
const NEIGHBOURS_OF_NOISE: f64 = 100.0;
/// How much more neighbours are taken where they lie on a line.
const ON_A_LINE: usize = 5;
/// Neighbours lie on a line where the variance across is less than this part of that along it.
const LINE: f64 = 0.02;
/// A plane of half the neighbours is taken if its height is less than this part of the whole one's.
/// Noise leaves 1, curvature 0.5.
const SHARPER: f64 = 0.35;
/// Points that the noise is measured on.
const SAMPLE: usize = 20_000;
/// Neighbours of a point in the graph over which orientations spread.
pub(super) const LINKED: usize = 8;
/// Stands for "no neighbour" there.
pub(super) const NOBODY: u32 = u32::MAX;
/// Points that make a plane.
const LEAST_POINTS: usize = 3;
/// Normals point inward or outward as a whole if this part of the ways from the middle goes along them.
const SIDED: f64 = 0.01;
/// Points done between two looks at whether the work should stop.
const BLOCK: usize = 1 << 16;

/// What the surface is at a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local {
    pub normal: Vec3,
    /// Of the point, above the plane of its neighbours.
    pub height: f32,
    /// Root mean square of the neighbours' heights.
    pub rms: f32,
    /// Mean distance of the six nearest neighbours.
    pub spacing: f32,
}

impl PointCloud {
    /// Gives a normal to every point that has none (or one that is zero or not finite), from the planes
    /// of its neighbours.
    ///
    /// Planes are fitted by least squares to so many neighbours as the noise asks for; next to a crease
    /// a point takes the plane of its own side. Points that have normals keep them and tell their
    /// neighbours which side is lit; otherwise `facing` does, and where that leaves it open, `lamps`
    /// inside of the cloud. Where none is missing, all of them are turned if as a whole they point to the
    /// other side than told.
    ///
    /// Fewer than three points make no plane, and get none.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if `progress` asks to stop.
    pub fn estimate_normals(
        &mut self,
        facing: &Facing,
        lamps: &[DVec3],
        progress: &dyn Progress,
    ) -> Result<()> {
        let known = |n: &Vec3| n.is_finite() && *n != Vec3::ZERO;
        self.normals.resize(self.len(), Vec3::ZERO);
        let placed = |p: DVec3| p.abs().cmple(DVec3::splat(LARGEST)).all();
        let missing = (self.positions.iter().zip(&self.normals))
            .filter(|(p, n)| placed(**p) && !known(n))
            .count();
        if missing == 0 {
            self.turn_all(facing, placed);
            return Ok(());
        }
        let usable = |i: usize| placed(self.positions[i]);
        if (0..self.len()).filter(|&i| usable(i)).count() < LEAST_POINTS {
            return Ok(());
        }
        let Some(origin) = middle(self, usable) else {
            return Err(Error::Invalid("no point has finite coordinates".into()));
        };
        let points: Vec<u32> = (0..self.len())
            .filter(|&i| usable(i))
            .map(|i| i as u32)
            .collect();
        let positions: Vec<Vec3> = points
            .iter()
            .map(|&i| (self.positions[i as usize] - origin).as_vec3())
            .collect();
        let given: Vec<Option<Vec3>> = points
            .iter()
            .map(|&i| Some(self.normals[i as usize]).filter(known))
            .map(|n| n.map(|n| n.as_dvec3().normalize().as_vec3()))
            .collect();
        let neighbours = Neighbours::new(&positions)?;
        let count = neighbours_for(&positions, &neighbours);
        let (mut local, linked) = planes(&positions, &given, &neighbours, count, progress)?;
        own_sides(&given, &neighbours, count, &mut local, progress)?;
        let viewpoint = |k: usize| {
            facing
                .viewpoint(self, points[k] as usize)
                .map(|v| v - origin)
        };
        let lamps: Vec<DVec3> = lamps.iter().map(|&lamp| lamp - origin).collect();
        let told = Told {
            given: &given,
            facing,
            lamps: &lamps,
            viewpoint: &viewpoint,
        };
        let told = orient::orient(&positions, &mut local, &linked, &told, progress)?;
        for (&i, local) in points.iter().zip(&local) {
            if !known(&self.normals[i as usize]) {
                self.normals[i as usize] = local.normal;
            }
        }
        self.repairs.push(format!(
            "{missing} points without normals: estimated from {count} neighbours each, {told}"
        ));
        Ok(())
    }

    /// Turns all normals, which are there, if as a whole they do not point inward or outward as told.
    fn turn_all(&mut self, facing: &Facing, placed: impl Fn(DVec3) -> bool) {
        let (outward, told) = match facing {
            Facing::Inward => (false, "inward"),
            Facing::Outward => (true, "outward"),
            _ => return,
        };
        let Some(middle) = middle(self, |i| placed(self.positions[i])) else {
            return;
        };
        let points = self.positions.iter().zip(&self.normals);
        let (flow, most) = points
            .filter(|(p, _)| placed(**p))
            .map(|(p, normal)| (*p - middle, normal.as_dvec3().normalize()))
            .fold((0.0, 0.0), |(flow, most), (way, normal)| {
                (flow + way.dot(normal), most + way.length())
            });
        // Of a plane neither side is the inner one.
        if flow.abs() > SIDED * most && (flow > 0.0) != outward {
            self.normals
                .iter_mut()
                .for_each(|normal| *normal = -*normal);
            let repair = format!("normals of the file: turned {told}, as was asked for");
            self.repairs.push(repair);
        }
    }
}

/// How many neighbours the noise asks for.
fn neighbours_for(positions: &[Vec3], neighbours: &Neighbours) -> usize {
    let [least, most] = NEIGHBOURS;
    let step = positions.len().div_ceil(SAMPLE);
    let noise: Vec<f64> = (0..positions.len())
        .into_par_iter()
        .step_by(step)
        .filter_map(|i| {
            let mut near = Vec::new();
            neighbours.nearest(i, least, &mut near);
            let places: Vec<DVec3> = near.iter().map(|n| n.1).collect();
            let (spacing, plane) = (spacing(&places)?, Plane::robust(&places, &mut Vec::new()));
            Some(plane.rms() / spacing)
        })
        .collect();
    let noise = median(noise).unwrap_or(0.0);
    ((least as f64 + NEIGHBOURS_OF_NOISE * (noise - 0.05)) as usize).clamp(least, most)
}

/// Mean distance of the six nearest.
fn spacing(nearest_first: &[DVec3]) -> Option<f64> {
    let six = &nearest_first[..nearest_first.len().min(6)];
    (!six.is_empty()).then(|| six.iter().map(|p| p.length()).sum::<f64>() / six.len() as f64)
}

/// The plane at each point, and whom it is linked with.
fn planes(
    positions: &[Vec3],
    given: &[Option<Vec3>],
    neighbours: &Neighbours,
    count: usize,
    progress: &dyn Progress,
) -> Result<(Vec<Local>, Vec<[u32; LINKED]>)> {
    let n = positions.len();
    progress.stage("normals", n as u64);
    let (mut local, mut linked) = (Vec::with_capacity(n), Vec::with_capacity(n));
    while local.len() < n {
        progress.check()?;
        let block = local.len()..(local.len() + BLOCK).min(n);
        let made = block.len() as u64;
        let of_run = |(near, places, heights): &mut (_, Vec<DVec3>, _), run: Range<usize>| {
            let mut last = Last::default();
            let of_point = |i: usize| {
                let mut find = |count| {
                    neighbours.next_nearest(i, count, &mut last, near);
                    places.clear();
                    places.extend(near.iter().map(|n| n.1));
                    let linked = |k: usize| near.get(k).map_or(NOBODY, |n| n.0);
                    let linked: [u32; LINKED] = std::array::from_fn(linked);
                    // The point itself belongs to its surface.
                    places.insert(0, DVec3::ZERO);
                    let plane = plane(places, heights);
                    (plane, spacing(&places[1..]).unwrap_or(0.0), linked)
                };
                let (mut plane, spacing, linked) = find(count);
                if plane.variances[1] < LINE * plane.variances[2] {
                    plane = find(ON_A_LINE * count).0;
                }
                let local = Local {
                    normal: given[i].unwrap_or(plane.normal.as_vec3()),
                    height: given[i].map_or(plane.height(DVec3::ZERO) as f32, |_| 0.0),
                    rms: plane.rms() as f32,
                    spacing: spacing as f32,
                };
                (local, linked)
            };
            run.map(of_point).collect::<Vec<_>>()
        };
        let found: Vec<_> = runs(block).map_init(Default::default, of_run).collect();
        for (more_local, more_linked) in found.into_iter().flatten() {
            local.push(more_local);
            linked.push(more_linked);
        }
        progress.advance(made);
    }
    Ok((local, linked))
}

/// The plane of places, nearest first; of the nearer half, if that is much flatter.
fn plane(places: &[DVec3], heights: &mut Vec<f64>) -> Plane {
    let whole = Plane::robust(places, heights);
    let half = places.len() / 2;
    if half < 8 {
        return whole;
    }
    let nearer = Plane::robust(&places[..half], heights);
    match nearer.rms() < SHARPER * whole.rms() && nearer.variances[1] > LINE * nearer.variances[2] {
        true => nearer,
        false => whole,
    }
}

/// Planes rougher than this many medians of all lie across a crease, or something else that is no plane.
const ROUGH: f64 = 1.7;
/// Roughness, in spacings, that is none.
const SMOOTH: f64 = 0.03;
/// Inliers of a plane lie this many of its roughnesses off it, at most.
const INLIER: f64 = 2.5;

/// Next to a crease the plane of a point's neighbours is that of neither side: the point takes the
/// flattest plane among those of its neighbours that goes through it, and what lies on it.
fn own_sides(
    given: &[Option<Vec3>],
    neighbours: &Neighbours,
    count: usize,
    local: &mut [Local],
    progress: &dyn Progress,
) -> Result<()> {
    let step = local.len().div_ceil(SAMPLE);
    let noise = local
        .iter()
        .step_by(step)
        .filter(|l| l.spacing > 0.0)
        .map(|l| f64::from(l.rms / l.spacing))
        .collect();
    let noise = median(noise).unwrap_or(0.0).max(SMOOTH / ROUGH);
    let rough: Vec<usize> = (0..local.len())
        .filter(|&i| given[i].is_none())
        .filter(|&i| f64::from(local[i].rms) > ROUGH * noise * f64::from(local[i].spacing))
        .collect();
    let mut found = Vec::with_capacity(rough.len());
    for block in rough.chunks(BLOCK) {
        progress.check()?;
        found.par_extend(block.par_iter().map_init(Vec::new, |near, &i| {
            neighbours.nearest(i, count, near);
            let own = local[i];
            let miss = |&(j, offset): &(u32, DVec3)| {
                let other = &local[j as usize];
                f64::from(other.height) + other.normal.as_dvec3().dot(-offset)
            };
            let cost = |n: &(u32, DVec3)| {
                let rms = f64::from(local[n.0 as usize].rms);
                rms * rms + 2.0 * miss(n).powi(2)
            };
            // Height of the point above the plane of j: that of j, and the way from j to the point.
            let Some((best, best_cost)) = near
                .iter()
                .map(|n| (n, cost(n)))
                .min_by(|a, b| a.1.total_cmp(&b.1))
            else {
                return own;
            };
            if best_cost > 0.25 * f64::from(own.rms).powi(2) {
                return own;
            }
            let side = local[best.0 as usize];
            let normal = side.normal.as_dvec3();
            let floor = noise * f64::from(own.spacing);
            let gate = INLIER * f64::from(side.rms).max(floor);
            let height = miss(best);
            let on_it = near
                .iter()
                .map(|n| n.1)
                .chain([DVec3::ZERO])
                .filter(|p| (height + normal.dot(*p)).abs() <= gate);
            let plane = Plane::fit(on_it.clone());
            if on_it.count() < 6 || plane.variances[1] < LINE * plane.variances[2] {
                return Local {
                    normal: side.normal,
                    height: height as f32,
                    ..own
                };
            }
            Local {
                normal: plane.normal.as_vec3(),
                height: plane.height(DVec3::ZERO) as f32,
                rms: plane.rms() as f32,
                ..own
            }
        }));
    }
    for (i, found) in rough.into_iter().zip(found) {
        local[i] = found;
    }
    Ok(())
}
