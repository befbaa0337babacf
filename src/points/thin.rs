//! Fewer points, evenly.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use glam::Vec3;
use rand::Rng;
use rayon::prelude::*;

use crate::error::Result;
use crate::progress::Progress;
use crate::random::{Purpose, stream};

/// Cosine between normals above which points stand for the same piece of surface.
const SAME_SIDE: f32 = 0.5;
/// A choice of this part of the points wanted, or more, is near enough.
const NEAR_ENOUGH: f64 = 0.9;
/// Looks for the spacing that leaves as many points as are wanted.
const LOOKS: usize = 12;

/// For each point the one that stands for it: itself, or the nearest one, nearer than `spacing`, that
/// stands for itself and faces the same way. No two that stand for themselves are as near as that.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
pub(super) fn spread(
    positions: &[Vec3],
    normals: &[Vec3],
    spacing: f32,
    progress: &dyn Progress,
) -> Result<Vec<u32>> {
    Ok(Discs::throw(positions, normals, spacing, progress)?.keepers())
}

/// The same with a spacing that leaves `most` points or a few less.
pub(super) fn spread_to(
    positions: &[Vec3],
    normals: &[Vec3],
    most: usize,
    progress: &dyn Progress,
) -> Result<Vec<u32>> {
    if positions.len() <= most {
        return Ok((0..positions.len() as u32).collect());
    }
    let (min, max) = (positions.iter()).fold((Vec3::MAX, Vec3::MIN), |(min, max), &p| {
        (min.min(p), max.max(p))
    });
    // As if they filled a sphere; then towards what that leaves.
    let mut spacing = (max - min).length() / (most as f32).sqrt();
    let (mut few, mut many) = (None, 0.0);
    for _ in 0..LOOKS {
        let discs = Discs::throw(positions, normals, spacing, progress)?;
        let part = discs.count() as f64 / most as f64;
        if part <= 1.0 {
            few = Some((discs, spacing));
            if part >= NEAR_ENOUGH {
                break;
            }
        } else {
            many = spacing;
        }
        // Points on a surface go with the square; between what was too many and too few.
        let next = spacing * (part / (0.5 + 0.5 * NEAR_ENOUGH)).sqrt() as f32;
        spacing = match few {
            Some((_, few)) if next <= many || next >= few => 0.5 * (many + few),
            _ => next.max(1.01 * many),
        };
    }
    match few {
        Some((discs, _)) => Ok(discs.keepers()),
        None => spread(positions, normals, 2.0 * (max - min).length(), progress),
    }
}

/// Poisson discs: points that were thrown one after the other, and kept if none was kept before that is
/// nearer than the spacing and faces the same way.
///
/// They are thrown in random order within the cells of a grid as wide as the spacing. Cells of one of
/// eight colours are no neighbours, and know nothing of each other: each colour is one parallel step
/// (L.-Y. Wei, "Parallel Poisson disk sampling", 2008).
struct Discs<'a> {
    positions: &'a [Vec3],
    normals: &'a [Vec3],
    spacing: f32,
    /// Cells that are not empty, in ascending order.
    cells: Vec<[i32; 3]>,
    /// First place of each cell's points in `order`, and the number of points at the end.
    begins: Vec<u32>,
    /// Points cell by cell, the kept ones of a cell first.
    order: Vec<AtomicU32>,
    /// How many points of each cell are kept.
    kept: Vec<AtomicU32>,
}

/// A point that is kept, as its neighbours see it.
#[derive(Clone, Copy)]
struct Disc {
    position: Vec3,
    normal: Vec3,
    point: u32,
}

