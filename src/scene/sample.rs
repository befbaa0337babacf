//! Points on surfaces, each standing for the same share of its surface's area.
//!
//! A surface is cut into rows of about equal height along v, and each row into a whole number of
//! strata of exactly equal area along u. A stratum holds one point, in the middle half of its
//! extent both ways, so that points keep a distance from each other.

use std::path::Path;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use rayon::prelude::*;

use super::surface::{Model, Surface};
use crate::error::{Error, Result};
use crate::points::PointCloud;
use crate::progress::Progress;

/// Spreads `count` points over the model and removes the covered ones.
pub(super) fn sample_model(
    path: &Path,
    model: &Model,
    count: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<PointCloud> {
    let parts = &model.parts;
    if parts.is_empty() {
        return Err(Error::input(path, "all faces of all shapes are left out"));
    }
    if count < parts.len() {
        return Err(Error::Usage(format!(
            "{}: {count} points are too few for {} surfaces",
            path.display(),
            parts.len()
        )));
    }
    progress.stage("sampling shapes", count as u64);
    // The tables are made twice, so that many shapes need no more memory than one.
    let areas = parts
        .par_iter()
        .map(|part| {
            progress.check()?;
            Ok(AreaTable::new(&*part.surface).area())
        })
        .collect::<Result<Vec<f64>>>()?;

    let mut cloud = PointCloud::default();
    let mut covered = 0;
    for (i, (part, share)) in parts.iter().zip(shares(&areas, count)).enumerate() {
        let surface = &*part.surface;
        let seed = hash(seed, i as u64);
        let mut samples = sample(surface, share, seed, progress)?;
        if part.flipped {
            samples.iter_mut().for_each(|s| s.normal = -s.normal);
        }
        let visible: Vec<bool> = samples
            .par_iter()
            .map(|s| !model.covered(part, s.position, s.normal))
            .collect();
        for (s, _) in samples.iter().zip(visible).filter(|(_, visible)| *visible) {
            cloud.positions.push(s.position);
            cloud.normals.push(s.normal.as_vec3());
        }
        let len = cloud.len();
        covered += share - (len - cloud.areas.len());
        cloud.areas.resize(len, (areas[i] / share as f64) as f32);
        cloud.reflectance.resize(len, part.material.reflectance);
        cloud.emission.resize(len, part.material.emission);
    }
    if cloud.is_empty() {
        return Err(Error::input(path, "all shapes lie inside each other"));
    }
    if covered > 0 {
        progress.note(&format!(
            "{covered} of {count} points removed: inside another shape"
        ));
    }
    Ok(cloud)
}

/// Splits `count` points by area: whole numbers, none zero, that add up to it. There must be no
/// more areas than points.
fn shares(areas: &[f64], count: usize) -> Vec<usize> {
    let total: f64 = areas.iter().sum();
    let mut below = 0.0;
    let mut given = 0;
    let mut shares = Vec::with_capacity(areas.len());
    for (i, area) in areas.iter().enumerate() {
        below += area;
        // Rounding the running total keeps the sum.
        let up_to_here = (count as f64 * (below / total)).round() as usize;
        let still_to_come = areas.len() - 1 - i;
        let up_to_here = up_to_here.clamp(given + 1, count - still_to_come);
        shares.push(up_to_here - given);
        given = up_to_here;
    }
    shares
}

/// A place on a surface and ∂f/∂u × ∂f/∂v there, of unit length.
pub(super) struct Sample {
    pub position: DVec3,
    pub normal: DVec3,
}

/// How the area of a surface is spread over its parameters, as a table.
struct AreaTable {
    /// Area below v at the edges of the cells along v, for each cell along u: row by row.
    below: Vec<f64>,
    /// Cells along u and v.
    cells: [usize; 2],
    /// Area of all u below v, at the edges of the cells along v.
    rows: Vec<f64>,
    /// Mean length of the way from v = 0, at the edges of the cells along v.
    heights: Vec<f64>,
}

impl AreaTable {
    fn new(surface: &dyn Surface) -> Self {
        let [nu, nv] = surface.cells();
        let mut below = vec![0.0; nu];
        let mut rows = vec![0.0];
        let mut heights = vec![0.0];
        let cell = 1.0 / (nu * nv) as f64;
        for j in 0..nv {
            let (mut area, mut height) = (0.0, 0.0);
            for i in 0..nu {
                let u = (i as f64 + 0.5) / nu as f64;
                let v = (j as f64 + 0.5) / nv as f64;
                let [du, dv] = surface.tangents(u, v);
                let a = du.cross(dv).length() * cell;
                below.push(below[j * nu + i] + a);
                area += a;
                height += dv.length() * cell;
            }
            rows.push(rows[j] + area);
            heights.push(heights[j] + height);
        }
        Self {
            below,
            cells: [nu, nv],
            rows,
            heights,
        }
    }

    fn area(&self) -> f64 {
        self.rows[self.cells[1]]
    }

    fn height(&self) -> f64 {
        self.heights[self.cells[1]]
    }

    /// Area between two v, summed up along u.
    fn along_u(&self, from: f64, to: f64) -> Vec<f64> {
        let [nu, _] = self.cells;
        let mut sum = 0.0;
        let mut sums = vec![0.0];
        for i in 0..nu {
            let below = |v: f64| lookup(|j| self.below[j * nu + i], self.cells[1], v);
            sum += below(to) - below(from);
            sums.push(sum);
        }
        sums
    }
}

/// The value at x in [0, 1] of a function known at the edges of `cells` cells.
fn lookup(at: impl Fn(usize) -> f64, cells: usize, x: f64) -> f64 {
    let x = x * cells as f64;
    let i = (x as usize).min(cells - 1);
    at(i) + (at(i + 1) - at(i)) * (x - i as f64)
}

/// Where in [0, 1] a growing function, known at the edges of cells, takes a value.
fn invert(values: &[f64], value: f64) -> f64 {
    let cells = values.len() - 1;
    let i = values[1..].partition_point(|&x| x < value).min(cells - 1);
    let (low, high) = (values[i], values[i + 1]);
    let inside = if high > low {
        ((value - low) / (high - low)).clamp(0.0, 1.0)
    } else {
        0.5
    };
    (i as f64 + inside) / cells as f64
}

/// Exactly `count` points on a surface; the same for a `seed`, whatever the number of threads.
pub(super) fn sample(
    surface: &dyn Surface,
    count: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<Sample>> {
    let table = AreaTable::new(surface);
    let spacing = (table.area() / count as f64).sqrt();
    let rows = ((table.height() / spacing).round() as usize).clamp(1, count);
    // The number of points below each row's lower edge; then the rows are moved a little, so that
    // the area below them is just that many shares.
    let first = |row: usize| {
        let v = invert(&table.heights, table.height() * row as f64 / rows as f64);
        let area = lookup(|j| table.rows[j], table.cells[1], v);
        ((area / table.area() * count as f64).round() as usize).min(count)
    };
    let area_of = |points: f64| table.area() * points / count as f64;

    let rows: Vec<Vec<Sample>> = (0..rows)
        .into_par_iter()
        .map(|row| {
            progress.check()?;
            let (start, end) = (first(row), first(row + 1));
            let v_of = |points: f64| invert(&table.rows, area_of(points));
            let along_u = table.along_u(v_of(start as f64), v_of(end as f64));
            let row_area = along_u[table.cells[0]];
            let mut random = Pcg32::seed_from_u64(hash(seed, row as u64));
            let strata = end - start;
            let samples = (0..strata).map(|stratum| {
                let [s, t] = [(); 2].map(|()| 0.25 + 0.5 * random.random::<f64>());
                let u = invert(&along_u, row_area * (stratum as f64 + s) / strata as f64);
                let v = v_of(start as f64 + t * strata as f64);
                let [du, dv] = surface.tangents(u, v);
                Sample {
                    position: surface.at(u, v),
                    normal: du.cross(dv).normalize_or(DVec3::Y),
                }
            });
            let samples = samples.collect();
            progress.advance(strata as u64);
            Ok(samples)
        })
        .collect::<Result<_>>()?;
    Ok(rows.into_iter().flatten().collect())
}

/// Mixes two numbers into one seed (the finaliser of SplitMix64).
fn hash(a: u64, b: u64) -> u64 {
    let mut x = a.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ b.wrapping_add(0xD1B5_4A32_D192_ED03);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}
