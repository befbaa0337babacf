//! How far the light is off because the surfels are not the scanned surface.
//!
//! The surface is fitted anew to two disjoint halves of the points, and all is lit by each of them. What
//! noise, layers, edges, gaps between points and guessed sides change differs from half to half. What both
//! halves lack, as surface that no scanner saw, does not: it counts as if the directions through holes
//! were all wrong.

use std::fmt;
use std::time::Instant;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{Backend, Illumination, Options, illuminate};
use crate::compare::compare;
use crate::error::Result;
use crate::points::Half;
use crate::progress::Progress;
use crate::scene::Scene;

/// Bound of the error over the error. Of a choice of points that looks at edges, thin and dark places as often as
/// at walls, virtual scans of three known scenes have 1.0 to 2.5 times the error that is told, all but one.
const BOUND: f64 = 2.5;
/// What is the same in both halves need not be known: they are solved to this many times the tolerance.
const ROUGHLY: f64 = 3.0;
/// Without a sky, where fewer of the directions lead out, they do through holes.
const CLOSED: f64 = 0.08;

/// Errors of the irradiance by the surface, relative as [`Comparison`](crate::compare::Comparison) has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SurfaceError {
    /// Relative L2 error that halves tell, and holes.
    pub rel_l2: f64,
    /// Upper 95% bound of the relative L2 error.
    pub bound: f64,
    /// The part of it that two halves of the points tell.
    pub halves: f64,
    /// The part of it that comes through holes.
    pub holes: f64,
    /// Median of the points' errors.
    pub median: f64,
    /// 95th percentile of the points' errors.
    pub p95: f64,
    /// Seconds that it took.
    pub seconds: f64,
}

/// Finds the error by the surface of a solution with the same options; `None` if its surfels were not fitted.
///
/// # Errors
/// Those of [`illuminate`], for half of the points.
pub fn surface_error(
    scene: &Scene,
    options: &Options,
    backend: Backend,
    illumination: &Illumination,
    progress: &dyn Progress,
) -> Result<Option<SurfaceError>> {
    if !illumination.stats.fitted {
        return Ok(None);
    }
    let start = Instant::now();
    let lit_by = |half: Half| -> Result<Vec<Vec3>> {
        let mut options = Options {
            half: Some(half),
            tolerance: Some(ROUGHLY * illumination.stats.tolerance),
            ..options.clone()
        };
        // As fine a surface all the same.
        options.thinning.max_points = Some(illumination.stats.surfels);
        let lit = illuminate(scene, &options, backend, &Quiet(progress))?;
        Ok(lit.map.irradiance)
    };
    progress.note("error by the surface: once more with each half of the points");
    let (first, second) = (lit_by(Half::First)?, lit_by(Half::Second)?);
    let whole = &illumination.map.irradiance;
    // Half the variance of the difference is that of one half.
    let moved: Vec<Vec3> = (whole.iter().zip(first.iter().zip(&second)))
        .map(|(whole, (a, b))| whole + (a - b) * std::f32::consts::FRAC_1_SQRT_2)
        .collect();
    let seconds = start.elapsed().as_secs_f64();
    if whole.iter().all(|h| *h == Vec3::ZERO) {
        return Ok(None);
    }
    let errors = compare(&moved, whole)?;
    let holes = illumination.stats.holes.unwrap_or_default();
    let closed = scene.sky == Vec3::ZERO && holes.out < CLOSED;
    let holes = holes.backs + if closed { holes.out } else { 0.0 };
    let rel_l2 = errors.rel_l2.hypot(holes);
    Ok(Some(SurfaceError {
        rel_l2,
        bound: BOUND * rel_l2,
        halves: errors.rel_l2,
        holes,
        median: errors.median,
        p95: errors.p95,
        seconds,
    }))
}

/// Only asks whether to stop.
struct Quiet<'a>(&'a dyn Progress);

impl Progress for Quiet<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

impl fmt::Display for SurfaceError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [rel_l2, bound, halves] = [self.rel_l2, self.bound, self.halves].map(|x| 100.0 * x);
        let [holes, p95] = [self.holes, self.p95].map(|x| 100.0 * x);
        write!(
            f,
            "{rel_l2:.0}% in all (up to {bound:.0}): {halves:.1}% by two halves of the points, 95% of them within \
             {p95:.0}%, {holes:.1}% through holes"
        )
    }
}
