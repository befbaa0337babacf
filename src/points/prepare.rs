//! From a cloud to surfels: what is repaired, moved, merged and left out.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::cells::{Cell, MAX_EDGES};
use super::fit::Extents;
use super::neighbours::{Last, Neighbour, Neighbours, RUN};
use super::rule::SurfaceRule;
use super::select::select;
use super::smooth::{settled, smoothed};
use super::strays::strays;
use super::thin::{spread, spread_to};
use super::{Cells, PointCloud, Quality, Surfels};
use crate::error::{Error, Result};
use crate::memory;
use crate::octree::morton_codes;
use crate::progress::Progress;
use crate::scene::BRIGHTEST;

/// How many of the points become surfels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Thinning {
    /// Least distance, in the scan's unit, of surfels that face the same way.
    pub spacing: Option<f64>,
    /// Largest number of surfels.
    pub max_points: Option<usize>,
    /// Where neither is told, of a cloud that has many more points than this tolerance needs only as many
    /// are taken: 300,000 at 0.03, and in proportion to its inverse square.
    pub enough_for: Option<f64>,
}

/// Surfels that are enough for a tolerance: in a scanned room 280,000 are off by 2.3%. The error of the
/// model falls with the distance of the points, the root of their number.
pub(super) const ENOUGH: f64 = 3e5;
pub(super) const ENOUGH_FOR: f64 = 0.03;
/// A cloud of up to so many times more is taken as it is.
const LEEWAY: f64 = 1.5;

impl Thinning {
    /// Surfels that a cloud of so many points has at most, if that is known before.
    pub(crate) fn most(&self, points: usize) -> Option<usize> {
        match (self.spacing, self.max_points, self.enough_for) {
            (None, None, Some(tolerance)) => {
                let enough = ENOUGH * (ENOUGH_FOR / tolerance).powi(2).max(1.0);
                (points as f64 > LEEWAY * enough).then_some(enough as usize)
            }
            _ => self.max_points,
        }
    }
}

/// Surfels and how the points of the cloud map to them.
pub struct Prepared {
    pub surfels: Surfels,
    /// For each point of the cloud the surfel whose light it gets, if any.
    pub surfel_of_point: Vec<Option<u32>>,
    /// What was left out or merged, with counts.
    pub repairs: Vec<String>,
    /// How good the cloud is as a surface.
    pub quality: Quality,
    /// Areas of the surfels in the cloud; 0 where it has none.
    pub(super) given_areas: Vec<f32>,
    /// Of fitted surfels: no other one of the same surface is nearer, and no cell much wider.
    pub(super) sizes: Vec<f32>,
    pub(super) extents: Extents,
    /// What the cells are made by.
    pub(super) rule: SurfaceRule,
    /// Distance of the farthest neighbour that a cell is made from.
    pub(super) reach: Vec<f32>,
}

/// Cells made between two looks at whether the work should stop.
pub(super) const BLOCK: usize = 1 << 16;
/// Neighbours that a cell is made from.
pub(super) const NEIGHBOURS: usize = 24;
/// Times that points are moved at most.
const MOVES: usize = 3;
/// Surfels among which the one is looked for whose light a point gets that was left out.
const HEIRS: usize = 8;

impl Surfels {
    /// The surfels of a cloud whose points have normals: unusable points left out, points at one place merged, points and normals
    /// that scatter smoothed, strays left out, cells made, areas taken from the cloud or else from the
    /// cells.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a cloud without points or normals
    /// ([`PointCloud::estimate_normals`] makes them), or that no reader would hand over;
    /// [`Error::TooLarge`] for one that cannot be lit in the memory that is free.
    pub fn prepare(cloud: &PointCloud, progress: &dyn Progress) -> Result<Prepared> {
        Surfels::prepare_fewer(cloud, &Thinning::default(), progress)
    }

