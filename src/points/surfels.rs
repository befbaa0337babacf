//! Surfels: points as small pieces of surface, as structure of arrays.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::cells::Cell;
use super::neighbours::Neighbours;
use super::rule::SurfaceRule;
use super::select::select;
use super::smooth::smoothed;
use super::{Cells, PointCloud};
use crate::error::{Error, Result};
use crate::memory;
use crate::progress::Progress;
use crate::scene::BRIGHTEST;
use crate::visibility::{NO_SURFEL, Segment};

/// The points that take part in the transport.
///
/// Positions are in the scan's unit, relative to `origin`; normals are of unit length; all arrays
/// have one entry a surfel.
#[derive(Clone, Debug, Default)]
pub struct Surfels {
    /// Middle of the cloud (component-wise median), in the scan's coordinates.
    pub origin: DVec3,
    /// Centres, relative to `origin`.
    pub positions: Vec<Vec3>,
    /// Unit normals; smoothed, where those of the cloud scatter.
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
    /// How far below their surfel the cells block light. On a convex surface tangent planes stand out,
    /// and a body of such cells would throw too large a shadow: the cells are sunk until their corners
    /// lie on the surface.
    pub depths: Vec<f32>,
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

impl Prepared {
    /// For each point of the cloud its surfel's place among `surfels`, which are the prepared ones
    /// in any order.
    pub fn places(&self, surfels: &Surfels) -> Vec<Option<u32>> {
        let mut place_of_point = vec![0; self.surfel_of_point.len()];
        for (place, &point) in surfels.points.iter().enumerate() {
            place_of_point[point as usize] = place as u32;
        }
        let own_point = |s: u32| self.surfels.points[s as usize] as usize;
        let place = |surfel: &Option<u32>| surfel.map(|s| place_of_point[own_point(s)]);
        self.surfel_of_point.iter().map(place).collect()
    }
}

/// Cells made between two looks at whether the work should stop.
const BLOCK: usize = 1 << 16;
/// Neighbours that a cell is made from.
const NEIGHBOURS: usize = 24;

impl Surfels {
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// The surfels of a cloud: unusable points left out, points at one place merged, normals that
    /// scatter smoothed, cells made, areas taken from the cloud or else from the cells.
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
        check(cloud)?;
        let mut repairs = cloud.repairs.clone();
        let (mut surfels, surfel_of_point) = select(cloud, &mut repairs)?;
        surfels.make_cells(&mut repairs, progress)?;
        Ok(Prepared {
            surfels,
            surfel_of_point,
            repairs,
        })
    }

    /// Cells, missing areas, offsets; normals that scatter are smoothed.
    fn make_cells(&mut self, repairs: &mut Vec<String>, progress: &dyn Progress) -> Result<()> {
        let n = self.len();
        progress.stage("cells", n as u64);
        let neighbours = Neighbours::new(&self.positions)?;
        let mut rule = SurfaceRule::measure(&self.normals, &neighbours);
        if let Some((normals, smoother)) = smoothed(&self.normals, &neighbours, &rule) {
            repairs.push(format!(
                "normals that scatter: smoothed, from {:.1} to {:.1} degrees off the positions",
                rule.roughness.atan().to_degrees(),
                smoother.roughness.atan().to_degrees()
            ));
            (self.normals, rule) = (normals, smoother);
        }
        let mut cells: Vec<Cell> = Vec::with_capacity(n);
        while cells.len() < n {
            progress.check()?;
            let block = cells.len()..(cells.len() + BLOCK).min(n);
            let made = block.len() as u64;
            cells.par_extend(block.into_par_iter().map_init(
                || Vec::with_capacity(NEIGHBOURS),
                |near, i| {
                    neighbours.find(i, NEIGHBOURS, &self.normals, near);
                    let size = f64::from(self.areas[i]).max(0.0).sqrt();
                    Cell::new(self.normals[i].as_dvec3(), near, &rule, size)
                },
            ));
            progress.advance(made);
        }
        self.occluder_scale = rule.scale as f32;
        self.offsets = cells
            .iter()
            .map(|c| (rule.offset * c.spacing) as f32)
            .collect();
        self.depths = cells.iter().map(|c| c.depth as f32).collect();
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

    /// A segment from above a surfel to anywhere, its own cell not in the way.
    pub fn ray(&self, i: usize, way: Vec3) -> Segment {
        let from = self.above(i);
        Segment {
            from: from.to_array(),
            skip_from: i as u32,
            to: (from + way).to_array(),
            skip_to: NO_SURFEL,
        }
    }

    /// Length at which a ray from any surfel has left the cloud and all cells.
    pub fn reach(&self) -> f32 {
        let corner = |i: usize| {
            let corners = self.cells.corners[i].iter().map(|c| c.length());
            corners.fold(0.0, f32::max)
        };
        let farthest = |i: usize| {
            let cell = self.occluder_scale * corner(i) + self.depths[i];
            self.positions[i].length() + cell.max(self.offsets[i])
        };
        let all = (0..self.len()).into_par_iter().map(farthest);
        2.0 * all.reduce(|| 0.0, f32::max)
    }

    /// Where segments that end at a surfel end: its position, lifted along the normal.
    pub fn above(&self, i: usize) -> Vec3 {
        self.positions[i] + self.normals[i] * self.offsets[i]
    }

    /// Middle of the surfel's cell as an occluder.
    pub fn below(&self, i: usize) -> Vec3 {
        self.positions[i] - self.normals[i] * self.depths[i]
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
            depths: pick(&self.depths, order),
            occluder_scale: self.occluder_scale,
            points: pick(&self.points, order),
        }
    }
}

/// Refuses a cloud, made by a program, that no reader would hand over: arrays of the wrong length,
/// light and material that do not exist.
pub(crate) fn check(cloud: &PointCloud) -> Result<()> {
    let n = cloud.len();
    let optional = |length: usize| if length == 0 { n } else { length };
    for (what, length) in [
        ("normals", cloud.normals.len()),
        ("reflectances", cloud.reflectance.len()),
        ("emissions", cloud.emission.len()),
        ("areas", optional(cloud.areas.len())),
    ] {
        if length != n {
            return Err(Error::Invalid(format!(
                "{n} points, but {length} {what}: one a point is needed"
            )));
        }
    }
    let within =
        |v: &Vec3, most: f32| v.cmpge(Vec3::ZERO).all() && v.cmple(Vec3::splat(most)).all();
    let bad_reflectance = cloud.reflectance.iter().position(|r| !within(r, 1.0));
    let bad_emission = cloud.emission.iter().position(|e| !within(e, BRIGHTEST));
    if let Some(i) = bad_reflectance {
        let value = cloud.reflectance[i];
        return Err(Error::Invalid(format!(
            "point {i} has reflectance {value}: each channel must lie between 0 and 1"
        )));
    }
    if let Some(i) = bad_emission {
        let value = cloud.emission[i];
        return Err(Error::Invalid(format!(
            "point {i} has emission {value}: each channel must be finite and not negative"
        )));
    }
    Ok(())
}
