//! What there is to say about a cloud before anything is done with it.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::Serialize;

use super::neighbours::Neighbours;
use super::{DEFAULT_REFLECTANCE, PointCloud};
use crate::error::Result;
use crate::output::needs_double;

/// Points whose nearest neighbours are looked for.
const SAMPLE: usize = 20_000;
/// Neighbours among which one is at another place.
const NEIGHBOURS: usize = 8;

/// A look at the points of a cloud.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Survey {
    pub points: usize,
    /// Points that have a place, finite coordinates up to 10¹², and that the file does not flag.
    pub placed: usize,
    /// Points that the file flags as withheld or noise.
    pub flagged: usize,
    /// Least and largest coordinates of those.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// Median distance from a point to the nearest one at another place; of a sample.
    pub spacing: Option<f64>,
    /// Whether f32 would lose detail, as with map coordinates.
    pub needs_double: bool,
    /// Points with a normal that is finite and not zero.
    pub with_normal: usize,
    /// Points with a known area.
    pub with_area: usize,
    /// Whether any point has another reflectance than the default.
    pub has_colour: bool,
    /// Points that shine.
    pub shining: usize,
    /// Places that points were measured from.
    pub scanners: Vec<[f64; 3]>,
}

impl Survey {
    /// Looks at some points of a cloud.
    ///
    /// # Errors
    /// If the search for neighbours fails.
    pub fn of(cloud: &PointCloud, points: Range<usize>) -> Result<Survey> {
        let count = |good: &(dyn Fn(usize) -> bool + Sync)| {
            points.clone().into_par_iter().filter(|&i| good(i)).count()
        };
        let placed: Vec<DVec3> = points
            .clone()
            .into_par_iter()
            .filter(|&i| cloud.is_placed(i))
            .map(|i| cloud.positions[i])
            .collect();
        let (min, max) = placed
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), &p| {
                (min.min(p), max.max(p))
            });
        let normal = |i: usize| cloud.normals.get(i).copied().unwrap_or(Vec3::ZERO);
        let area = |i: usize| cloud.areas.get(i).copied().unwrap_or(0.0);
        let grey = Vec3::splat(DEFAULT_REFLECTANCE);
        let within = |scanner: &&super::Scanner| {
            scanner.points.start < points.end && points.start < scanner.points.end
        };
        let scanners = cloud.scanners.iter().filter(within);
        Ok(Survey {
            points: points.len(),
            placed: placed.len(),
            flagged: count(&|i| cloud.is_flagged(i)),
            bounds: (!placed.is_empty()).then(|| [min, max].map(|p| p.to_array())),
            spacing: spacing(&placed, 0.5 * (min + max))?,
            needs_double: needs_double(&placed),
            with_normal: count(&|i| normal(i).is_finite() && normal(i) != Vec3::ZERO),
            with_area: count(&|i| area(i) > 0.0),
            has_colour: count(&|i| cloud.reflectance.get(i).is_some_and(|r| *r != grey)) > 0,
            shining: count(&|i| cloud.emission.get(i).is_some_and(|e| *e != Vec3::ZERO)),
            scanners: scanners.map(|s| s.position.to_array()).collect(),
        })
    }

    /// What `solve` would miss, and what it would do about it.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let without = self.points - self.placed - self.flagged;
        if self.flagged > 0 {
            notes.push(format!(
                "{} points are flagged as withheld or noise: left out (--keep-flagged takes them)",
                self.flagged
            ));
        }
        if without > 0 {
            notes.push(format!(
                "{without} points have no place (coordinates that are not finite or beyond 1e12): \
                 left out, and flagged in the output"
            ));
        }
        if self.needs_double {
            notes.push(
                "coordinates lie far from the origin, f32 would lose detail: the light is computed \
                 around their middle, the output has double coordinates"
                    .to_owned(),
            );
        }
        match self.points - self.with_normal {
            0 => {}
            all if all == self.points => notes.push(
                "no normals: estimated from the neighbours; --normals, a scanner or a lamp inside tells the lit side"
                    .to_owned(),
            ),
            some => notes.push(format!("{some} points have no normal: estimated from the neighbours")),
        }
        if self.with_area < self.points {
            notes.push("no areas: found from the neighbours".to_owned());
        }
        if !self.has_colour {
            notes.push(format!("no colours: reflectance {DEFAULT_REFLECTANCE}"));
        }
        notes
    }
}

/// Median distance to the nearest neighbour.
fn spacing(places: &[DVec3], middle: DVec3) -> Result<Option<f64>> {
    if places.len() < 2 {
        return Ok(None);
    }
    let positions: Vec<Vec3> = places.par_iter().map(|&p| (p - middle).as_vec3()).collect();
    let neighbours = Neighbours::new(&positions)?;
    let every = positions.len().div_ceil(SAMPLE);
    let sample: Vec<usize> = (0..positions.len()).step_by(every).collect();
    let mut distances: Vec<f32> = sample
        .par_iter()
        .filter_map(|&i| neighbours.distance(i, NEIGHBOURS))
        .collect();
    let half = distances.len() / 2;
    if distances.is_empty() {
        return Ok(None);
    }
    let (_, median, _) = distances.select_nth_unstable_by(half, f32::total_cmp);
    Ok(Some(f64::from(*median)))
}