    /// The same of fewer points, evenly spread: the others take their light from them.
    ///
    /// # Errors
    /// Those of [`prepare`](Surfels::prepare).
    pub fn prepare_fewer(
        cloud: &PointCloud,
        thinning: &Thinning,
        progress: &dyn Progress,
    ) -> Result<Prepared> {
        if cloud.is_empty() {
            return Err(Error::Invalid("the cloud has no points".into()));
        }
        if thinning.spacing.is_none() {
            let most = thinning.most(cloud.len()).unwrap_or(cloud.len());
            memory::check_points(most.min(cloud.len()) as u64)?;
        }
        if cloud.normals.is_empty() {
            return Err(Error::Invalid(
                "the cloud has no normals: they must be estimated first".into(),
            ));
        }
        check(cloud)?;
        let mut repairs = cloud.repairs.clone();
        let (surfels, surfel_of_point) = select(cloud, &mut repairs)?;
        let unusable = surfel_of_point.iter().filter(|s| s.is_none()).count();
        let mut prepared = Prepared {
            quality: Quality {
                unusable,
                duplicates: cloud.len() - unusable - surfels.len(),
                ..Quality::default()
            },
            given_areas: surfels.areas.clone(),
            rule: SurfaceRule::default(),
            reach: vec![0.0; surfels.len()],
            sizes: Vec::new(),
            extents: Extents::default(),
            surfels,
            surfel_of_point,
            repairs,
        };
        prepared.quality.count(cloud);
        prepared.thin(thinning, progress)?;
        memory::check_points(prepared.surfels.len() as u64)?;
        let strays = prepared.make_cells(progress)?;
        if !strays.is_empty() {
            prepared.quality.strays = strays.len();
            prepared.leave_out(&strays)?;
            prepared.repairs.push(format!(
                "{} points that belong to no surface: lit, but in nobody's way",
                prepared.quality.strays
            ));
        }
        prepared.quality.measure(&prepared.surfels);
        Ok(prepared)
    }
}

impl Surfels {
    /// Cells and what follows from them, still empty.
    pub(super) fn make_room(&mut self, occluder_scale: f32) {
        let n = self.len();
        self.occluder_scale = occluder_scale;
        self.areas = vec![0.0; n];
        self.offsets = vec![0.0; n];
        self.depths = vec![0.0; n];
        self.cells = Cells {
            tangents: vec![Vec3::ZERO; n],
            corners: vec![[Vec2::ZERO; MAX_EDGES]; n],
        };
    }
}

impl Prepared {
    /// Whether the surfels were fitted to the points.
    pub fn is_fitted(&self) -> bool {
        !self.sizes.is_empty()
    }

    /// For each point of the cloud its surfel's place among `surfels`, which are the prepared ones
    /// in any order.
    pub fn places(&self, surfels: &Surfels) -> Vec<Option<u32>> {
        let mut place_of_point = vec![0; self.surfel_of_point.len()];
        // Of two at one place either will do.
        for (place, &point) in surfels.points.iter().enumerate() {
            place_of_point[point as usize] = place as u32;
        }
        let own_point = |s: u32| self.surfels.points[s as usize] as usize;
        let place = |surfel: &Option<u32>| surfel.map(|s| place_of_point[own_point(s)]);
        self.surfel_of_point.iter().map(place).collect()
    }

    /// Leaves surfels out of the transport that are [`buried`](super::buried), given as numbers of their
    /// points.
    ///
    /// # Errors
    /// Those of [`Surfels::prepare`].
    pub fn leave_out_buried(&mut self, points: &[u32]) -> Result<()> {
        let mut is_buried = vec![false; self.surfel_of_point.len()];
        points.iter().for_each(|&p| is_buried[p as usize] = true);
        let of_surfel = |&s: &u32| is_buried[self.surfels.points[s as usize] as usize];
        let buried: Vec<u32> = (0..self.surfels.len() as u32).filter(of_surfel).collect();
        if buried.len() == self.surfels.len() {
            return Ok(());
        }
        self.quality.buried = buried.len();
        self.repairs.push(format!(
            "{} points inside of bodies or behind walls: lit, but in nobody's way",
            buried.len()
        ));
        self.leave_out(&buried)?;
        self.quality.measure(&self.surfels);
        Ok(())
    }

