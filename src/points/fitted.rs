//! Surfels of a scan: a surface that is fitted to its points, and the cells of that.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::cells::{Cell, MAX_EDGES};
use super::fit::{Evidence, fit};
use super::neighbours::{Last, Neighbour, Neighbours, RUN};
use super::prepare::{BLOCK, ENOUGH, ENOUGH_FOR, NEIGHBOURS, along_curve, check};
use super::rule::SurfaceRule;
use super::select::middle;
use super::{Facing, PointCloud, Prepared, Quality, Surfels, Thinning};
use crate::error::Result;
use crate::memory;
use crate::progress::Progress;
use crate::visibility::NO_SURFEL;

/// Surfels that are wanted of a cloud that is not thinned out.
const ALL: usize = usize::MAX;

/// Neighbours that rise less than this part of their distance go on in the plane of a surfel.
const FLAT: f64 = 0.3;

/// Surfels at edges are moved to the middle of their points: the farthest corner of one may be so many sizes away.
const WIDEST: f64 = 1.4;

/// Normals point inward or outward as a whole if this part of the ways from the middle goes along them.
const SIDED: f64 = 0.01;

/// Where so many of the points have normals, these are taken as they are.
const MOST: f64 = 0.5;

impl Thinning {
    /// Surfels that a fitted surface has at most.
    fn wanted(&self) -> usize {
        match (self.max_points, self.enough_for) {
            (Some(most), _) => most,
            (None, Some(tolerance)) => {
                (ENOUGH * (ENOUGH_FOR / tolerance).powi(2).max(1.0)) as usize
            }
            (None, None) => ALL,
        }
    }
}

impl Surfels {
    /// The surfels of a scan: those of a surface that is fitted to its points, if most of them have no
    /// normals, and else [the points themselves](Surfels::prepare).
    ///
    /// # Errors
    /// Those of [`prepare`](Surfels::prepare), and [`Error::Invalid`] for points that make no surface.
    pub fn of_scan(
        cloud: &PointCloud,
        evidence: &Evidence,
        thinning: &Thinning,
        progress: &dyn Progress,
    ) -> Result<Prepared> {
        check(cloud)?;
        let known = (cloud.normals.par_iter())
            .filter(|n| has_direction(n))
            .count();
        if cloud.is_empty() || known > 0 && known as f64 >= MOST * cloud.len() as f64 {
            let filled = (known < cloud.len())
                .then(|| filled(cloud, known))
                .transpose()?;
            let cloud = filled.as_ref().unwrap_or(cloud);
            let turned = turned(cloud, &evidence.facing);
            return Surfels::prepare_fewer(turned.as_ref().unwrap_or(cloud), thinning, progress);
        }
        let most = thinning.wanted();
        memory::check_points(most.min(cloud.len()) as u64)?;
        let fitted = fit(cloud, evidence, thinning.spacing, most, progress)?;
        let n = fitted.surfels.len();
        let mut prepared = Prepared {
            quality: Quality {
                unusable: fitted.unplaced,
                strays: fitted.strays,
                unsure: fitted.unsure,
                round: fitted.round,
                ..Quality::default()
            },
            given_areas: vec![0.0; n],
            rule: SurfaceRule::default(),
            reach: vec![0.0; n],
            repairs: cloud.repairs.clone(),
            sizes: fitted.sizes,
            extents: fitted.extents,
            surfels: fitted.surfels,
            surfel_of_point: fitted.surfel_of_point,
        };
        prepared.quality.count(cloud);
        prepared.tell(fitted.how);
        prepared.make_fitted_cells(progress)?;
        prepared.quality.measure(&prepared.surfels);
        Ok(prepared)
    }

    /// Gives a surfel the cell of the one at the same place that faces the other way.
    fn mirror(&mut self, of: usize, to: usize) {
        self.areas[to] = self.areas[of];
        self.offsets[to] = self.offsets[of];
        self.depths[to] = self.depths[of];
        self.cells.tangents[to] = self.cells.tangents[of];
        let corners = self.cells.corners[of];
        // The bitangent is the opposite one, so that corners go round the other way.
        let last = MAX_EDGES - 1;
        let count = (0..last)
            .position(|k| corners[k] == corners[last])
            .unwrap_or(last)
            + 1;
        self.cells.corners[to] = std::array::from_fn(|k| {
            let corner = corners[count - 1 - k.min(count - 1)];
            Vec2::new(corner.x, -corner.y)
        });
    }
}

fn has_direction(normal: &Vec3) -> bool {
    normal.is_finite() && *normal != Vec3::ZERO
}

/// The cloud where each point without a normal has that of the nearest one with a normal.
fn filled(cloud: &PointCloud, known: usize) -> Result<PointCloud> {
    let placed = |i: &usize| cloud.is_placed(*i);
    let with: Vec<usize> = (0..cloud.len())
        .filter(|i| has_direction(&cloud.normals[*i]) && placed(i))
        .collect();
    let Some(&first) = with.first() else {
        return Ok(cloud.clone());
    };
    let origin = cloud.positions[first];
    let places: Vec<Vec3> = (with.iter())
        .map(|&i| (cloud.positions[i] - origin).as_vec3())
        .collect();
    let tree = Neighbours::new(&places)?;
    let mut filled = cloud.clone();
    for i in (0..cloud.len()).filter(|i| !has_direction(&cloud.normals[*i]) && placed(i)) {
        let nearest = tree.around((cloud.positions[i] - origin).as_vec3(), 1);
        if let Some(&k) = nearest.first() {
            filled.normals[i] = cloud.normals[with[k as usize]];
        }
    }
    filled.repairs.push(format!(
        "{} points without normals: they have those of the nearest points",
        cloud.len() - known
    ));
    Ok(filled)
}

