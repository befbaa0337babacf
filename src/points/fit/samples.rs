//! The usable points of a cloud, with the scale of what is known around each: distance of the points
//! and noise, both of the place and not of the whole cloud.

use std::f32::consts::PI;

use glam::{DVec3, Vec3};
use rand::RngExt;
use rayon::prelude::*;

use super::Half;
use super::curved::deviation;
use crate::error::{Error, Result};
use crate::octree::morton_codes;
use crate::points::neighbours::{Last, Neighbours, runs};
use crate::points::select::middle;
use crate::points::{Facing, PointCloud};
use crate::progress::Progress;
use crate::random::{Purpose, stream};

/// Neighbours whose farthest tells the spacing: enough that the pattern of a scan's lines averages out.
const AROUND: usize = 12;
/// In a cloud of more points than this the spacing is measured at about so many of them.
const SPACED: usize = 1_500_000;
/// Places that the noise is measured at, and those of them that are asked at a point.
const PROBES: usize = 4000;
const ASKED: usize = 9;
/// Samples that follow one another are asked for together: so many.
const ALIKE: usize = 16;
/// Neighbours that a paraboloid is laid through for that: the fewest that lie on one.
const SCALES: [usize; 7] = [16, 32, 64, 128, 256, 512, 1024];
/// Points lie on a paraboloid if they are off it by less than this part of its radius, in the mean: surely, and perhaps.
const FLAT: [f32; 2] = [0.04, 0.12];
/// Places that are sure of it are asked alone, if they are this part of all.
const ENOUGH: f64 = 0.25;
/// Points of a small cloud.
const SMALL: usize = 1000;
/// Noise below this part of the spacing is taken for this: planes stand for curved surfaces.
const LEAST_NOISE: f32 = 0.01;

/// Colours of one surface differ by so much at least: the reflectance of a step of 8 bits, and light that was
/// uneven.
const COLOURS: f32 = 0.02;

/// Points of a half, at most: so many tell as well as more how sure a surface is.
const HALF: usize = 500_000;

/// Points with finite coordinates, along a Morton curve; all arrays have one entry each.
pub(super) struct Samples {
    /// Component-wise median, in the scan's coordinates.
    pub origin: DVec3,
    /// Relative to `origin`.
    pub positions: Vec<Vec3>,
    /// Indices in the cloud.
    pub points: Vec<u32>,
    /// Reflectances.
    pub colours: Vec<Vec3>,
    /// Unit vectors to where the points were seen from, or their own normals; zero where neither is known, and empty
    /// if that is so of all.
    views: Vec<Vec3>,
}

/// What the points tell of the surface around each of them, one entry a sample.
pub(super) struct Scale {
    /// Distance of the points around: the side of the square that each has on the surface.
    pub spacing: Vec<f32>,
    /// Standard deviation of the points from their surface, with what layers of several scans are apart.
    pub noise: Vec<f32>,
}

impl Samples {
    /// # Errors
    /// [`Error::Invalid`] if no point has finite coordinates.
    pub fn of(cloud: &PointCloud, facing: &Facing, progress: &dyn Progress) -> Result<Samples> {
        let placed = |i: usize| cloud.is_placed(i);
        let Some(origin) = middle(cloud, placed) else {
            return Err(Error::Invalid("no point has finite coordinates".into()));
        };
        let all: Vec<u32> = (0..cloud.len() as u32)
            .into_par_iter()
            .filter(|&i| placed(i as usize))
            .collect();
        let place = |&i: &u32| (cloud.positions[i as usize] - origin).as_vec3();
        let positions: Vec<Vec3> = all.par_iter().map(place).collect();
        let mut keys: Vec<(u64, u32)> = morton_codes(&positions).zip(all).collect();
        keys.par_sort_unstable();
        let points: Vec<u32> = keys.into_par_iter().map(|(_, i)| i).collect();
        let positions: Vec<Vec3> = points.par_iter().map(place).collect();
        let view = |&i: &u32| {
            let i = i as usize;
            let given = cloud.normals.get(i).and_then(|n| n.try_normalize());
            let seen = || {
                (facing.viewpoint(cloud, i)? - cloud.positions[i])
                    .as_vec3()
                    .try_normalize()
            };
            given.or_else(seen).unwrap_or_default()
        };
        let mut views: Vec<Vec3> = points.par_iter().map(view).collect();
        if views.par_iter().all(|view| *view == Vec3::ZERO) {
            views = Vec::new();
        }
        progress.check()?;
        Ok(Samples {
            origin,
            colours: points
                .par_iter()
                .map(|&i| cloud.reflectance[i as usize])
                .collect(),
            views,
            positions,
            points,
        })
    }

    /// From where a sample was seen, if that is known of any.
    pub fn view(&self, k: u32) -> Option<Vec3> {
        self.views.get(k as usize).copied()
    }