    /// Surfels that take no part: their points get the light of the nearest one that faces the same way,
    /// or of the nearest. All stay if none would.
    fn leave_out(&mut self, out: &[u32]) -> Result<()> {
        let n = self.surfels.len();
        if out.is_empty() || out.len() == n {
            return Ok(());
        }
        let mut heirs: Vec<u32> = (0..n as u32).collect();
        let mut stays = vec![true; n];
        out.iter().for_each(|&i| stays[i as usize] = false);
        let kept: Vec<u32> = (0..n as u32).filter(|&i| stays[i as usize]).collect();
        let (positions, normals) = (&self.surfels.positions, &self.surfels.normals);
        let places: Vec<Vec3> = kept.iter().map(|&i| positions[i as usize]).collect();
        let neighbours = Neighbours::new(&places)?;
        let heir = |&i: &u32| {
            let i = i as usize;
            let near = neighbours.around(positions[i], HEIRS);
            let same_side = |k: &&u32| normals[kept[**k as usize] as usize].dot(normals[i]) > 0.0;
            let heir = near.iter().find(same_side).or(near.first());
            heir.map_or(i as u32, |&k| kept[k as usize])
        };
        let found: Vec<u32> = out.par_iter().map(heir).collect();
        out.iter()
            .zip(found)
            .for_each(|(&i, heir)| heirs[i as usize] = heir);
        let gone: Vec<Vec3> = out.iter().map(|&i| positions[i as usize]).collect();
        self.hand_over(&heirs);
        self.mend_cells(&gone)
    }

    /// As few surfels as are asked for, or are enough; those that go leave their areas, colours and normals
    /// to those that stay.
    fn thin(&mut self, thinning: &Thinning, progress: &dyn Progress) -> Result<()> {
        let Surfels {
            positions, normals, ..
        } = &self.surfels;
        let n = positions.len();
        let most = thinning.most(n).filter(|&most| most < n);
        if most.is_none() && thinning.spacing.is_none() {
            return Ok(());
        }
        progress.stage("thinning", 1);
        let mut heirs: Vec<u32> = match thinning.spacing {
            Some(spacing) => spread(positions, normals, spacing as f32, progress)?,
            None => (0..n as u32).collect(),
        };
        let staying = |heirs: &[u32]| (0..).zip(heirs).filter(|(i, h)| i == *h).count();
        if let Some(most) = most.filter(|&most| most < staying(&heirs)) {
            heirs = spread_to(positions, normals, most, progress)?;
        }
        let stay = staying(&heirs);
        if stay == n {
            return Ok(());
        }
        self.quality.thinned = n - stay;
        let why = match (thinning.spacing, thinning.max_points, thinning.enough_for) {
            (None, None, Some(tolerance)) => format!(
                "{stay} others are enough for a tolerance of {tolerance} (--max-points N takes up to N)"
            ),
            _ => format!("as was asked for, to {stay} others"),
        };
        self.repairs.push(format!(
            "{} points thinned out, {why}: they take the light of those around them",
            n - stay
        ));
        self.bequeath(&heirs, stay);
        self.hand_over(&heirs);
        Ok(())
    }

    /// Gives areas and the means of colours and normals to the heirs, `stay` of which are their own.
    fn bequeath(&mut self, heirs: &[u32], stay: usize) {
        #[derive(Clone, Default)]
        struct Sums {
            reflectance: Vec3,
            emission: Vec3,
            normal: Vec3,
            area: f32,
            count: f32,
        }
        let mut place = vec![0; heirs.len()];
        let own = (0..heirs.len()).filter(|&i| heirs[i] as usize == i);
        own.zip(0..).for_each(|(i, k)| place[i] = k);
        let mut sums = vec![Sums::default(); stay];
        for (i, &heir) in heirs.iter().enumerate() {
            let sums = &mut sums[place[heir as usize] as usize];
            sums.reflectance += self.surfels.reflectance[i];
            sums.emission += self.surfels.emission[i];
            sums.normal += self.surfels.normals[i];
            sums.area += self.given_areas[i];
            sums.count += 1.0;
        }
        let own = (0..heirs.len()).filter(|&i| heirs[i] as usize == i);
        for (i, sums) in own.zip(sums) {
            self.surfels.reflectance[i] = sums.reflectance / sums.count;
            self.surfels.emission[i] = sums.emission / sums.count;
            self.surfels.normals[i] = sums.normal.normalize_or(self.surfels.normals[i]);
            self.given_areas[i] = sums.area;
        }
    }

