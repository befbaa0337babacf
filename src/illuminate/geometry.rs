//! The cloud made ready for light: what no light changes, and the way back to its points.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use super::holes::Holes;
use super::options::{Occlusion, Options};
use super::stats::Seconds;
use crate::error::{Error, Result};
use crate::lights;
use crate::map::{IlluminationMap, Lamp, Lit};
use crate::octree::Octree;
use crate::plan::{ORDER, Plan, thinning};
use crate::points::{self, Evidence, PointCloud, Prepared, Quality, Surfels};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{CpuVisibility, NothingInTheWay, Occluders, Visibility};

/// Lamps whose light is found at each point, at most.
const LAMPS: usize = 16;

/// The surfels of a cloud in the order of their octree.
pub(super) struct Geometry {
    pub surfels: Arc<Surfels>,
    pub octree: Octree,
    /// What stands in the way; `None` if nothing does.
    pub occluders: Option<Arc<Occluders>>,
    /// For each point of the cloud the surfel whose light it gets, if any.
    pub places: Vec<Option<u32>>,
    /// That of the cloud.
    pub fingerprint: u64,
    /// Largest order of the expansions that the octree is made for.
    pub order: usize,
    /// What was left out or merged, with counts.
    pub repairs: Vec<String>,
    /// Whether the surfels were fitted to the points.
    pub fitted: bool,
    /// Where directions lead through holes of a fitted surface.
    pub holes: Holes,
    /// How good the cloud is as a surface; not kept in files.
    pub quality: Option<Quality>,
}

impl Geometry {
    /// Also tells the seconds that it took.
    pub fn prepare(
        scene: &Scene,
        options: &Options,
        plan: &Plan,
        progress: &dyn Progress,
    ) -> Result<(Geometry, Seconds)> {
        let cloud = &scene.cloud;
        let start = Instant::now();
        let thinning = thinning(options, plan.tolerance);
        let evidence = Evidence {
            facing: options.facing,
            lamps: scene.lights.iter().map(|light| light.position).collect(),
            half: options.half,
        };
        let mut prepared = Surfels::of_scan(cloud, &evidence, &thinning, progress)?;
        let prepare = start.elapsed().as_secs_f64();
        progress.stage("octree", 1);
        let build = |prepared: &Prepared| {
            let (octree, surfels) = Octree::build(&prepared.surfels, plan.leaf_size);
            let occluders = match options.occlusion {
                Occlusion::Surfels => Some(Occluders::build(&surfels)),
                Occlusion::None => None,
            };
            (octree, surfels, occluders)
        };
        let (mut octree, mut surfels, mut occluders) = build(&prepared);
        // What was measured is not buried.
        if let Some(of_all) = occluders.as_ref().filter(|_| !prepared.is_fitted()) {
            let buried = points::buried(&surfels, of_all);
            if !buried.is_empty() {
                let points: Vec<u32> = buried.iter().map(|&s| surfels.points[s as usize]).collect();
                prepared.leave_out_buried(&points)?;
                (octree, surfels, occluders) = build(&prepared);
            }
        }
        let places = prepared.places(&surfels);
        let fitted = prepared.is_fitted();
        drop(prepared.surfels);
        let holes = match occluders.as_ref().filter(|_| fitted) {
            Some(occluders) => Holes::find(&surfels, &octree, occluders, progress)?,
            None => Holes::default(),
        };
        prepared.repairs.extend(holes.told());
        let geometry = Geometry {
            occluders: occluders.map(Arc::new),
            surfels: Arc::new(surfels),
            places,
            fingerprint: cloud.fingerprint(),
            octree,
            order: plan.order.unwrap_or(ORDER),
            fitted,
            repairs: prepared.repairs,
            holes,
            quality: Some(prepared.quality),
        };
        let seconds = Seconds {
            prepare,
            octree: start.elapsed().as_secs_f64() - prepare,
            ..Seconds::default()
        };
        Ok((geometry, seconds))
    }

    /// Takes over what the points of the cloud reflect and emit by now; surfels that stand for several take
    /// the mean.
    pub fn paint(&mut self, cloud: &PointCloud) -> Result<()> {
        points::check(cloud)?;
        if cloud.len() != self.places.len() || cloud.fingerprint() != self.fingerprint {
            return Err(Error::Invalid(
                "this is not the cloud that the transport was found for: between two lights only \
                 reflectance, emission and lights may change, points and areas stay"
                    .into(),
            ));
        }
        let surfels = Arc::make_mut(&mut self.surfels);
        let mut counts = vec![1.0; surfels.len()];
        for (k, &point) in surfels.points.iter().enumerate() {
            surfels.reflectance[k] = cloud.reflectance[point as usize];
            surfels.emission[k] = cloud.emission[point as usize];
        }
        for (i, k) in self.places.iter().enumerate() {
            let Some(k) = k.map(|k| k as usize) else {
                continue;
            };
            let own = surfels.points[k] as usize;
            // Strays and buried points are no part of it, and of points at one place the first counts.
            if cloud.positions[i] != cloud.positions[own]
                && surfels.stands_for(k, cloud.positions[i])
            {
                surfels.reflectance[k] += cloud.reflectance[i];
                surfels.emission[k] += cloud.emission[i];
                counts[k] += 1.0;
            }
        }
        for (k, count) in counts
            .into_iter()
            .enumerate()
            .filter(|&(_, count)| count > 1.0)
        {
            surfels.reflectance[k] /= count;
            surfels.emission[k] /= count;
        }
        for place in self.places.iter().flatten().map(|k| *k as usize) {
            if let Some(back) = surfels.back(place) {
                surfels.reflectance[back] = surfels.reflectance[place];
                surfels.emission[back] = surfels.emission[place];
            }
        }
        self.holes.raise(&mut surfels.reflectance);
        Ok(())
    }

    /// Hands the irradiance of the surfels, as the equation has it, to the points of the cloud. Of a fitted surface points lie between
    /// surfels: that of few lamps, which is sharp, is found anew at each point.
    pub fn map(
        &self,
        scene: &Scene,
        irradiance: &[DVec3],
        progress: &dyn Progress,
    ) -> Result<IlluminationMap> {
        let surfels = &*self.surfels;
        let occluders = self.occluders.as_deref();
        let mut lit = Lit {
            surfels,
            irradiance: &[],
            lamps: Vec::new(),
            occluders,
        };
        let mut rest = irradiance.to_vec();
        if self.fitted && scene.lights.len() <= LAMPS {
            let visibility: Box<dyn Visibility> = match occluders {
                Some(occluders) => Box::new(CpuVisibility::<f32>::new(occluders)),
                None => Box::new(NothingInTheWay),
            };
            for light in &scene.lights {
                let one = std::slice::from_ref(light);
                let mut lit_by =
                    lights::point_lights(surfels, one, &*visibility, progress)?.irradiance;
                self.holes.lower(&mut lit_by);
                let place = (light.position - surfels.origin).as_vec3();
                let faces = |i: usize| (place - surfels.positions[i]).dot(surfels.normals[i]) > 0.0;
                let seen = |(i, h): (usize, &DVec3)| faces(i).then_some(*h != DVec3::ZERO);
                lit.lamps.push(Lamp {
                    light,
                    seen_from: lit_by.iter().enumerate().map(seen).collect(),
                });
                rest.iter_mut().zip(lit_by).for_each(|(rest, h)| *rest -= h);
            }
        }
        self.holes.fill(&mut rest);
        lit.irradiance = &rest;
        IlluminationMap::of(&scene.cloud, &self.places, &lit, progress)
    }
}
