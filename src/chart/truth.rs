//! What solutions are measured against.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::closed_forms::{parallel, perpendicular};
use crate::compare::compare;
use crate::error::{Error, Result};
use crate::expansion::Surface;
use crate::illuminate::prepared;
use crate::lights;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{CpuVisibility, Segment, Visibility};

/// Directions, squared, in which the sky over a surfel is looked for.
const STRATA: usize = 64;
/// Bounces of light, at most, and the relative change after which there are no more.
const BOUNCES: usize = 10_000;
const CONVERGED: f64 = 1e-7;

/// Errors at the receivers, as [`compare`] defines them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    pub rel_l2: f64,
    pub p99: f64,
    pub bias: f64,
    /// Points compared.
    pub receivers: usize,
}

/// Rows of the exact operator at some surfels of a scene, and their exact direct light. They are found
/// once. With all rows the solution is known; else any solution of the scene is measured by one application
/// of them to itself, in which an error of all its points has not gone through all bounces.
pub struct PointTruth {
    surfels: Arc<Surfels>,
    receivers: Vec<usize>,
    /// For each receiver who is seen, with the form factor.
    rows: Vec<Vec<(u32, f32)>>,
    direct: Vec<DVec3>,
    /// Irradiance of the receivers, where these are all surfels and bounces come to an end.
    solution: Option<Vec<Vec3>>,
}

/// Light at the receivers of a truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// All of it.
    pub all: Vec<DVec3>,
    /// What other surfels reflected.
    pub reflected: Vec<DVec3>,
}

impl PointTruth {
    /// For so many receivers at most, spread evenly over the surface.
    pub fn find(scene: &Scene, receivers: usize, progress: &dyn Progress) -> Result<PointTruth> {
        let (surfels, occluders) = prepared(scene, progress)?;
        let visibility = CpuVisibility::<f64>::new(&occluders);
        let n = surfels.len();
        let count = receivers.min(n);
        let receivers: Vec<usize> = (0..count).map(|k| (2 * k + 1) * n / (2 * count)).collect();
        let surface = Surface::<f64>::new(&surfels);
        let mut rows = Vec::with_capacity(count);
        for &i in &receivers {
            progress.check()?;
            let partners: Vec<(u32, f32)> = (0..n)
                .into_par_iter()
                .map(|j| (j as u32, surface.form_factor(i, j) as f32))
                .filter(|&(_, f)| f > 0.0)
                .collect();
            let between =
                |&(j, _): &(u32, f32)| surfels.segment(i.min(j as usize), i.max(j as usize));
            let segments: Vec<Segment> = partners.iter().map(between).collect();
            let seen = partners.into_iter().zip(visibility.visible(&segments)?);
            rows.push(seen.filter(|&(_, v)| v).map(|(row, _)| row).collect());
        }
        let emission: Vec<DVec3> = surfels.emission.iter().map(|e| e.as_dvec3()).collect();
        let mut direct = applied(&rows, &emission);
        let lamps = lights::point_lights(&surfels, &scene.lights, &visibility, progress)?;
        for (light, &i) in direct.iter_mut().zip(&receivers) {
            *light += lamps.irradiance[i];
            if scene.sky != Vec3::ZERO {
                *light += scene.sky.as_dvec3() * sky_seen(&surfels, i, &visibility)?;
            }
        }
        let solution = match count == n {
            true => solution(&surfels.reflectance, &rows, &direct, progress)?,
            false => None,
        };
        Ok(PointTruth {
            surfels,
            receivers,
            rows,
            direct,
            solution,
        })
    }

    /// What the exact operator makes of a solution, the irradiance of all points of the scene: its own
    /// light at the receivers, if it is right.
    pub fn of(&self, irradiance: &[Vec3]) -> Light {
        let surfels = self.surfels.points.iter().zip(&self.surfels.reflectance);
        let reflected: Vec<DVec3> = surfels
            .map(|(&p, r)| irradiance[p as usize].as_dvec3() * r.as_dvec3())
            .collect();
        let reflected = applied(&self.rows, &reflected);
        let pairs = reflected.iter().zip(&self.direct);
        Light {
            all: pairs.map(|(r, d)| *r + *d).collect(),
            reflected,
        }
    }

    /// Points of the scene that the receivers stand for.
    pub fn points(&self) -> impl Iterator<Item = usize> {
        let point = |&i: &usize| self.surfels.points[i] as usize;
        self.receivers.iter().map(point)
    }

    /// Errors of a solution.
    pub fn errors(&self, irradiance: &[Vec3]) -> Result<Errors> {
        let found: Vec<Vec3> = self.points().map(|p| irradiance[p]).collect();
        match &self.solution {
            Some(solution) => errors(&found, solution),
            None => errors(&found, &in_f32(&self.of(irradiance).all)),
        }
    }
}