    /// Keeps the surfels that are their own heirs; the points of the others go to theirs.
    fn hand_over(&mut self, heirs: &[u32]) {
        let kept: Vec<u32> = (0..heirs.len() as u32)
            .filter(|&i| heirs[i as usize] == i)
            .collect();
        let mut place = vec![0; heirs.len()];
        for (k, &i) in (0..).zip(&kept) {
            place[i as usize] = k;
        }
        for surfel in self.surfel_of_point.iter_mut().flatten() {
            *surfel = place[heirs[*surfel as usize] as usize];
        }
        let of_kept = |all: &[f32]| kept.iter().map(|&i| all[i as usize]).collect();
        self.given_areas = of_kept(&self.given_areas);
        self.reach = of_kept(&self.reach);
        self.surfels = self.surfels.reordered(&kept);
    }

    /// Points and normals that scatter are smoothed; then cells, missing areas, offsets. Returns the
    /// indices of strays.
    fn make_cells(&mut self, progress: &dyn Progress) -> Result<Vec<u32>> {
        let surfels = &mut self.surfels;
        let n = surfels.len();
        progress.stage("cells", n as u64);
        let mut positions = std::mem::take(&mut surfels.positions);
        let mut neighbours = Neighbours::new(&positions)?;
        let mut rule = SurfaceRule::measure(&surfels.normals, &neighbours);
        let scattered = rule.noise;
        self.quality.noise = rule.noise;
        self.quality.scatter = rule.roughness.atan().to_degrees();
        for _ in 0..MOVES {
            let Some(moved) = settled(&positions, &surfels.normals, &neighbours, &rule) else {
                break;
            };
            drop(neighbours);
            positions = moved;
            neighbours = Neighbours::new(&positions)?;
            rule = SurfaceRule::measure(&surfels.normals, &neighbours);
        }
        if rule.noise < scattered {
            self.repairs.push(format!(
                "points that scatter about their surface: moved onto it, from {scattered:.2} to {:.2} \
                 spacings off",
                rule.noise
            ));
        }
        if let Some((normals, smoother)) = smoothed(&surfels.normals, &neighbours, &rule) {
            self.repairs.push(format!(
                "normals that scatter: smoothed, from {:.1} to {:.1} degrees off the positions",
                rule.roughness.atan().to_degrees(),
                smoother.roughness.atan().to_degrees()
            ));
            (surfels.normals, rule) = (normals, smoother);
        }
        self.rule = rule;
        let mut cells = vec![Cell::default(); n];
        for block in along_curve(&positions).chunks(BLOCK) {
            progress.check()?;
            for (i, cell) in self.cells_of(&neighbours, block) {
                cells[i as usize] = cell;
            }
            progress.advance(block.len() as u64);
        }
        let mut strays = strays(&positions, &neighbours, &cells, self.rule.roughness)?;
        drop(neighbours);
        let surfels = &mut self.surfels;
        surfels.positions = positions;
        // A lamp may be as small as a point.
        strays.retain(|&i| surfels.emission[i as usize] == Vec3::ZERO);
        surfels.make_room(self.rule.scale as f32);
        cells
            .iter()
            .enumerate()
            .for_each(|(i, cell)| self.set(i, cell));
        Ok(strays)
    }