impl<'a> Discs<'a> {
    fn throw(
        positions: &'a [Vec3],
        normals: &'a [Vec3],
        spacing: f32,
        progress: &dyn Progress,
    ) -> Result<Discs<'a>> {
        let mut discs = Discs::sorted(positions, normals, spacing);
        discs.kept = discs.cells.iter().map(|_| AtomicU32::new(0)).collect();
        let colour = |cell: &[i32; 3]| cell.iter().fold(0, |c, x| 2 * c + (x & 1));
        for step in 0..8 {
            progress.check()?;
            (0..discs.cells.len())
                .into_par_iter()
                .filter(|&c| colour(&discs.cells[c]) == step)
                .for_each_init(Vec::new, |near, c| discs.throw_into(c, near));
        }
        Ok(discs)
    }

    /// With nothing thrown yet.
    fn sorted(positions: &'a [Vec3], normals: &'a [Vec3], spacing: f32) -> Discs<'a> {
        // Cells are numbered in 32 bits.
        let extent = positions
            .par_iter()
            .map(|p| p.abs().max_element())
            .reduce(|| 0.0, f32::max);
        let spacing = spacing.max(1e-9 * extent);
        let mut keys: Vec<([i32; 3], u32, u32)> = (0..positions.len())
            .into_par_iter()
            .map(|i| {
                let cell = (positions[i] / spacing).floor().as_ivec3().to_array();
                let random = stream(0, Purpose::Thin, i as u64).next_u32();
                (cell, random, i as u32)
            })
            .collect();
        keys.par_sort_unstable();
        let (mut cells, mut begins) = (Vec::new(), Vec::new());
        for (k, &(cell, ..)) in (0..).zip(&keys) {
            if cells.last() != Some(&cell) {
                cells.push(cell);
                begins.push(k);
            }
        }
        begins.push(positions.len() as u32);
        let order = keys.into_par_iter().map(|(.., i)| AtomicU32::new(i));
        Discs {
            positions,
            normals,
            spacing,
            cells,
            begins,
            order: order.collect(),
            kept: Vec::new(),
        }
    }

    fn points(&self, cell: usize) -> Range<usize> {
        self.begins[cell] as usize..self.begins[cell + 1] as usize
    }

    fn disc(&self, place: usize) -> Disc {
        let point = self.order[place].load(Relaxed);
        Disc {
            position: self.positions[point as usize],
            normal: self.normals[point as usize],
            point,
        }
    }

    /// Distance to a disc that a point is in, if it is.
    fn within(&self, point: &Disc, disc: &Disc) -> Option<f32> {
        let far = disc.position.distance(point.position);
        (far < self.spacing && disc.normal.dot(point.normal) > SAME_SIDE).then_some(far)
    }

    /// Throws the points of a cell; `near` is room for the discs around.
    fn throw_into(&self, cell: usize, near: &mut Vec<Disc>) {
        self.around(cell, near);
        let points = self.points(cell);
        let first = points.start;
        let mut kept = 0;
        for place in points {
            let thrown = self.disc(place);
            if near.iter().all(|disc| self.within(&thrown, disc).is_none()) {
                // The kept ones change places with the others.
                let other = self.order[first + kept].load(Relaxed);
                self.order[place].store(other, Relaxed);
                self.order[first + kept].store(thrown.point, Relaxed);
                kept += 1;
                near.push(thrown);
            }
        }
        self.kept[cell].store(kept as u32, Relaxed);
    }

    /// Puts the discs in a cell and around it into `near`.
    fn around(&self, cell: usize, near: &mut Vec<Disc>) {
        near.clear();
        let [x, y, z] = self.cells[cell];
        for column in [
            [-1, -1],
            [-1, 0],
            [-1, 1],
            [0, -1],
            [0, 0],
            [0, 1],
            [1, -1],
            [1, 0],
            [1, 1],
        ] {
            let [x, y] = [x + column[0], y + column[1]];
            let begin = self.cells.partition_point(|c| *c < [x, y, z - 1]);
            let cells = (begin..self.cells.len()).take_while(|&c| self.cells[c] <= [x, y, z + 1]);
            for c in cells {
                let first = self.begins[c] as usize;
                let kept = self.kept[c].load(Relaxed) as usize;
                near.extend((first..first + kept).map(|place| self.disc(place)));
            }
        }
    }

    fn count(&self) -> usize {
        self.kept.par_iter().map(|k| k.load(Relaxed) as usize).sum()
    }

    /// For each point the nearest disc that it is in.
    fn keepers(&self) -> Vec<u32> {
        let keepers: Vec<AtomicU32> = self.positions.iter().map(|_| AtomicU32::new(0)).collect();
        (0..self.cells.len())
            .into_par_iter()
            .for_each_init(Vec::new, |near, cell| {
                self.around(cell, near);
                let first = self.begins[cell] as usize;
                let kept = self.kept[cell].load(Relaxed) as usize;
                for place in self.points(cell) {
                    let own = self.disc(place);
                    let nearest = near
                        .iter()
                        .filter_map(|disc| Some((self.within(&own, disc)?, disc.point)))
                        .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                    let keeper = match nearest {
                        Some((_, keeper)) if place >= first + kept => keeper,
                        _ => own.point,
                    };
                    keepers[own.point as usize].store(keeper, Relaxed);
                }
            });
        keepers.into_iter().map(AtomicU32::into_inner).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;
    use rand::RngExt;

    /// Two sides of a sheet, ten times as dense on one half of it.
    fn sheet() -> (Vec<Vec3>, Vec<Vec3>) {
        let mut random = stream(1, Purpose::Thin, 0);
        (0..6000)
            .map(|i| {
                let x = 2.0 * random.random::<f32>() - 1.0;
                let x = if i % 11 == 0 { x.abs() } else { -x.abs() };
                let z = if i % 2 == 0 { Vec3::Z } else { Vec3::NEG_Z };
                (Vec3::new(x, random.random(), 1e-3 * z.z), z)
            })
            .unzip()
    }

    #[test]
    fn discs_are_apart_and_all_points_in_one() {
        let (positions, normals) = sheet();
        let spacing = 0.05;
        let keepers = spread(&positions, &normals, spacing, &Silent).unwrap();
        let kept: Vec<usize> = (0..keepers.len())
            .filter(|&i| keepers[i] as usize == i)
            .collect();
        let far = |i: usize, j: usize| match normals[i].dot(normals[j]) > SAME_SIDE {
            true => positions[i].distance(positions[j]),
            false => f32::INFINITY,
        };
        for (k, &i) in kept.iter().enumerate() {
            assert!(kept[..k].iter().all(|&j| far(i, j) >= spacing));
        }
        for (i, &keeper) in keepers.iter().enumerate() {
            let nearest = kept
                .iter()
                .map(|&k| far(i, k))
                .fold(f32::INFINITY, f32::min);
            assert!(nearest < spacing && far(i, keeper as usize) == nearest);
        }
        // Discs of half the spacing fill 0.5 to 0.75 of the plane where there are many points.
        let dense = kept.iter().filter(|&&i| positions[i].x < 0.0).count() as f32;
        let filled = dense * std::f32::consts::PI * 0.25 * spacing * spacing / 2.0;
        assert!((0.45..0.75).contains(&filled), "{filled}");
    }

    #[test]
    fn as_many_as_wanted() {
        let (positions, normals) = sheet();
        for most in [100, 1000, 5999, 6000] {
            let keepers = spread_to(&positions, &normals, most, &Silent).unwrap();
            let kept = (0..).zip(&keepers).filter(|(i, k)| i == *k).count();
            assert!(
                kept <= most && kept as f64 > 0.85 * most as f64,
                "{kept} of {most}"
            );
        }
    }
}
