//! Bright spots: few surfels, next to lamps and in sunlight, that most of the noise of rays comes from.
//!
//! Rays meet a small spot by chance. But what it reflects of the light straight from the lights is known
//! before any bounce, and is sampled as that of surfels that shine: by segments that go there. With P
//! taking the spots out of a field and D the light straight from the lights, H = D + FρH is
//! H = PD + H', where H' = (1 - P) D + FρPD + FρH': the same equation with other lights, of which FρPD is
//! sampled. Rays are left with H', that has no such spots.

use glam::DVec3;

use super::task::{DirectLight, Task};
use super::work::Bounced;
use crate::error::Result;
use crate::lights;
use crate::points::Surfels;
use crate::smoothing::Smoother;

/// Spots send this many times as much as the mean of all surfels.
const SPOT: f64 = 3.0;
/// Error that expansions of their light may make at worst, in units of the tolerance.
const EXPANSIONS: f64 = 4.0;

/// Surfels that are bright by light straight from the lights.
pub(crate) struct Spots {
    pub is_spot: Vec<bool>,
    /// Part of the noise of rays that is left without them.
    pub left: f64,
}

/// Light at bright spots, and the lights without it.
pub(super) struct Bright {
    /// PD
    spots: Vec<DVec3>,
    /// (1 - P) D + FρPD
    pub lights: Vec<DVec3>,
}

impl Spots {
    /// Of surfels that this light falls on.
    pub fn of(surfels: &Surfels, direct: &[DVec3]) -> Spots {
        let sent: Vec<f64> = (direct.iter().zip(&surfels.reflectance))
            .map(|(h, r)| (*h * r.as_dvec3()).element_sum())
            .collect();
        let areas = || surfels.areas.iter().map(|&a| f64::from(a));
        let power: f64 = areas().zip(&sent).map(|(a, b)| a * b).sum();
        let mean = power / areas().sum::<f64>();
        let is_spot: Vec<bool> = sent.iter().map(|b| *b > SPOT * mean).collect();
        // The variance of what a ray meets, about.
        let [mut all, mut others] = [0.0; 2];
        for ((area, b), is_spot) in areas().zip(&sent).zip(&is_spot) {
            let square = area * (b / mean.max(f64::MIN_POSITIVE)).powi(2);
            all += square;
            others += if *is_spot { 0.0 } else { square };
        }
        Spots {
            is_spot,
            left: match all > 0.0 {
                true => (others / all).sqrt(),
                false => 1.0,
            },
        }
    }
}

impl Task<'_> {
    /// What bright spots send, `tolerance` being that of lights.
    pub(super) fn bright(
        &self,
        direct: &DirectLight,
        spots: &Spots,
        tolerance: f64,
        smoother: &Smoother,
    ) -> Result<Bright> {
        let spots: Vec<DVec3> = (direct.irradiance.iter().zip(&spots.is_spot))
            .map(|(h, is_spot)| if *is_spot { *h } else { DVec3::ZERO })
            .collect();
        // As f32 can hold it.
        let largest = spots.iter().map(|h| h.max_element());
        let unit = largest.fold(f64::MIN_POSITIVE, f64::max);
        let lamps = Surfels {
            emission: (spots.iter().zip(&self.surfels.reflectance))
                .map(|(h, r)| (*h / unit).as_vec3() * *r)
                .collect(),
            ..self.surfels.clone()
        };
        let (visibility, progress) = (self.visibility, self.progress);
        let mut arriving = lights::emitted(
            &lamps, tolerance, EXPANSIONS, self.seed, visibility, progress,
        )?;
        arriving.smooth(smoother);
        let lights = (direct.irradiance.iter().zip(&spots)).zip(arriving.irradiance());
        Ok(Bright {
            lights: lights
                .map(|((h, spot), more)| *h - *spot + more * unit)
                .collect(),
            spots,
        })
    }
}

impl Bright {
    /// H from H'.
    pub fn whole(&self, rest: Bounced, surfels: &Surfels) -> Bounced {
        let reflectance = || surfels.reflectance.iter().map(|r| r.as_dvec3());
        let irradiance: Vec<DVec3> = (rest.irradiance.iter().zip(&self.spots))
            .map(|(h, spot)| *h + *spot)
            .collect();
        Bounced {
            reflected: (irradiance.iter().zip(reflectance()))
                .map(|(h, r)| *h * r)
                .collect(),
            sent: (rest.sent.iter().zip(&self.spots).zip(reflectance()))
                .map(|((b, spot), r)| *b + *spot * r)
                .collect(),
            irradiance,
            ..rest
        }
    }
}
