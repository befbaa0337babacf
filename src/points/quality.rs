//! How good a cloud is as a surface.

use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use super::{MAX_COLOUR_REFLECTANCE, PointCloud, Surfels};
use crate::random::{Purpose, cosine_direction, stream};
use crate::visibility::{Occluders, first_hit};

/// Surfels whose area is less than this part of the median lie nearly at the place of another one.
const CROWDED: f32 = 0.01;
/// Reflectance from which on a colour is white: a lamp, or an overexposed photograph.
const WHITE: f32 = 0.999 * MAX_COLOUR_REFLECTANCE;
/// Surfels from which rays are cast to see whether the surface is closed, and rays from each.
const SAMPLE: usize = 1000;
const RAYS: usize = 16;

/// How good a cloud is as a surface, and what was left out of it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Quality {
    /// Points of the cloud.
    pub points: usize,
    /// Those that stand for the surface.
    pub surfels: usize,
    /// Points without coordinates or normal.
    pub unusable: usize,
    /// Points at the place of another one.
    pub duplicates: usize,
    /// Points so near to another one that they share its surface: less than a hundredth of the median.
    pub crowded: usize,
    /// Points whose colour is white: light of lamps in it, or an overexposed photograph.
    pub white: usize,
    /// Points whose area the file gives.
    pub given_areas: usize,
    /// Points that are stood in for by others, because fewer were asked for.
    pub thinned: usize,
    /// Points that belong to no surface.
    pub strays: usize,
    /// Share of the surface of which nothing says which side is lit.
    pub unsure: f64,
    /// Share of the surface that is lit from outside because it is round and thin, as nothing else says which side is.
    pub round: f64,
    /// Points inside of bodies or behind walls.
    pub buried: usize,
    /// How far points lay beside their surface, in spacings: median.
    pub noise: f64,
    /// Angle by which normals disagree with the positions, in degrees: median.
    pub scatter: f64,
    /// Square root of the area of a surfel, in the scan's unit: 5th percentile, median, 95th.
    pub spacing: [f64; 3],
    /// Surface area in the square of the scan's unit.
    pub area: f64,
}

/// How far a surface closes around what is before and behind it: the shares of rays that leave the cloud.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Openness {
    /// From the sides that normals point to: 0 in a closed room.
    pub front: f64,
    /// From the other sides: 0 on a closed body.
    pub back: f64,
}

impl Openness {
    /// By rays from some surfels.
    pub fn of(surfels: &Surfels, occluders: &Occluders) -> Openness {
        let (reach, step) = (surfels.reach(), surfels.len().div_ceil(SAMPLE).max(1));
        let leave = |i: usize| {
            let mut random = stream(0, Purpose::Sides, u64::from(surfels.points[i]));
            let tangent = surfels.cells.tangents[i];
            [1.0, -1.0].map(|side| {
                let normal = side * surfels.normals[i];
                let mut leaves = || {
                    let way = cosine_direction(normal, tangent, random.random(), random.random());
                    let mut ray = surfels.ray(i, way * reach);
                    if side < 0.0 {
                        let from = surfels.below(i) + surfels.offsets[i] * normal;
                        (ray.from, ray.to) = (from.to_array(), (from + way * reach).to_array());
                    }
                    first_hit::<f32>(occluders, &ray).is_none()
                };
                (0..RAYS).filter(|_| leaves()).count() as f64
            })
        };
        let [front, back] = (0..surfels.len())
            .into_par_iter()
            .step_by(step)
            .map(leave)
            .reduce(|| [0.0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
        let all = (surfels.len().div_ceil(step) * RAYS).max(1) as f64;
        Openness {
            front: front / all,
            back: back / all,
        }
    }

    /// In words.
    pub fn line(&self) -> String {
        let what = match (self.front, self.back) {
            (front, back) if back < 0.1 && front > 0.2 => "a closed body, seen from outside",
            (front, back) if front < 0.1 && back > 0.2 => {
                "a closed room, seen from inside; if it is a body, --normals outward turns it"
            }
            _ => "open",
        };
        format!(
            "{:.0}% of the rays from the lit sides leave the cloud, {:.0}% from the others: {what}",
            100.0 * self.front,
            100.0 * self.back
        )
    }
}

impl Quality {
    /// Ratio of the densities of points, between the densest and the sparsest twentieth.
    pub fn density_ratio(&self) -> f64 {
        (self.spacing[2] / self.spacing[0]).powi(2)
    }

    /// Takes what the points tell.
    pub(super) fn count(&mut self, cloud: &PointCloud) {
        self.points = cloud.len();
        let white = |r: &&glam::Vec3| r.cmpge(glam::Vec3::splat(WHITE)).all();
        self.white = cloud.reflectance.par_iter().filter(white).count();
        self.given_areas = cloud.areas.par_iter().filter(|&&a| a > 0.0).count();
    }

    /// Takes what the surfels tell.
    pub(super) fn measure(&mut self, surfels: &Surfels) {
        self.surfels = surfels.len();
        let mut areas = surfels.areas.clone();
        areas.par_sort_unstable_by(f32::total_cmp);
        let size = |k: usize| f64::from(areas[k * (areas.len() - 1) / 100]).sqrt();
        self.spacing = [5, 50, 95].map(size);
        let least = CROWDED * areas[areas.len() / 2];
        self.crowded = areas.partition_point(|&a| a < least);
        self.area = areas.iter().map(|&a| f64::from(a)).sum();
    }

    /// What was found, a line each.
    pub fn lines(&self) -> Vec<String> {
        let [fine, median, coarse] = self.spacing;
        let mut lines = vec![
            format!(
                "{} points, {} of them surface of {:.4}",
                self.points, self.surfels, self.area
            ),
            format!(
                "spacing {median:.3}, {fine:.3} to {coarse:.3} for nine of ten: density varies {:.1} \
                 times",
                self.density_ratio()
            ),
            format!(
                "points lie {:.2} spacings beside their surface, normals {:.1} degrees off it",
                self.noise, self.scatter
            ),
        ];
        for (count, what) in [
            (self.unusable, "without coordinates or normal"),
            (self.duplicates, "at the place of another one"),
            (self.crowded, "nearly at the place of another one"),
            (self.white, "white: lamps, or an overexposed photograph"),
            (self.given_areas, "with an area of the file"),
            (self.thinned, "thinned out"),
            (self.strays, "strays"),
            (self.buried, "buried"),
        ] {
            if count > 0 {
                let share = 100.0 * count as f64 / self.points as f64;
                lines.push(format!("{count} points ({share:.2}%) {what}"));
            }
        }
        lines
    }
}
