//! What the number of points itself allows: the error of the model, estimated.
//!
//! Two disjoint parts of the cloud stand for the same surface, each with cells of its own. Where
//! they bring different light to the same places, at least one of them is wrong, and both are as wrong
//! on average: the error of each is the difference over √2. All points together do better, by a power
//! of their number.

use glam::{DVec3, Vec3};

use crate::error::Result;
use crate::expansion::Surface;
use crate::lights::{point_lights, visible_sky};
use crate::octree::{LEAF_SIZE, Octree};
use crate::operator::{Draw, Sampler};
use crate::points::{PointCloud, Surfels};
use crate::progress::Silent;
use crate::random::{Purpose, stream};
use crate::scene::Scene;
use crate::visibility::{CpuVisibility, Occluders};

/// Points of a part, at most.
const POINTS: usize = 10_000;
/// Fewest points of a part that say anything.
const LEAST_POINTS: usize = 200;
/// Places whose light is compared.
const PLACES: usize = 400;
/// Sources that an estimate draws.
const DRAWS: u32 = 64;
/// Directions, squared, in which it looks for the sky.
const STRATA: usize = 8;
/// The error falls with the number of points as its power, less: with their distance.
const POWER: f64 = 0.5;

/// Relative L2 error of the irradiance against the true surface that so many points are estimated to
/// have at the least, for the light of one bounce: `irradiance` and `radiosity` are those of the
/// solution, in the order of `surfels`. `None` for clouds that are too small.
pub(super) fn model_error(
    scene: &Scene,
    surfels: &Surfels,
    irradiance: &[DVec3],
    radiosity: &[DVec3],
    seed: u64,
) -> Result<Option<f64>> {
    let n = surfels.len();
    // Places are points of neither part.
    let step = n.div_ceil(POINTS).max(3);
    if n / step < LEAST_POINTS {
        return Ok(None);
    }
    let places: Vec<usize> = (0..PLACES)
        .map(|k| (k * (n / step) / PLACES + 1) * step - 1)
        .collect();
    // Two estimates of each part: the products of independent differences have no noise on average.
    let mut found = Vec::with_capacity(2);
    for first in [0, step / 2] {
        let members: Vec<u32> = (first..n).step_by(step).map(|i| i as u32).collect();
        // A part that is no usable cloud says nothing of the whole.
        let Ok(part) = Part::new(scene, surfels, &members, step) else {
            return Ok(None);
        };
        found.push(part.light(scene, surfels, radiosity, &members, &places, seed)?);
    }
    let difference = |half: usize, k: usize| found[0][half][k] - found[1][half][k];
    let square: f64 = (0..PLACES).map(|k| difference(0, k).dot(difference(1, k))).sum();
    let whole: f64 = places.iter().map(|&i| irradiance[i].length_squared()).sum();
    let of_part = (0.5 * square.max(0.0) / whole.max(f64::MIN_POSITIVE)).sqrt();
    Ok(Some(of_part / (step as f64).powf(POWER)))
}

/// Some of the points, as if they were the whole cloud.
struct Part {
    surfels: Surfels,
    octree: Octree,
    occluders: Occluders,
}

impl Part {
    fn new(scene: &Scene, surfels: &Surfels, members: &[u32], step: usize) -> Result<Part> {
        let of = |values: &[Vec3]| members.iter().map(|&i| values[i as usize]).collect();
        let positions: Vec<Vec3> = of(&surfels.positions);
        let cloud = PointCloud {
            positions: positions
                .iter()
                .map(|p| surfels.origin + p.as_dvec3())
                .collect(),
            normals: of(&surfels.normals),
            reflectance: of(&surfels.reflectance),
            emission: of(&surfels.emission),
            // Where the file gives areas, each point stands for those that were left out.
            areas: match scene.cloud.areas.is_empty() {
                true => Vec::new(),
                false => (members.iter())
                    .map(|&i| surfels.areas[i as usize] * step as f32)
                    .collect(),
            },
            ..PointCloud::default()
        };
        let (octree, surfels) = Octree::build(&Surfels::prepare(&cloud, &Silent)?.surfels, LEAF_SIZE);
        Ok(Part {
            occluders: Occluders::build(&surfels),
            octree,
            surfels,
        })
    }

    /// Two independent estimates of the irradiance at `places`, surfels of the whole cloud.
    fn light(
        mut self,
        scene: &Scene,
        whole: &Surfels,
        radiosity: &[DVec3],
        members: &[u32],
        places: &[usize],
        seed: u64,
    ) -> Result<[Vec<DVec3>; 2]> {
        let mut sent: Vec<DVec3> = (self.surfels.points.iter())
            .map(|&p| radiosity[members[p as usize] as usize])
            .collect();
        let own = sent.len() as u32;
        self.surfels.append(whole, places);
        sent.resize(self.surfels.len(), DVec3::ZERO);
        let visibility = CpuVisibility::<f32>::new(&self.occluders);
        let surface = Surface::new(&self.surfels);
        let sampler = Sampler::new(&self.octree, &self.surfels, &surface, &sent);
        let lights = point_lights(&self.surfels, &scene.lights, &visibility, &Silent)?.irradiance;
        let receivers: Vec<u32> = (0..places.len() as u32).map(|k| own + k).collect();
        let draws: Vec<Draw> = (receivers.iter())
            .map(|&receiver| Draw {
                receiver,
                count: DRAWS,
            })
            .collect();
        let mut estimates = [Vec::new(), Vec::new()];
        for (half, estimate) in estimates.iter_mut().enumerate() {
            let random = |k: usize| {
                let item = (2 * k + half) as u64;
                stream(seed, Purpose::Model, item << 32 | u64::from(members[0]))
            };
            *estimate = sampler.estimate(&draws, random, &visibility)?;
            let skies = match scene.sky == Vec3::ZERO {
                true => vec![0.0; places.len()],
                false => visible_sky(&self.surfels, &receivers, STRATA, random, &visibility)?,
            };
            for (k, (h, sky)) in estimate.iter_mut().zip(skies).enumerate() {
                *h += lights[receivers[k] as usize] + scene.sky.as_dvec3() * sky;
            }
        }
        Ok(estimates)
    }
}
