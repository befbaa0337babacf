//! Cells of space: cubes within the octree's common cube, numbered along a Morton curve.

use glam::{DVec3, UVec3, Vec3};
use rayon::prelude::*;

/// Levels that a Morton code tells apart: bits an axis.
pub(super) const MORTON_LEVELS: u32 = 21;

/// A cube of the octree. Its side is that of the common cube, halved `level` times.
///
/// Where even the finest cubes of the Morton code (level 21) hold too many surfels, these part in
/// halves, which are no cubes: their level goes on, their corner stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    pub level: u32,
    /// Lowest corner, in cubes of the finest level.
    pub corner: UVec3,
}

impl Cell {
    /// The cell of a level that holds what has this Morton code.
    pub(super) fn of(code: u64, level: u32) -> Cell {
        let corner = UVec3::new(compact(code), compact(code >> 1), compact(code >> 2));
        let finest = Cell {
            level: level.max(MORTON_LEVELS),
            corner,
        };
        finest.ancestor(level)
    }

    /// The cell of this level around it; itself if it is as large or larger.
    pub fn ancestor(self, level: u32) -> Cell {
        let level = level.min(self.level);
        Cell {
            level,
            corner: self.corner & (u32::MAX << finer_levels(level)),
        }
    }

    /// Whether two cells have a point in common, on the boundary or within. Of two halves it is not
    /// known: false.
    pub fn touches(self, other: Cell) -> bool {
        if self.level.min(other.level) > MORTON_LEVELS {
            return false;
        }
        let end = |c: Cell| c.corner + (1 << finer_levels(c.level));
        self.corner.cmple(end(other)).all() && other.corner.cmple(end(self)).all()
    }
}

/// Levels of the Morton code below this one.
fn finer_levels(level: u32) -> u32 {
    MORTON_LEVELS.saturating_sub(level)
}

/// Morton codes of places in their common cube.
pub(crate) fn codes(positions: &[Vec3]) -> impl IndexedParallelIterator<Item = u64> {
    const NOTHING: (Vec3, Vec3) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = positions
        .par_iter()
        .map(|&p| (p, p))
        .reduce(|| NOTHING, |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let size = f64::from((high - low).max_element()).max(f64::MIN_POSITIVE);
    let cells = f64::from(1u32 << MORTON_LEVELS);
    let last = DVec3::splat(cells - 1.0);
    positions.par_iter().map(move |&p| {
        let cell = (p - low).as_dvec3() / size * cells;
        morton(cell.min(last).as_u64vec3().to_array())
    })
}

/// The Morton code of a cell's place, of the lowest 21 bits along each axis.
pub(crate) fn morton(place: [u64; 3]) -> u64 {
    let [x, y, z] = place.map(spread);
    x | y << 1 | z << 2
}

/// The lowest 21 bits, two zeros between each and the next.
fn spread(v: u64) -> u64 {
    let mut x = v & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Every third bit: the inverse of [`spread`].
fn compact(v: u64) -> u32 {
    let mut x = v & 0x1249_2492_4924_9249;
    x = (x | x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x | x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x | x >> 8) & 0x001f_0000_ff00_00ff;
    x = (x | x >> 16) & 0x001f_0000_0000_ffff;
    ((x | x >> 32) & 0x1f_ffff) as u32
}