/// The cloud with all its normals turned, if as a whole they do not point inward or outward as told.
fn turned(cloud: &PointCloud, facing: &Facing) -> Option<PointCloud> {
    let (outward, told) = match facing {
        Facing::Inward => (false, "inward"),
        Facing::Outward => (true, "outward"),
        _ => return None,
    };
    let middle = middle(cloud, |i| cloud.is_placed(i))?;
    let (flow, most) = (0..cloud.len())
        .filter(|&i| cloud.is_placed(i))
        .map(|i| {
            let normal = cloud.normals[i].as_dvec3().normalize_or_zero();
            (cloud.positions[i] - middle, normal)
        })
        .fold((0.0, 0.0), |(flow, most), (way, normal)| {
            (flow + way.dot(normal), most + way.length())
        });
    // Of a plane neither side is the inner one.
    if flow.abs() <= SIDED * most || (flow > 0.0) == outward {
        return None;
    }
    let mut turned = cloud.clone();
    turned
        .normals
        .iter_mut()
        .for_each(|normal| *normal = -*normal);
    turned.repairs.push(format!(
        "normals of the file: turned {told}, as was asked for"
    ));
    Some(turned)
}

impl Prepared {
    /// What was done, in words.
    fn tell(&mut self, how: &str) {
        let fronts = self.given_areas.len()
            - self
                .surfels
                .backs
                .iter()
                .filter(|b| **b != NO_SURFEL)
                .count()
                / 2;
        self.repairs.push(format!(
            "no normals: a surface of {fronts} surfels fitted to the points, {how}; how far it is off the true one \
             is not in the error of the equation"
        ));
        for (part, what) in [
            (
                self.quality.unsure,
                "lit on both, points get the brighter light",
            ),
            (self.quality.round, "round and thin, so lit from outside"),
        ] {
            if part > 0.0 {
                let percent = 100.0 * part;
                self.repairs.push(format!(
                    "{percent:.1}% of the surface: nothing says which side is lit: {what}"
                ));
            }
        }
        for (count, what) in [
            (
                self.quality.unusable,
                "points with coordinates that are not finite or beyond 1e12: left out, no light",
            ),
            (
                self.quality.strays,
                "points that belong to no surface: lit, but in nobody's way",
            ),
        ] {
            if count > 0 {
                self.repairs.push(format!("{count} {what}"));
            }
        }
    }

    /// Cells, areas and offsets of fitted surfels. Where two are at one place, both have one cell.
    fn make_fitted_cells(&mut self, progress: &dyn Progress) -> Result<()> {
        let n = self.surfels.len();
        let is_front = |&i: &usize| self.surfels.back(i).is_none_or(|back| i < back);
        let fronts: Vec<u32> = (0..n).filter(is_front).map(|i| i as u32).collect();
        progress.stage("cells", fronts.len() as u64);
        let positions: Vec<Vec3> = fronts
            .iter()
            .map(|&i| self.surfels.positions[i as usize])
            .collect();
        let neighbours = Neighbours::new(&positions)?;
        let normals: Vec<Vec3> = fronts
            .iter()
            .map(|&i| self.surfels.normals[i as usize])
            .collect();
        self.rule = SurfaceRule::measure(&normals, &neighbours);
        self.quality.noise = self.rule.noise;
        self.quality.scatter = self.rule.roughness.atan().to_degrees();
        self.surfels.make_room(self.rule.scale as f32);
        let mut along: Vec<u32> = along_curve(&positions);
        for block in along.chunks_mut(BLOCK) {
            progress.check()?;
            let of_run = |near: &mut (Vec<(u32, DVec3)>, Vec<Neighbour>), run: &[u32]| {
                let mut last = Last::default();
                let cell = |&k: &u32| {
                    let (k, i) = (k as usize, fronts[k as usize]);
                    neighbours.next_nearest(k, NEIGHBOURS, &mut last, &mut near.0);
                    let normal = normals[k].as_dvec3();
                    let both = self.surfels.back(i as usize).is_some();
                    near.1.clear();
                    near.1.extend(near.0.iter().map(|&(j, offset)| {
                        let other = normals[j as usize].as_dvec3();
                        let either =
                            both || self.surfels.back(fronts[j as usize] as usize).is_some();
                        let flat = offset.dot(normal).abs() < FLAT * offset.length();
                        let turned = either && flat && other.dot(normal) < 0.0;
                        Neighbour {
                            offset,
                            normal: if turned { -other } else { other },
                        }
                    }));
                    let size = f64::from(self.sizes[i as usize]);
                    let end = |way: DVec3| f64::from(self.extents.reach(i as usize, way.as_vec3()));
                    (
                        i,
                        Cell::new(normal, &near.1, &self.rule, size, WIDEST * size, Some(&end)),
                    )
                };
                run.iter().map(cell).collect::<Vec<_>>()
            };
            let made: Vec<(u32, Cell)> = block
                .par_chunks(RUN)
                .map_init(Default::default, of_run)
                .flatten_iter()
                .collect();
            for (i, cell) in &made {
                self.set(*i as usize, cell);
            }
            progress.advance(block.len() as u64);
        }
        for i in 0..n {
            if let Some(back) = self.surfels.back(i).filter(|&back| i < back) {
                self.surfels.depths[i] = 0.0;
                self.surfels.mirror(i, back);
            }
        }
        Ok(())
    }
}