    /// Mean colour of samples, and how far they are off that (root mean square), or as well as colours are known.
    pub fn mean_colour(&self, of: &[u32]) -> (Vec3, f32) {
        let sum = |(sum, squares, count): (Vec3, f32, f32), &k: &u32| {
            let colour = self.colours[k as usize];
            (sum + colour, squares + colour.length_squared(), count + 1.0)
        };
        let (sum, squares, count) = of.iter().fold((Vec3::ZERO, 0.0, 0.0_f32), sum);
        let mean = sum / count.max(1.0);
        let variance = (squares / count.max(1.0) - mean.length_squared()).max(0.0);
        (mean, variance.sqrt().max(COLOURS))
    }

    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Every second sample along the curve, or fewer.
    pub fn half(&self, half: Half) -> Samples {
        let step = self.len().div_ceil(HALF).max(2);
        let first = match half {
            Half::First => 0,
            Half::Second => step / 2,
        };
        fn part<T: Copy>(of: &[T], first: usize, step: usize) -> Vec<T> {
            of.iter().skip(first).step_by(step).copied().collect()
        }
        Samples {
            origin: self.origin,
            positions: part(&self.positions, first, step),
            points: part(&self.points, first, step),
            colours: part(&self.colours, first, step),
            views: part(&self.views, first, step),
        }
    }
}

impl Scale {
    /// Finds spacing and noise.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if `progress` asks to stop.
    pub fn of(
        samples: &Samples,
        neighbours: &Neighbours,
        progress: &dyn Progress,
    ) -> Result<Scale> {
        let (n, positions) = (samples.len(), &samples.positions);
        let alike = n.div_ceil(SPACED).max(1);
        let spacing = |run: std::ops::Range<usize>| {
            let (mut last, mut near) = (Last::default(), Vec::new());
            let mut spacing = |i: usize| {
                neighbours.next_nearest(i, AROUND, &mut last, &mut near);
                let far = near.last().map_or(0.0, |n| n.1.length() as f32);
                far * (PI / near.len().max(1) as f32).sqrt()
            };
            // Those that follow one another have about the same.
            let mut of_run = Vec::with_capacity(run.len());
            for first in run.clone().step_by(alike) {
                let count = alike.min(run.end - first);
                of_run.extend(std::iter::repeat_n(spacing(first), count));
            }
            of_run
        };
        let spacing: Vec<f32> = runs(0..n).flat_map_iter(spacing).collect();
        progress.check()?;
        let step = n.div_ceil(PROBES).max(1);
        let probes: Vec<(Vec3, [Option<f32>; 2])> = (0..n.div_ceil(step))
            .into_par_iter()
            .map(|k| {
                let mut random = stream(0, Purpose::Fit, k as u64);
                let i = (k * step + random.random_range(0..step)).min(n - 1);
                (positions[i], noise_at(i, neighbours))
            })
            .collect();
        // Where few are sure, as in a cloud that is all noise, the others have to do.
        let sure = probes.iter().filter(|p| p.1[0].is_some()).count();
        // Of a small cloud these would be edges and corners.
        let which = usize::from((sure as f64) < ENOUGH * probes.len() as f64 && n > SMALL);
        let probes: Vec<(Vec3, f32)> = (probes.into_iter())
            .filter_map(|(place, noise)| Some((place, noise[which]?)))
            .collect();
        let places: Vec<Vec3> = probes.iter().map(|p| p.0).collect();
        let tree = match places.is_empty() {
            true => None,
            false => Some(Neighbours::new(&places)?),
        };
        let noise_of_run = |run: usize| {
            let Some(tree) = &tree else { return 0.0 };
            let mut around: Vec<f32> = tree
                .around(positions[run * ALIKE], ASKED)
                .iter()
                .map(|&k| probes[k as usize].1)
                .collect();
            // Those at edges see more than noise.
            let few = around.len() / 3;
            *around.select_nth_unstable_by(few, f32::total_cmp).1
        };
        let of_runs: Vec<f32> = (0..n.div_ceil(ALIKE))
            .into_par_iter()
            .map(noise_of_run)
            .collect();
        let noise = |i: usize| of_runs[i / ALIKE].max(LEAST_NOISE * spacing[i]);
        let noise = (0..n).into_par_iter().map(noise).collect();
        progress.check()?;
        Ok(Scale { spacing, noise })
    }
}

/// Deviation of the points from the paraboloid of the fewest neighbours that surely lie on one, and that may do.
fn noise_at(i: usize, neighbours: &Neighbours) -> [Option<f32>; 2] {
    let mut near = Vec::new();
    neighbours.nearest(i, SCALES[SCALES.len() - 1], &mut near);
    let places: Vec<Vec3> = near.iter().map(|n| n.1.as_vec3()).collect();
    let mut found = [None; 2];
    for &k in SCALES.iter().take_while(|&&k| k <= places.len()) {
        let radius = places[k - 1].length();
        let Some(rms) = deviation(&places[..k]) else {
            continue;
        };
        for (found, flat) in found.iter_mut().zip(FLAT) {
            if found.is_none() && rms < flat * radius {
                *found = Some(rms);
            }
        }
        if found[0].is_some() {
            break;
        }
    }
    found
}
