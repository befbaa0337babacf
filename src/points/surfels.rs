//! Surfels: points as small pieces of surface, as structure of arrays.

use std::collections::HashMap;
use std::num::NonZero;

use glam::{DVec3, Vec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

use super::cells::{Cell, Neighbour};
use super::{Cells, PointCloud};
use crate::error::{Error, Result};
use crate::memory;
use crate::progress::Progress;
use crate::scene::LARGEST;
use crate::visibility::Segment;

/// The points that take part in the transport.
///
/// Positions are in the scan's unit, relative to `origin`; normals are of unit length; all arrays
/// have one entry a surfel.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    /// Centre of the cloud's box, in the scan's coordinates.
    pub origin: DVec3,
    /// Centres, relative to `origin`.
    pub positions: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// Areas in unit².
    pub areas: Vec<f32>,
    /// Linear RGB in [0, 1].
    pub reflectance: Vec<Vec3>,
    /// Linear RGB radiant exitance.
    pub emission: Vec<Vec3>,
    /// The pieces of surface that the surfels stand for.
    pub cells: Cells,
    /// Distance above the surface at which segments start and end, a surfel (follows the noise).
    pub offsets: Vec<f32>,
    /// Scale of the cells as occluders (follows the noise; a little over 1 closes the seams).
    pub occluder_scale: f32,
    /// Index of each surfel's point in the cloud.
    pub points: Vec<u32>,
}

/// Surfels and how the points of the cloud map to them.
pub struct Prepared {
    pub surfels: Surfels,
    /// For each point of the cloud the surfel whose light it gets, if any.
    pub surfel_of_point: Vec<Option<u32>>,
    /// What was left out or merged, with counts.
    pub repairs: Vec<String>,
}

/// Neighbours that a cell is made from.
const NEIGHBOURS: usize = 24;

impl Surfels {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The surfels of a cloud: unusable points left out, points at one place merged, cells made,
    /// areas taken from the cloud or else from the cells.
    pub fn prepare(cloud: &PointCloud, progress: &dyn Progress) -> Result<Prepared> {
        if cloud.is_empty() {
            return Err(Error::Invalid("the cloud has no points".into()));
        }
        memory::check_points(cloud.len() as u64)?;
        if cloud.normals.is_empty() {
            return Err(Error::Invalid(
                "the cloud has no normals (properties nx, ny, nz): estimate them first, for \
                 instance in CloudCompare or MeshLab, and save them with the points"
                    .into(),
            ));
        }
        let mut repairs = cloud.repairs.clone();
        let (mut surfels, surfel_of_point) = select(cloud, &mut repairs)?;
        surfels.make_cells(progress)?;
        Ok(Prepared {
            surfels,
            surfel_of_point,
            repairs,
        })
    }

    /// Cells, missing areas, offsets.
    fn make_cells(&mut self, progress: &dyn Progress) -> Result<()> {
        let n = self.len();
        progress.stage("cells", n as u64);
        let positions: Vec<[f32; 3]> = self.positions.iter().map(|p| p.to_array()).collect();
        let tree = ImmutableKdTree::<f32, 3>::new_from_slice(&positions)
            .map_err(|e| Error::Invalid(format!("neighbour search failed: {e:?}")))?;
        let neighbours = |i: usize, out: &mut Vec<Neighbour>| {
            out.clear();
            let found = tree
                .query(&positions[i])
                .nearest_n::<SquaredEuclidean<f32>>(
                    NonZero::<usize>::MIN.saturating_add(NEIGHBOURS),
                )
                .execute();
            for item in found.iter().filter(|item| item.distance > 0.0) {
                let j = item.item as usize;
                out.push(Neighbour {
                    offset: (self.positions[j] - self.positions[i]).as_dvec3(),
                    normal: self.normals[j].as_dvec3(),
                });
            }
        };
        let noise = noise(self, neighbours);
        let rule = SurfaceRule::for_noise(noise);
        let cells: Vec<Cell> = (0..n)
            .into_par_iter()
            .map_init(
                || Vec::with_capacity(NEIGHBOURS),
                |near, i| {
                    if i % 4096 == 0 {
                        progress.advance(4096);
                    }
                    neighbours(i, near);
                    let size = f64::from(self.areas[i]).max(0.0).sqrt();
                    Cell::new(self.normals[i].as_dvec3(), near, rule.crease, size)
                },
            )
            .collect();
        progress.check()?;
        self.occluder_scale = rule.scale as f32;
        self.offsets = cells
            .iter()
            .map(|c| (rule.offset * c.spacing) as f32)
            .collect();
        for (area, cell) in self.areas.iter_mut().zip(&cells) {
            if *area <= 0.0 {
                *area = cell.area as f32;
            }
        }
        self.cells = Cells {
            tangents: cells.iter().map(|c| c.tangent.as_vec3()).collect(),
            corners: cells.iter().map(|c| c.corners).collect(),
        };
        Ok(())
    }