/// The light that bounces come to, if they come to an end: one after the other, which owes nothing to the solver
/// that is measured.
fn solution(
    reflectance: &[Vec3],
    rows: &[Vec<(u32, f32)>],
    direct: &[DVec3],
    progress: &dyn Progress,
) -> Result<Option<Vec<Vec3>>> {
    let mut irradiance = direct.to_vec();
    for _ in 0..BOUNCES {
        progress.check()?;
        let pairs = irradiance.iter().zip(reflectance);
        let sent: Vec<DVec3> = pairs.map(|(h, r)| *h * r.as_dvec3()).collect();
        let reflected = applied(rows, &sent).into_iter();
        let next: Vec<DVec3> = reflected.zip(direct).map(|(r, d)| r + *d).collect();
        let square = |light: DVec3| light.length_squared();
        let changed: f64 = next
            .iter()
            .zip(&irradiance)
            .map(|(a, b)| square(*a - *b))
            .sum();
        let all: f64 = next.iter().map(|h| square(*h)).sum();
        irradiance = next;
        if changed <= CONVERGED * CONVERGED * all {
            return Ok(Some(in_f32(&irradiance)));
        }
    }
    Ok(None)
}

fn in_f32(light: &[DVec3]) -> Vec<Vec3> {
    light.iter().map(|h| h.as_vec3()).collect()
}

fn applied(rows: &[Vec<(u32, f32)>], radiosity: &[DVec3]) -> Vec<DVec3> {
    let term = |&(j, f): &(u32, f32)| radiosity[j as usize] * f64::from(f);
    rows.par_iter()
        .map(|row| row.iter().map(term).sum())
        .collect()
}

/// The part of a uniform sky's light that comes to a surfel.
fn sky_seen(surfels: &Surfels, i: usize, visibility: &dyn Visibility) -> Result<f64> {
    let (normal, tangent) = (surfels.normals[i], surfels.cells.tangents[i]);
    let reach = surfels.reach();
    let rays = (0..STRATA * STRATA).map(|k| {
        let [u, v] = [k / STRATA, k % STRATA].map(|x| (x as f32 + 0.5) / STRATA as f32);
        let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
        let flat = tangent * cos + normal.cross(tangent) * sin;
        surfels.ray(i, (flat * u.sqrt() + normal * (1.0 - u).sqrt()) * reach)
    });
    let seen = visibility.visible(&rays.collect::<Vec<_>>())?;
    Ok(seen.iter().filter(|&&v| v).count() as f64 / seen.len() as f64)
}

fn errors(found: &[Vec3], truth: &[Vec3]) -> Result<Errors> {
    let c = compare(found, truth)?;
    Ok(Errors {
        rel_l2: c.rel_l2,
        p99: c.p99,
        bias: c.bias,
        receivers: c.points,
    })
}

/// Irradiance of the true surface at some points of a scene.
pub struct SurfaceTruth {
    points: Vec<usize>,
    irradiance: Vec<Vec3>,
}

impl SurfaceTruth {
    /// Of the shipped scenes whose light has a closed form: the furnace and the plates; `None` of all
    /// others.
    pub fn of(path: &Path, scene: &Scene) -> Result<Option<SurfaceTruth>> {
        let text = fs::read(path).map_err(|e| Error::io(path, "cannot be read", e))?;
        let cloud = &scene.cloud;
        let at = |i: &usize| cloud.positions[*i];
        let dark = (0..cloud.len()).filter(|&i| cloud.emission[i] == Vec3::ZERO);
        let (points, irradiance): (Vec<usize>, Vec<f64>) = match &text[..] {
            // Each point sees a closed cavity: H = 1 + H / 2.
            t if t == include_bytes!("../../scenes/furnace.toml") => {
                ((0..cloud.len()).collect(), vec![2.0; cloud.len()])
            }
            t if t == include_bytes!("../../scenes/plates_parallel.toml") => {
                let points: Vec<usize> = dark.collect();
                let light = points
                    .iter()
                    .map(at)
                    .map(|p| parallel(DVec2::new(p.x, p.z)));
                (points.clone(), light.collect())
            }
            t if t == include_bytes!("../../scenes/plates_perpendicular.toml") => {
                let points: Vec<usize> = dark.collect();
                let light = points
                    .iter()
                    .map(at)
                    .map(|p| perpendicular(DVec2::new(p.x, p.y)));
                (points.clone(), light.collect())
            }
            _ => return Ok(None),
        };
        Ok(Some(SurfaceTruth {
            points,
            irradiance: irradiance.iter().map(|&h| Vec3::splat(h as f32)).collect(),
        }))
    }

    /// Errors of a solution, the irradiance of all points.
    pub fn errors(&self, irradiance: &[Vec3]) -> Result<Errors> {
        let found: Vec<Vec3> = self.points.iter().map(|&p| irradiance[p]).collect();
        errors(&found, &self.irradiance)
    }
}
