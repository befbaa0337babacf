//! Light straight from its sources, computed per surfel with tested visibility and outside the
//! links: shadows are as sharp as the points can show them.

mod emitters;
mod points;
mod sky;

pub(crate) use emitters::RECEIVERS;
pub use emitters::{EXPANSIONS, Emitted, emitted, emitters};
pub(crate) use points::form;
pub use points::{Illuminated, point_lights};
pub use sky::sky;
pub(crate) use sky::{SkySeen, strata, visible_sky};

use glam::DVec3;

use crate::smoothing::Smoother;

/// Surfels whose segments are tested in one batch.
const BATCH: usize = 1 << 14;
/// Noises within which neighbours' visible parts are taken for the same (lengths of differences of
/// three colours).
const NOISES: f64 = 10.0;
/// Least variance of a part, relative to that of one half: where few are in the light, none may have
/// been found.
const LEAST_VARIANCE: f64 = 0.02;

/// Standard deviation of a visible part of one half, found by so many stratified segments.
fn noise_of_half(segments: usize) -> f64 {
    0.5 * (segments as f64).powf(-0.75)
}

/// Visible parts of lights without the noise of penumbras. Only parts that can be told apart by noise alone
/// are smoothed: shadows as sharp as the points show them stay.
fn smoothed(visible: &[DVec3], noise_of_half: f64, smoother: &Smoother) -> Vec<DVec3> {
    let limit = |_: usize, a: DVec3, b: DVec3| {
        let part = ((a + b).element_sum() / 6.0).clamp(0.0, 1.0);
        let variance = (4.0 * part * (1.0 - part)).max(LEAST_VARIANCE);
        NOISES * noise_of_half * variance.sqrt()
    };
    let parts = smoother.smooth(visible, limit).into_iter();
    parts
        .map(|part| part.clamp(DVec3::ZERO, DVec3::ONE))
        .collect()
}
