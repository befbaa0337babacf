//! The surface behind the points of a scan: surfels that are fitted to them.
//!
//! 1. [`samples`]: the usable points, with spacing and noise around each.
//! 2. [`cover`]: surfels on an even spacing, each on the plane of most of the points around it.
//! 3. [`owners`]: for each point the surfel that it is a measurement of, if any; their colours.
//! 4. [`sides`]: which side of each surfel is lit; both, where nothing says which.

mod cover;
mod curved;
mod owners;
mod patch;
mod plane;
mod round;
mod samples;
mod sides;
mod signs;

use glam::{DVec3, Vec3};

use super::neighbours::Neighbours;
use super::{Facing, PointCloud, Surfels};
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::visibility::NO_SURFEL;
pub(super) use owners::Extents;
use owners::Owners;
use patch::Patch;
use plane::PLAIN;
use samples::{Samples, Scale};
use sides::Known;

/// What tells which side of a surface is lit, beside what the cloud itself knows.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    pub facing: Facing,
    /// Lamps, in the scan's coordinates: they hang in free space.
    pub lamps: Vec<DVec3>,
    /// Points that the surface is fitted to, if not all: how far two such surfaces differ tells how sure one is.
    pub half: Option<Half>,
}

/// One of two disjoint parts of the points, each spread as all are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    First,
    Second,
}

/// A fitted surface.
pub(super) struct Fitted {
    /// Without cells and areas.
    pub surfels: Surfels,
    /// Of each surfel: no other one of its surface is nearer.
    pub sizes: Vec<f32>,
    /// How far their points reach, of all but second sides.
    pub extents: Extents,
    /// For each point of the cloud the surfel whose light it gets, if it has a place.
    pub surfel_of_point: Vec<Option<u32>>,
    /// Points that are on no surface.
    pub strays: usize,
    /// Points without finite coordinates.
    pub unplaced: usize,
    /// Share of the area whose lit side is unknown.
    pub unsure: f64,
    /// Share of the area that is lit on its outside because it is round, as nothing else says which.
    pub round: f64,
    /// What the sides were decided by.
    pub how: &'static str,
}

/// The surface of a cloud in about `most` surfels, or as few as its points allow.
///
/// # Errors
/// [`Error::Invalid`] where the points make no surface; [`Error::Interrupted`] if `progress` asks to stop.
pub(super) fn fit(
    cloud: &PointCloud,
    evidence: &Evidence,
    size: Option<f64>,
    most: usize,
    progress: &dyn Progress,
) -> Result<Fitted> {
    progress.stage("spacing", 1);
    let all = Samples::of(cloud, &evidence.facing, progress)?;
    let half = evidence.half.map(|half| all.half(half));
    let samples = half.as_ref().unwrap_or(&all);
    let neighbours = Neighbours::new(&samples.positions)?;
    let scale = Scale::of(samples, &neighbours, progress)?;
    let size = size
        .map_or(0.0, |size| size as f32)
        .max(cover::size_for(&scale, most));
    let mut patches = cover::cover(samples, &scale, &neighbours, size, progress)?;
    drop(neighbours);
    if patches.is_empty() {
        return Err(Error::Invalid(format!(
            "no surface in these {} points: nowhere do enough of them lie on a plane",
            samples.len()
        )));
    }
    let mut owners = Owners::of(samples, &mut patches, progress)?;
    let told = told(samples, &patches, &owners);
    let told_by = match evidence.facing {
        _ if cloud.normals.iter().any(|n| *n != Vec3::ZERO) => "turned as the given normals",
        Facing::Viewpoint(_) => "turned to the viewpoint",
        _ => "turned to the scanner",
    };
    let lamps: Vec<Vec3> = evidence
        .lamps
        .iter()
        .map(|l| (*l - samples.origin).as_vec3())
        .collect();
    let known = Known {
        told: &told,
        told_by,
        points: &owners.counts(),
        facing: &evidence.facing,
        lamps: &lamps,
    };
    let found = sides::sides(&patches, &known, progress)?;
    for (patch, flipped) in patches.iter_mut().zip(&found.flipped) {
        if *flipped {
            patch.normal = -patch.normal;
        }
    }
    for (patch, unsure) in patches.iter_mut().zip(&found.unsure) {
        patch.both = *unsure;
    }
    let area = |p: &Patch| f64::from(p.size).powi(2);
    let round = patches
        .iter()
        .zip(&found.round)
        .filter(|(_, round)| **round);
    let round: f64 = round.map(|(patch, _)| area(patch)).sum();
    let hanging = found.hanging.iter().filter(|hanging| **hanging).count();
    if (1..patches.len()).contains(&hanging) {
        let mut hanging = found.hanging.iter();
        patches.retain(|_| !hanging.next().is_some_and(|hanging| *hanging));
        owners = Owners::of(samples, &mut patches, progress)?;
    }
    let both = patches.iter().filter(|p| p.both).map(area).sum::<f64>();
    let whole = patches.iter().map(area).sum::<f64>();
    let of_all = (half.as_ref())
        .map(|_| Owners::nearest_to(&all, &patches))
        .transpose()?;
    let of_all = of_all.as_ref().unwrap_or(&owners);
    let mut fitted = Fitted {
        extents: owners.extents(samples, &patches),
        strays: of_all.strays(),
        unplaced: cloud.len() - all.len(),
        surfel_of_point: of_all.of_points(cloud.len(), &all),
        sizes: patches.iter().map(|p| p.size).collect(),
        surfels: surfels(cloud, samples, &patches, &owners),
        unsure: both / whole,
        round: round / whole,
        how: found.how,
    };
    fitted.add_backs(&patches);
    Ok(fitted)
}