    /// The segment between two surfels whose blocking decides their visibility: from above one to
    /// above the other, their own cells not in the way.
    pub fn segment(&self, i: usize, j: usize) -> Segment {
        Segment {
            from: self.above(i).to_array(),
            skip_from: i as u32,
            to: self.above(j).to_array(),
            skip_to: j as u32,
        }
    }

    /// Where segments that end at a surfel end: its position, lifted along the normal.
    pub fn above(&self, i: usize) -> Vec3 {
        self.positions[i] + self.normals[i] * self.offsets[i]
    }

    /// The same surfels in another order: entry k of the result is entry `order[k]`.
    pub fn reordered(&self, order: &[u32]) -> Surfels {
        fn pick<T: Copy + Send + Sync>(from: &[T], order: &[u32]) -> Vec<T> {
            order.par_iter().map(|&i| from[i as usize]).collect()
        }
        Surfels {
            origin: self.origin,
            positions: pick(&self.positions, order),
            normals: pick(&self.normals, order),
            areas: pick(&self.areas, order),
            reflectance: pick(&self.reflectance, order),
            emission: pick(&self.emission, order),
            cells: Cells {
                tangents: pick(&self.cells.tangents, order),
                corners: pick(&self.cells.corners, order),
            },
            offsets: pick(&self.offsets, order),
            occluder_scale: self.occluder_scale,
            points: pick(&self.points, order),
        }
    }
}

/// How far the surface can be trusted: the one rule by which cells, occluders and segments follow
/// the cloud's noise.
struct SurfaceRule {
    /// Height of a segment's ends above the surface, in spacings.
    offset: f64,
    /// Scale of a cell as an occluder.
    scale: f64,
    /// Cosine between normals below which two neighbours lie on two sides of a crease.
    crease: f64,
}

impl SurfaceRule {
    /// Clean surfaces keep their corners sharp and their seams tight; noisy ones get room, so
    /// that bumps of the noise cast no shadow.
    fn for_noise(noise: f64) -> SurfaceRule {
        let offset = (4.0 * noise).clamp(0.02, 0.2);
        SurfaceRule {
            offset,
            scale: 1.02 + 0.4 * (offset - 0.02),
            crease: (0.75 - 5.0 * noise).clamp(0.5, 0.75),
        }
    }
}