    /// Makes the cells anew of which a neighbour is gone: those places are theirs now.
    fn mend_cells(&mut self, gone: &[Vec3]) -> Result<()> {
        let positions = std::mem::take(&mut self.surfels.positions);
        let holes = Neighbours::new(gone)?;
        let next_to_hole = |&i: &u32| {
            let place = positions[i as usize];
            let nearest = holes.around(place, 1);
            nearest
                .iter()
                .any(|&k| gone[k as usize].distance(place) <= self.reach[i as usize])
        };
        let torn = along_curve(&positions).into_par_iter();
        let torn: Vec<u32> = torn.filter(next_to_hole).collect();
        let neighbours = Neighbours::new(&positions)?;
        let cells = self.cells_of(&neighbours, &torn);
        drop(neighbours);
        self.surfels.positions = positions;
        for (i, cell) in &cells {
            self.set(*i as usize, cell);
        }
        Ok(())
    }

    /// Cells of some surfels, with whose they are; those that follow one another should lie close together.
    fn cells_of(&self, neighbours: &Neighbours, which: &[u32]) -> Vec<(u32, Cell)> {
        let normals = &self.surfels.normals;
        let of_run = |near: &mut Vec<Neighbour>, run: &[u32]| {
            let mut last = Last::default();
            let cell = |&i: &u32| {
                let k = i as usize;
                neighbours.find(k, NEIGHBOURS, normals, &mut last, near);
                let size = f64::from(self.given_areas[k]).max(0.0).sqrt();
                (
                    i,
                    Cell::new(
                        normals[k].as_dvec3(),
                        near,
                        &self.rule,
                        size,
                        f64::INFINITY,
                        None,
                    ),
                )
            };
            run.iter().map(cell).collect::<Vec<_>>()
        };
        let runs = which.par_chunks(RUN).map_init(Vec::new, of_run);
        runs.flatten_iter().collect()
    }

    /// Gives a surfel its cell and what follows from it.
    pub(super) fn set(&mut self, i: usize, cell: &Cell) {
        let surfels = &mut self.surfels;
        let given = self.given_areas[i];
        surfels.areas[i] = if given > 0.0 { given } else { cell.area as f32 };
        surfels.offsets[i] = (self.rule.offset * cell.spacing) as f32;
        surfels.depths[i] = cell.depth as f32;
        surfels.cells.tangents[i] = cell.tangent.as_vec3();
        surfels.cells.corners[i] = cell.corners;
        self.reach[i] = cell.reach as f32;
    }
}

/// All places along a Morton curve: those that follow one another are close together.
pub(super) fn along_curve(positions: &[Vec3]) -> Vec<u32> {
    let mut keys: Vec<(u64, u32)> = morton_codes(positions)
        .zip(0..positions.len() as u32)
        .collect();
    keys.par_sort_unstable();
    keys.into_par_iter().map(|(_, i)| i).collect()
}

/// Refuses a cloud, made by a program, that no reader would hand over: arrays of the wrong length,
/// light and material that do not exist.
pub(crate) fn check(cloud: &PointCloud) -> Result<()> {
    let n = cloud.len();
    let optional = |length: usize| if length == 0 { n } else { length };
    for (what, length) in [
        ("normals", optional(cloud.normals.len())),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_more_points_than_a_tolerance_needs() {
        let enough_for = |tolerance| Thinning {
            enough_for: Some(tolerance),
            ..Thinning::default()
        };
        assert_eq!(enough_for(0.03).most(10_000_000), Some(300_000));
        assert_eq!(enough_for(0.3).most(10_000_000), Some(300_000));
        assert_eq!(enough_for(0.03).most(440_000), None);
        assert_eq!(enough_for(0.01).most(4_000_000), None);
        assert_eq!(enough_for(0.015).most(10_000_000), Some(1_200_000));
        // What is told counts.
        let told = Thinning {
            max_points: Some(3_000_000),
            ..enough_for(0.03)
        };
        assert_eq!(told.most(10_000_000), Some(3_000_000));
        let told = Thinning {
            spacing: Some(0.01),
            ..enough_for(0.03)
        };
        assert_eq!(told.most(10_000_000), None);
        assert_eq!(Thinning::default().most(10_000_000), None);
    }
}
