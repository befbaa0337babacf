//! The truth of the surface: a path tracer of the shapes of a scene file, which shares nothing with
//! the library but the file.
//!
//! Surfaces shine and reflect on the side of their normal and block light from both. Radiosity,
//! emission and irradiance are in one unit: what a receiver gets is the mean radiosity over
//! cosine-weighted directions. Light of flat lamps and of point lights is sampled at every vertex of a
//! path; anything else that shines counts where a path meets it. Paths end by Russian roulette, so the
//! mean of all bounces has no bias.
#![allow(dead_code)]

mod body;
mod read;
mod shape;

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use body::Body;
use shape::{Ball, Quad};

/// Rays start this far above the surface, in units of the scene of about 1.
const LIFT: f64 = 1e-6;
/// Estimates of a receiver that do not depend on each other: their spread is its error bar.
const BATCHES: usize = 8;

pub struct Room {
    surfaces: Vec<Surface>,
    /// Places and intensities.
    lights: Vec<(DVec3, DVec3)>,
    /// Irradiance of an open plane.
    sky: DVec3,
}

struct Surface {
    shape: Shape,
    reflectance: DVec3,
    emission: DVec3,
}

enum Shape {
    Quad(Quad),
    Ball(Ball),
    Body(Body),
}

#[derive(Clone, Copy)]
struct Ray {
    from: DVec3,
    /// Of any length; distances are in units of it.
    way: DVec3,
}

struct Hit {
    distance: f64,
    /// To the side that shines.
    normal: DVec3,
}

/// Where irradiance is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Receiver {
    pub place: DVec3,
    pub normal: DVec3,
}

/// An irradiance with its standard error.
#[derive(Clone, Copy, Debug, Default)]
pub struct Estimate {
    pub irradiance: DVec3,
    pub error: DVec3,
}

/// Which light counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounces {
    None,
    All,
}

impl Room {
    /// Irradiance of the receivers by about `paths` paths each; the same bits each time.
    pub fn irradiance(
        &self,
        receivers: &[Receiver],
        bounces: Bounces,
        paths: usize,
    ) -> Vec<Estimate> {
        let strata = ((paths / BATCHES) as f64).sqrt().ceil() as usize;
        (0..receivers.len())
            .into_par_iter()
            .map(|k| {
                let means: [DVec3; BATCHES] = std::array::from_fn(|batch| {
                    let mut random = Pcg64Mcg::seed_from_u64((k * BATCHES + batch) as u64);
                    self.batch(receivers[k], bounces, strata, &mut random)
                });
                let n = BATCHES as f64;
                let mean = means.iter().sum::<DVec3>() / n;
                let square = means.iter().map(|m| (m - mean).powf(2.0)).sum::<DVec3>();
                Estimate {
                    irradiance: mean,
                    error: (square / (n * (n - 1.0))).map(f64::sqrt),
                }
            })
            .collect()
    }

    /// One path for each of strata² directions; lamps in as many strata.
    fn batch(
        &self,
        receiver: Receiver,
        bounces: Bounces,
        strata: usize,
        random: &mut Pcg64Mcg,
    ) -> DVec3 {
        let Receiver { place, normal } = receiver;
        let mut sum = DVec3::ZERO;
        for k in 0..strata * strata {
            let mut stratum = || {
                let jitter = [(); 2].map(|()| random.random::<f64>());
                [
                    ((k / strata) as f64 + jitter[0]) / strata as f64,
                    ((k % strata) as f64 + jitter[1]) / strata as f64,
                ]
            };
            let (lamp, direction) = (stratum(), stratum());
            sum += self.lamps(place, normal, lamp)
                + self.path(place, cosine(normal, direction), normal, bounces, random);
        }
        sum / (strata * strata) as f64
    }