fn surfels(cloud: &PointCloud, samples: &Samples, patches: &[Patch], owners: &Owners) -> Surfels {
    let (reflectance, emission) = owners.colours(cloud, samples);
    Surfels {
        origin: samples.origin,
        positions: patches.iter().map(|p| p.position).collect(),
        normals: patches.iter().map(|p| p.normal).collect(),
        areas: vec![0.0; patches.len()],
        points: patches
            .iter()
            .map(|p| samples.points[p.sample as usize])
            .collect(),
        reflectance,
        emission,
        ..Surfels::default()
    }
}

/// What is told of the side of each patch by where its points were seen from, or by their normals.
fn told(samples: &Samples, patches: &[Patch], owners: &Owners) -> Vec<f32> {
    let mut sums = vec![(0.0, 0.0_f32); patches.len()];
    for (k, owner) in owners.iter() {
        if let Some(view) = samples.view(k as u32).filter(|view| *view != Vec3::ZERO) {
            let (sum, count) = &mut sums[owner as usize];
            let cos = view.dot(patches[owner as usize].normal);
            *sum += (cos / PLAIN).clamp(-1.0, 1.0);
            *count += 1.0;
        }
    }
    let mean = |(sum, count): (f32, f32)| sum / count.max(1.0);
    sums.into_iter().map(mean).collect()
}

impl Fitted {
    /// Gives surfels of which both sides may be lit a second one at the same place that faces the other way.
    fn add_backs(&mut self, patches: &[Patch]) {
        let surfels = &mut self.surfels;
        let n = surfels.len();
        surfels.backs = vec![NO_SURFEL; n];
        for i in (0..n).filter(|&i| patches[i].both) {
            surfels.backs[i] = surfels.len() as u32;
            surfels.backs.push(i as u32);
            surfels.positions.push(surfels.positions[i]);
            surfels.normals.push(-surfels.normals[i]);
            surfels.areas.push(surfels.areas[i]);
            surfels.reflectance.push(surfels.reflectance[i]);
            surfels.emission.push(surfels.emission[i]);
            surfels.points.push(surfels.points[i]);
            self.sizes.push(self.sizes[i]);
        }
    }
}