/// Roughness of the cloud: how far neighbours lie off each other's tangent planes, as a slope.
///
/// For neighbours on a circular arc (n_i + n_j) · (x_j - x_i) = 0 whatever the curvature, so that
/// the mean slope |(n_i + n_j) · d| / 2|d| over near neighbours measures noise of positions and
/// normals alone. The median over a sample of the surfels is taken.
fn noise(surfels: &Surfels, neighbours: impl Fn(usize, &mut Vec<Neighbour>) + Sync) -> f64 {
    let step = surfels.len().div_ceil(20_000);
    let mut slopes: Vec<f64> = (0..surfels.len())
        .into_par_iter()
        .step_by(step)
        .filter_map(|i| {
            let mut near = Vec::with_capacity(NEIGHBOURS);
            neighbours(i, &mut near);
            let normal = surfels.normals[i].as_dvec3();
            let (sum, count) = near
                .iter()
                .filter(|n| n.normal.dot(normal) > 0.7)
                .take(6)
                .map(|n| 0.5 * (normal + n.normal).dot(n.offset).abs() / n.offset.length())
                .fold((0.0, 0), |(s, c), slope| (s + slope, c + 1));
            (count > 0).then(|| sum / count as f64)
        })
        .collect();
    if slopes.is_empty() {
        return 0.0;
    }
    let middle = slopes.len() / 2;
    *slopes.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Usable points as surfels without cells, one a place and side; unknown areas are 0.
fn select(cloud: &PointCloud, repairs: &mut Vec<String>) -> Result<(Surfels, Vec<Option<u32>>)> {
    let placed = |p: DVec3| p.abs().max_element() <= LARGEST;
    let usable = |i: usize| {
        let length = cloud.normals[i].length();
        placed(cloud.positions[i]) && length.is_finite() && length > 0.0
    };
    let (low, high) = (0..cloud.len())
        .filter(|&i| usable(i))
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), i| {
            (low.min(cloud.positions[i]), high.max(cloud.positions[i]))
        });
    let origin = 0.5 * (low + high);
    let mut surfels = Surfels {
        origin,
        ..Surfels::default()
    };
    let mut surfel_of_point = vec![None; cloud.len()];
    let mut places: HashMap<[u32; 3], [Option<u32>; 2]> = HashMap::with_capacity(cloud.len());
    let (mut positions_left_out, mut normals_left_out, mut merged) = (0, 0, 0);
    for i in 0..cloud.len() {
        if !usable(i) {
            if placed(cloud.positions[i]) {
                normals_left_out += 1;
            } else {
                positions_left_out += 1;
            }
            continue;
        }
        let position = (cloud.positions[i] - origin).as_vec3();
        let normal = cloud.normals[i].normalize();
        let area = cloud.areas.get(i).copied().unwrap_or(0.0);
        // + 0.0 makes one of both zeros.
        let place = places
            .entry((position + 0.0).to_array().map(f32::to_bits))
            .or_default();
        let twin = place
            .iter()
            .flatten()
            .find(|&&s| surfels.normals[s as usize].dot(normal) > 0.0);
        if let Some(&s) = twin {
            surfels.areas[s as usize] += area;
            surfel_of_point[i] = Some(s);
            merged += 1;
            continue;
        }
        let s = surfels.len() as u32;
        place[usize::from(place[0].is_some())] = Some(s);
        surfel_of_point[i] = Some(s);
        surfels.positions.push(position);
        surfels.normals.push(normal);
        surfels.areas.push(area);
        surfels.reflectance.push(cloud.reflectance[i]);
        surfels.emission.push(cloud.emission[i]);
        surfels.points.push(i as u32);
    }
    for (count, what) in [
        (
            positions_left_out,
            "points with coordinates that are not finite or beyond 1e12: left out, no light",
        ),
        (
            normals_left_out,
            "points whose normal is zero or not finite: left out, no light",
        ),
        (merged, "points at the place of another one: merged with it"),
    ] {
        if count > 0 {
            repairs.push(format!("{count} {what}"));
        }
    }
    if surfels.is_empty() {
        return Err(Error::Invalid(format!(
            "none of the {} points has finite coordinates and a normal",
            cloud.len()
        )));
    }
    if places.len() < 2 && surfels.areas.iter().any(|&a| a <= 0.0) {
        return Err(Error::Invalid(format!(
            "all {} usable points lie at one place: without neighbours and without areas nothing \
             tells how much surface they stand for",
            surfels.len() + merged
        )));
    }
    Ok((surfels, surfel_of_point))
}
