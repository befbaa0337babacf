//! Reflected light, smoothed over the surface: without the edges of the facets that its links end at.

use glam::DVec3;

use super::work::Bounced;
use crate::links::LOCAL_TOLERANCE;
use crate::points::Surfels;
use crate::smoothing::Smoother;

/// What links may get wrong from one surfel to the next, in units of the tolerance and the mean
/// irradiance (length of the difference of three colours).
const NOISE: f64 = 6.0;

/// A solution whose irradiance, as far as it is not straight from the `lights`, is smoothed. Its power
/// is kept.
pub(super) fn even(
    bounced: Bounced,
    surfels: &Surfels,
    smoother: &Smoother,
    lights: &[DVec3],
    tolerance: f64,
) -> Bounced {
    let irradiance = &bounced.irradiance;
    let grey = |h: &DVec3| h.element_sum() / 3.0;
    let level = irradiance.iter().map(grey).sum::<f64>() / irradiance.len() as f64;
    // Links are made with more care where it is dark, and so is this.
    let [darkest, brightest] = LOCAL_TOLERANCE.map(|factor| factor * level);
    let limit = |i: usize, _: DVec3, _: DVec3| {
        NOISE * tolerance * grey(&irradiance[i]).clamp(darkest, brightest)
    };
    let reflected: Vec<DVec3> = (irradiance.iter().zip(lights))
        .map(|(h, light)| *h - *light)
        .collect();
    let smooth = smoother.smooth(&reflected, limit);
    let power = |light: &[DVec3]| -> DVec3 {
        let areas = surfels.areas.iter();
        areas
            .zip(light)
            .map(|(&area, h)| f64::from(area) * *h)
            .sum()
    };
    let ratio = power(&reflected) / power(&smooth);
    let ratio = DVec3::select(ratio.is_finite_mask(), ratio, DVec3::ONE);
    let irradiance: Vec<DVec3> = (smooth.iter().zip(lights))
        .map(|(h, light)| (*h * ratio + *light).max(DVec3::ZERO))
        .collect();
    Bounced {
        reflected: (irradiance.iter().zip(&surfels.reflectance))
            .map(|(h, r)| *h * r.as_dvec3())
            .collect(),
        irradiance,
        ..bounced
    }
}
