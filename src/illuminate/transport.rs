//! The transport of light between the points of a cloud, kept for many lights.

use std::time::Instant;

use super::geometry::Geometry;
use super::options::{DEFAULT_TOLERANCE, check_options, check_scene, choose};
use super::stats::{Seconds, Stats};
use super::task::{Solved, Task};
use super::work::Work;
use super::{Backend, Illumination, Method, Options};
use crate::error::Result;
use crate::links::{Links, Thresholds};
use crate::operator::{Fmm, GpuFmm};
use crate::passes::gpu::{Gpu, GpuPointVisibility, GpuVisibility};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::visibility::{
    Counted, CpuPointVisibility, CpuVisibility, NothingInTheWay, Occluders, PointVisibility,
    Visibility,
};

/// A cloud that is made ready once and lit as often as one likes.
pub struct Transport {
    options: Options,
    method: Method,
    geometry: Geometry,
    device: Option<Device>,
    /// What making it ready took, until it is told.
    prepared: Seconds,
}

/// Where the passes run, if that is not the CPU.
struct Device {
    gpu: Gpu,
    adapter: String,
}

impl Transport {
    /// Makes the cloud of a scene ready.
    pub fn new(
        scene: &Scene,
        options: &Options,
        backend: Backend,
        progress: &dyn Progress,
    ) -> Result<Transport> {
        let tolerance = tolerance(scene, options);
        check_scene(scene, tolerance)?;
        check_options(options, &backend)?;
        let (geometry, prepared) =
            Geometry::prepare(&scene.cloud, options, tolerance, &backend, progress)?;
        Ok(Transport {
            options: options.clone(),
            method: choose(options, &backend, geometry.surfels.len()),
            geometry,
            device: match backend {
                Backend::Cpu => None,
                Backend::Gpu {
                    device,
                    queue,
                    adapter,
                } => Some(Device {
                    gpu: Gpu::new(device, queue),
                    adapter: adapter.to_owned(),
                }),
            },
            prepared,
        })
    }

    /// Computes the illumination map of a scene with this cloud, whatever its points reflect and
    /// emit, and whatever its lights.
    pub fn illuminate(&mut self, scene: &Scene, progress: &dyn Progress) -> Result<Illumination> {
        let start = Instant::now();
        let tolerance = tolerance(scene, &self.options);
        check_scene(scene, tolerance)?;
        self.geometry.paint(&scene.cloud)?;
        let geometry = &self.geometry;
        let gpu = self.device.as_ref().map(|d| &d.gpu);
        let tester = tester(geometry.occluders.as_ref(), self.method, gpu)?;
        let visibility = Counted::new(tester.as_ref());
        let task = Task {
            scene,
            surfels: &geometry.surfels,
            octree: &geometry.octree,
            visibility: &visibility,
            tolerance,
            order: geometry.order,
            max_bounces: self.options.max_bounces,
            below_model: self.options.below_model,
            seed: self.options.seed,
            progress,
        };
        let mut repairs = geometry.repairs.clone();
        let solved = self.solved(&task, gpu, &mut repairs)?;
        let tests = visibility.seconds() + solved.tests + solved.rays.map_or(0.0, |r| r.seconds);
        let checks = solved.checked.map_or(0.0, |c| c.seconds);
        let all = start.elapsed().as_secs_f64();
        let map = geometry.map(&scene.cloud, &solved.irradiance);
        let fmm = matches!(self.method, Method::Fmm | Method::Classic);
        let stats = Stats {
            points: scene.cloud.len(),
            surfels: geometry.surfels.len(),
            method: self.method,
            backend: if gpu.is_some() { "gpu" } else { "cpu" }.into(),
            adapter: self.device.as_ref().map(|d| d.adapter.clone()),
            tolerance,
            order: fmm.then_some(geometry.order),
            iterations: solved.ended.iterations,
            residual: solved.ended.residual,
            converged: solved.ended.converged,
            seconds: Seconds {
                visibility: tests,
                solve: solved.seconds - checks,
                checks,
                verification: solved.verification,
                links: (all - tests - solved.seconds - solved.verification).max(0.0),
                ..std::mem::take(&mut self.prepared)
            },
            links: solved.links,
            rays: solved.rays.map(|rays| rays.count),
            standard_error: solved.rays.map(|rays| rays.standard_error),
            segments: visibility.segments(),
            peak_memory_bytes: None,
            row_sum: solved.checked.map(|c| c.row_sum),
            checks: solved.checked.map(|c| c.checks),
            error: solved.verified,
            model_error: solved.model_error,
            repairs,
        };
        Ok(Illumination {
            map,
            surfels: geometry.surfels.clone(),
            direct: solved.direct,
            stats,
        })
    }

    fn solved(&self, task: &Task, gpu: Option<&Gpu>, repairs: &mut Vec<String>) -> Result<Solved> {
        let (surfels, octree) = (task.surfels, task.octree);
        let solve = |links: &Links, work: &Work| match gpu {
            None => work.solve(&Fmm::<f32>::new(surfels, octree, links), task.progress),
            Some(gpu) => work.solve(&GpuFmm::new(gpu, surfels, octree, links)?, task.progress),
        };
        match (self.method, &self.geometry.occluders) {
            (Method::Direct, _) => task.direct(repairs),
            (Method::Classic, _) => {
                let test = Thresholds::default().point;
                let points: Box<dyn PointVisibility> = match gpu {
                    None => Box::new(CpuPointVisibility::<f32>::new(surfels, test)),
                    Some(gpu) => Box::new(GpuPointVisibility::new(gpu, surfels, test)?),
                };
                task.classic(points.as_ref(), |links| match gpu {
                    None => task.by_operator(&Fmm::<f32>::new(surfels, octree, links), repairs),
                    Some(gpu) => {
                        task.by_operator(&GpuFmm::new(gpu, surfels, octree, links)?, repairs)
                    }
                })
            }
            (Method::Gather, Some(occluders)) => {
                task.gather(occluders, self.options.rays, repairs, &solve)
            }
            _ => task.fmm(repairs, &solve),
        }
    }
}

fn tolerance(scene: &Scene, options: &Options) -> f64 {
    let asked = options.tolerance.or(scene.tolerance);
    asked.unwrap_or(DEFAULT_TOLERANCE)
}

/// What tests segments: f64 for the reference, f32 or the device for the product.
fn tester<'a>(
    occluders: Option<&'a Occluders>,
    method: Method,
    device: Option<&Gpu>,
) -> Result<Box<dyn Visibility + 'a>> {
    Ok(match (occluders, method, device) {
        (None, ..) => Box::new(NothingInTheWay),
        (Some(occluders), Method::Direct, _) => Box::new(CpuVisibility::<f64>::new(occluders)),
        (Some(occluders), _, None) => Box::new(CpuVisibility::<f32>::new(occluders)),
        (Some(occluders), _, Some(gpu)) => Box::new(GpuVisibility::new(gpu, occluders)?),
    })
}