    /// Radiosity at the end of a ray from a surface: what counts only there, and with further bounces
    /// what it reflects.
    fn path(
        &self,
        place: DVec3,
        way: DVec3,
        normal: DVec3,
        bounces: Bounces,
        random: &mut Pcg64Mcg,
    ) -> DVec3 {
        let mut ray = Ray {
            from: place + normal * LIFT,
            way,
        };
        let mut weight = DVec3::ONE;
        let mut light = DVec3::ZERO;
        loop {
            let Some((surface, hit)) = self.first(ray) else {
                return light + weight * self.sky;
            };
            if hit.normal.dot(ray.way) >= 0.0 {
                return light; // a back
            }
            if !surface.sampled() {
                light += weight * surface.emission;
            }
            if bounces == Bounces::None {
                return light;
            }
            weight *= surface.reflectance;
            let from = ray.from + ray.way * hit.distance;
            let at_random = [(); 2].map(|()| random.random());
            light += weight * self.lamps(from, hit.normal, at_random);
            let survival = weight.max_element().min(0.95);
            if random.random::<f64>() >= survival {
                return light;
            }
            weight /= survival;
            ray = Ray {
                from: from + hit.normal * LIFT,
                way: cosine(hit.normal, [(); 2].map(|()| random.random())),
            };
        }
    }

    /// Irradiance from one place on each flat lamp, given by two numbers in [0, 1), and from the
    /// point lights.
    fn lamps(&self, place: DVec3, normal: DVec3, at: [f64; 2]) -> DVec3 {
        let from = place + normal * LIFT;
        let flat = self.surfaces.iter().filter_map(|s| match &s.shape {
            Shape::Quad(quad) if s.sampled() => Some((quad, s.emission)),
            _ => None,
        });
        let flat = flat.map(|(quad, emission)| {
            let way = quad.at(at) - from;
            let (square, cosines) = (
                way.length_squared(),
                -quad.normal.dot(way) * normal.dot(way),
            );
            let faces = normal.dot(way) > 0.0 && cosines > 0.0;
            match faces && !self.blocked(from, way) {
                true => emission * (quad.area * cosines / (std::f64::consts::PI * square * square)),
                false => DVec3::ZERO,
            }
        });
        let points = self.lights.iter().map(|&(light, intensity)| {
            let way = light - from;
            let height = normal.dot(way);
            match height > 0.0 && !self.blocked(from, way) {
                true => intensity * (height / way.length().powi(3)),
                false => DVec3::ZERO,
            }
        });
        flat.sum::<DVec3>() + points.sum::<DVec3>()
    }

    /// Does any surface lie between a place and the end of `way`?
    pub fn blocked(&self, from: DVec3, way: DVec3) -> bool {
        let (ray, limit) = (Ray { from, way }, 1.0 - LIFT);
        self.surfaces.iter().any(|s| match &s.shape {
            Shape::Body(body) => body.blocks(ray, limit),
            _ => s.meet(ray, limit).is_some(),
        })
    }

    /// Distance, in units of `way`, and normal of the surface that a ray meets first.
    pub fn meets(&self, from: DVec3, way: DVec3) -> Option<(f64, DVec3)> {
        let (_, hit) = self.first(Ray { from, way })?;
        Some((hit.distance, hit.normal))
    }

    /// The place on the surface of this normal that is next to one a little off it.
    pub fn beside(&self, place: DVec3, normal: DVec3) -> DVec3 {
        const LITTLE: f64 = 0.02;
        let from = place + LITTLE * normal;
        match self.meets(from, -normal) {
            Some((far, _)) if far < 2.0 * LITTLE => from - far * normal,
            _ => place,
        }
    }

    fn first(&self, ray: Ray) -> Option<(&Surface, Hit)> {
        let mut nearest = None;
        let mut limit = f64::INFINITY;
        for surface in &self.surfaces {
            if let Some(hit) = surface.meet(ray, limit) {
                limit = hit.distance;
                nearest = Some((surface, hit));
            }
        }
        nearest
    }
}

impl Surface {
    /// Is its light found by going to it, not by meeting it?
    fn sampled(&self) -> bool {
        matches!(self.shape, Shape::Quad(_)) && self.emission != DVec3::ZERO
    }

    /// The first hit before the limit.
    fn meet(&self, ray: Ray, limit: f64) -> Option<Hit> {
        let hit = match &self.shape {
            Shape::Quad(quad) => quad.meet(ray),
            Shape::Ball(ball) => ball.meet(ray),
            Shape::Body(body) => body.meet(ray, limit),
        };
        hit.filter(|hit| hit.distance < limit)
    }
}

/// Cosine-weighted direction about `normal` for a place in the unit square (Malley's method).
fn cosine(normal: DVec3, [u, v]: [f64; 2]) -> DVec3 {
    let (x, y) = normal.any_orthonormal_pair();
    let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
    let radius = u.sqrt();
    x * (radius * cos) + y * (radius * sin) + normal * (1.0 - u).sqrt()
}
