//! What the number of points itself allows: the error of the model, estimated.
//!
//! Two disjoint parts of the cloud stand for the same surface, each with cells of its own. At some of
//! their points the light that they bring, if every point sends what it does in the solution, is
//! compared with the solution: what fewer points do worse says how good all of them are.

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
const POINTS: usize = 5000;
/// Fewest points of a part that say anything.
const LEAST_POINTS: usize = 200;
/// Points of each part whose light is compared.
const PLACES: usize = 200;
/// Sources that an estimate draws.
const DRAWS: u32 = 48;
/// Directions, squared, in which it looks for the sky.
const STRATA: usize = 8;
/// The error falls as this power of the number of points: with their distance.
const POWER: f64 = 0.5;

/// A solution whose model is looked at, in the order of its surfels.
pub(super) struct Lit<'a> {
    pub scene: &'a Scene,
    pub surfels: &'a Surfels,
    pub irradiance: &'a [DVec3],
    /// Emitted and reflected.
    pub radiosity: &'a [DVec3],
    pub seed: u64,
}

/// Relative L2 error of the irradiance against the true surface that so many points are estimated to
/// have, for the light of one bounce; `error` is that of the solution against the points. `None` for
/// clouds that are too small.
pub(super) fn model_error(lit: &Lit, error: f64) -> Result<Option<f64>> {
    let n = lit.surfels.len();
    let step = n.div_ceil(POINTS).max(2);
    if n / step < LEAST_POINTS {
        return Ok(None);
    }
    let (mut square, mut whole) = (0.0, 0.0);
    for first in [0, step / 2] {
        let members: Vec<u32> = (first..n).step_by(step).map(|i| i as u32).collect();
        // A part that is no usable cloud says nothing of the whole.
        let Ok(part) = Part::new(lit, members, step) else {
            return Ok(None);
        };
        let receivers: Vec<u32> = (0..PLACES)
            .map(|k| ((2 * k + 1) * part.surfels.len() / (2 * PLACES)) as u32)
            .collect();
        // The product of two independent estimates has no noise on average.
        for (&r, [a, b]) in receivers.iter().zip(part.light(lit, &receivers)?) {
            let truth = lit.irradiance[part.member(r as usize)];
            square += (a - truth).dot(b - truth);
            whole += truth.length_squared();
        }
    }
    let of_both = (square / f64::max(whole, f64::MIN_POSITIVE) - error * error).max(0.0);
    // Errors of few and of all points as if they knew nothing of each other.
    Ok(Some(
        (of_both / (1.0 + (step as f64).powf(2.0 * POWER))).sqrt(),
    ))
}

/// Some of the points, as if they were the whole cloud.
struct Part {
    /// In the order of its octree.
    surfels: Surfels,
    octree: Octree,
    occluders: Occluders,
    /// Places of the points among all surfels.
    members: Vec<u32>,
}

impl Part {
    /// Every `step`-th surfel.
    fn new(lit: &Lit, members: Vec<u32>, step: usize) -> Result<Part> {
        let surfels = lit.surfels;
        let of = |values: &[Vec3]| members.iter().map(|&i| values[i as usize]).collect();
        let positions: Vec<Vec3> = of(&surfels.positions);
        let area = |&i: &u32| surfels.areas[i as usize] * step as f32;
        let cloud = PointCloud {
            positions: positions
                .iter()
                .map(|p| surfels.origin + p.as_dvec3())
                .collect(),
            normals: of(&surfels.normals),
            reflectance: of(&surfels.reflectance),
            emission: of(&surfels.emission),
            // Where the file gives areas, each point stands for those that were left out.
            areas: match lit.scene.cloud.areas.is_empty() {
                true => Vec::new(),
                false => members.iter().map(area).collect(),
            },
            ..PointCloud::default()
        };
        let prepared = Surfels::prepare(&cloud, &Silent)?;
        let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
        Ok(Part {
            occluders: Occluders::build(&surfels),
            octree,
            surfels,
            members,
        })
    }

    /// The place of a surfel among all.
    fn member(&self, k: usize) -> usize {
        self.members[self.surfels.points[k] as usize] as usize
    }

    /// Two independent estimates of the irradiance of some surfels.
    fn light(&self, lit: &Lit, receivers: &[u32]) -> Result<Vec<[DVec3; 2]>> {
        let (surfels, scene) = (&self.surfels, lit.scene);
        let sent: Vec<DVec3> = (0..surfels.len())
            .map(|k| lit.radiosity[self.member(k)])
            .collect();
        let visibility = CpuVisibility::<f32>::new(&self.occluders);
        let surface = Surface::new(surfels);
        let sampler = Sampler::new(&self.octree, surfels, &surface, &sent);
        let lights = point_lights(surfels, &scene.lights, &visibility, &Silent)?.irradiance;
        let draw = |&receiver: &u32| Draw {
            receiver,
            count: DRAWS,
        };
        let draws: Vec<Draw> = receivers.iter().map(draw).collect();
        let random = |k: usize, half: u64| {
            let item = self.member(receivers[k] as usize) as u64;
            stream(lit.seed, Purpose::Model, item << 1 | half)
        };
        let mut estimates = sampler.estimate(&draws, |k| random(k, 0), &visibility)?;
        for half in 0..2 {
            if scene.sky != Vec3::ZERO {
                let random = |k| random(k, half as u64);
                let skies = visible_sky(surfels, receivers, STRATA, random, &visibility)?;
                for (h, sky) in estimates.iter_mut().zip(skies) {
                    h[half] += scene.sky.as_dvec3() * sky;
                }
            }
            for (h, &r) in estimates.iter_mut().zip(receivers) {
                h[half] += lights[r as usize];
            }
        }
        Ok(estimates)
    }
}
