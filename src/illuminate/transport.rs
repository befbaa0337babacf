//! The transport of light between the points of a cloud, kept for many lights.

use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use super::checkpoint::{Checkpoint, Stages, fingerprint};
use super::geometry::Geometry;
use super::linked::Linked;
use super::options::{check, check_scene, tolerance};
use super::rays::{Cast, First};
use super::stats::{Seconds, Stats};
use super::task::{Solved, Task};
use super::work::Work;
use super::{Backend, Illumination, Method, Occlusion, Options, file};
use crate::error::{Error, Result};
use crate::links::{Kept, Links, Thresholds};
use crate::operator::{Fmm, GpuFmm, trial};
use crate::passes::gpu::{Gpu, GpuPointVisibility, GpuVisibility};
use crate::plan::{Plan, expanded, named};
use crate::points::{Openness, Quality, Surfels};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::smoothing::Surroundings;
use crate::visibility::{
    Counted, CpuPointVisibility, CpuVisibility, NothingInTheWay, Occluders, PointVisibility,
    Visibility,
};

/// How light goes between the points of one cloud. Found once, it serves many lights.
///
/// Who sees whom does not depend on the light. What was found out for one light is kept for the next:
/// [`illuminate`](Transport::illuminate) then takes the direct light of each surfel and some applications
/// of the operator. With the method [`Fmm`](Method::Fmm) that are links, of which those that another light
/// needs more accurately are refined, no others; on a GPU they stay there. With [`Gather`](Method::Gather)
/// it is what rays met, which serves any light; more of them are cast where the tolerance asks for it. The
/// other methods keep surfels, octree and what stands in the way.
///
/// ```no_run
/// # use std::path::Path;
/// # use fmmgi_gpu::progress::Silent;
/// # use fmmgi_gpu::scene::SceneOptions;
/// # use fmmgi_gpu::{Backend, Method, Options, Scene, Transport};
/// let mut scene = Scene::load(Path::new("room.toml"), &SceneOptions::default(), &Silent)?;
/// let mut transport = Transport::new(&scene, &Options::default(), Backend::Cpu, &Silent)?;
/// for step in 0..10 {
///     scene.lights[0].position.x = 0.1 * f64::from(step);
///     let lit = transport.illuminate(&scene, &Silent)?;
/// }
/// # Ok::<(), fmmgi_gpu::Error>(())
/// ```
pub struct Transport {
    options: Options,
    method: Method,
    /// Whether links go without tests: nothing is in the way, or nothing seems to be.
    untested: bool,
    /// What the method follows from; there is none for an operator from a file.
    plan: Option<Plan>,
    geometry: Geometry,
    linked: Linked,
    /// What rays met, once they were cast.
    cast: Option<Cast>,
    /// Who is next to whom, once it was asked for.
    around: OnceLock<Arc<Surroundings>>,
    device: Option<Device>,
    /// What making the geometry took, until it is told.
    prepared: Seconds,
}

/// Where the passes run, if that is not the CPU.
struct Device {
    gpu: Gpu,
    adapter: String,
    visibility: Option<GpuVisibility<Arc<Occluders>>>,
}

impl Transport {
    /// Makes the cloud of a scene ready. Nothing is linked, and no ray is cast, until the first light comes.
    pub fn new(
        scene: &Scene,
        options: &Options,
        backend: Backend,
        progress: &dyn Progress,
    ) -> Result<Transport> {
        let plan = Plan::new(scene, options, &backend)?;
        Transport::planned(scene, options, backend, plan, progress)
    }

    /// The same as a plan says, whose method, order and size of the leaves may be others than ours.
    ///
    /// # Errors
    /// Those of [`new`](Transport::new).
    pub fn planned(
        scene: &Scene,
        options: &Options,
        backend: Backend,
        plan: Plan,
        progress: &dyn Progress,
    ) -> Result<Transport> {
        check(scene, options, &backend)?;
        plan.check()?;
        if let Some(choice) = plan.choices.first() {
            progress.note(&format!("method: {}, {}", choice.taken, choice.why));
        }
        let (geometry, prepared) = Geometry::prepare(scene, options, &plan, progress)?;
        let kept = Kept::none(&geometry.octree, &geometry.surfels);
        let method = plan.method;
        let transport = Transport::of(geometry, kept, method, options, backend, prepared)?;
        Ok(Transport {
            untested: plan.visibility == Occlusion::None,
            plan: Some(plan),
            ..transport
        })
    }

    /// The surfels that take part, in the order of their octree.
    pub fn surfels(&self) -> &Surfels {
        &self.geometry.surfels
    }

    /// What was mended, merged or left out, with counts.
    pub fn repairs(&self) -> &[String] {
        &self.geometry.repairs
    }

    /// How good the cloud is as a surface; `None` of a transport from a file.
    pub fn quality(&self) -> Option<&Quality> {
        self.geometry.quality.as_ref()
    }

    /// How far the surface is closed; `None` without occlusion.
    pub fn openness(&self) -> Option<Openness> {
        let occluders = self.geometry.occluders.as_ref()?;
        Some(Openness::of(&self.geometry.surfels, occluders))
    }

    /// Writes surfels, octree and links to a file, from which they can be [loaded](Transport::load)
    /// for the same cloud.
    ///
    /// Fails with [`Error::Usage`] where there are no links to keep: without tests of visibility, and with
    /// another method than `Fmm`, which `Auto` may have taken.
    pub fn save(&self, path: &Path) -> Result<()> {
        let options = Options {
            method: self.method,
            occlusion: match self.untested {
                true => Occlusion::None,
                false => Occlusion::Surfels,
            },
            ..self.options.clone()
        };
        options.check_keeping()?;
        file::save(path, &self.geometry, self.linked.kept())
    }

    /// A transport from a file, for the cloud of a scene that it was [saved](Transport::save) for. The
    /// method is `Fmm`.
    ///
    /// Fails with [`Error::Input`] if the file is for another cloud, of another version, damaged, or
    /// made up; with [`Error::Usage`] if the options do not fit to it.
    pub fn load(
        path: &Path,
        scene: &Scene,
        options: &Options,
        backend: Backend,
        progress: &dyn Progress,
    ) -> Result<Transport> {
        check(scene, options, &backend)?;
        options.check_keeping()?;
        progress.stage("operator", 1);
        let start = Instant::now();
        let (geometry, kept) = file::load(path, &scene.cloud)?;
        if options.order.is_some_and(|order| order != geometry.order) {
            return Err(Error::Usage(format!(
                "{}: its expansions are of order {}: leave the order out, or make it again",
                path.display(),
                geometry.order
            )));
        }
        let seconds = Seconds {
            prepare: start.elapsed().as_secs_f64(),
            ..Seconds::default()
        };
        Transport::of(geometry, kept, Method::Fmm, options, backend, seconds)
    }

    fn of(
        geometry: Geometry,
        kept: Kept,
        method: Method,
        options: &Options,
        backend: Backend,
        prepared: Seconds,
    ) -> Result<Transport> {
        let device = Device::of(backend, geometry.occluders.clone(), geometry.order)?;
        let gpu = device.as_ref().map(|d| d.gpu.clone());
        Ok(Transport {
            options: options.clone(),
            method,
            untested: false,
            plan: None,
            linked: Linked::new(kept, gpu),
            cast: None,
            around: OnceLock::new(),
            geometry,
            device,
            prepared,
        })
    }

    /// Computes the illumination map of a scene with this cloud. What its points reflect and emit, its
    /// lights and its tolerance may be others than before.
    ///
    /// Fails with [`Error::Invalid`] if the points are others.
    pub fn illuminate(&mut self, scene: &Scene, progress: &dyn Progress) -> Result<Illumination> {
        self.stage_by_stage(scene, None, progress)
    }

    /// The same, stage by stage: what was found is left in a checkpoint, and what a run before has left
    /// there is taken from it. The result has the same bits, wherever that run was killed, if the
    /// backend is the same.
    ///
    /// Preparing the cloud is no such stage; the methods but `Fmm` have a single one.
    ///
    /// Fails with [`Error::Input`] if the checkpoint is that of another input or other options.
    pub fn illuminate_from(
        &mut self,
        scene: &Scene,
        checkpoint: &Checkpoint,
        progress: &dyn Progress,
    ) -> Result<Illumination> {
        self.stage_by_stage(scene, Some(checkpoint), progress)
    }

    fn stage_by_stage(
        &mut self,
        scene: &Scene,
        checkpoint: Option<&Checkpoint>,
        progress: &dyn Progress,
    ) -> Result<Illumination> {
        let start = Instant::now();
        let tolerance = tolerance(scene, &self.options);
        check_scene(scene, tolerance)?;
        self.geometry.paint(&scene.cloud)?;
        let geometry = &self.geometry;
        let tester = tester(geometry, self.method, self.device.as_ref());
        let visibility = Counted::new(tester.as_ref());
        let stages = match checkpoint {
            None => Stages::unkept(&visibility),
            Some(checkpoint) => {
                let run = self.fingerprint(scene, tolerance)?;
                Stages::new(checkpoint, run, &visibility, progress)?
            }
        };
        let task = Task {
            scene,
            surfels: &geometry.surfels,
            octree: &geometry.octree,
            visibility: &visibility,
            holes: &geometry.holes,
            untested: self.untested,
            around: &self.around,
            tolerance,
            order: geometry.order,
            max_bounces: self.options.max_bounces,
            below_model: self.options.below_model,
            seed: self.options.seed,
            stages: &stages,
            progress,
        };
        let mut repairs = geometry.repairs.clone();
        let (mut method, mut solved) = match self.method {
            Method::Fmm => (Method::Fmm, task.fmm(&mut self.linked, &mut repairs)?),
            // Lights alone, which are the same.
            Method::Gather if !task.reflects() => {
                (Method::Gather, task.fmm(&mut self.linked, &mut repairs)?)
            }
            method => {
                let way = Way {
                    method,
                    first: First::of(self.plan.as_ref(), self.options.rays),
                    occluders: geometry.occluders.as_deref(),
                    gpu: self.device.as_ref().map(|device| &device.gpu),
                };
                let cast = &mut self.cast;
                let solve = |mended: &mut Vec<String>| way.solve(&task, cast, mended);
                (method, in_stage(&stages, &mut repairs, solve)?)
            }
        };
        let instead = self.plan.as_ref().and_then(|plan| plan.instead);
        if let (true, Some(instead)) = (solved.in_vain, instead) {
            let (why, tests) = match self.untested {
                true => ("something is in the way", " with tests"),
                false => ("more rays are in vain", ""),
            };
            progress.note(&format!("{why}: {}{tests} instead", named(instead)));
            repairs.clone_from(&geometry.repairs);
            // For the lights to come, too.
            method = instead;
            (self.method, self.cast) = (instead, None);
            if self.untested {
                (self.linked, self.untested) = (self.linked.rough(&task), false);
            }
            let task = Task {
                untested: false,
                ..task
            };
            solved = match instead {
                Method::Direct => in_stage(&stages, &mut repairs, |mended| task.direct(mended))?,
                _ => task.fmm(&mut self.linked, &mut repairs)?,
            };
        }
        if solved.irradiance.iter().any(|h| !h.as_vec3().is_finite()) {
            return Err(Error::Invalid(
                "the light is not finite: is a light of extreme intensity next to a point?".into(),
            ));
        }
        if let Some(checked) = solved.checked
            && checked.row_sum.is_crowded()
        {
            repairs.push(format!(
                "points see {:.2} times what can be around them: areas, or layers of points, are too \
                 large for the surface, and the light is too bright",
                checked.row_sum.mean
            ));
        }
        let tests = visibility.seconds() + solved.tests + solved.rays.map_or(0.0, |r| r.seconds);
        let checks = solved.checked.map_or(0.0, |c| c.seconds);
        let rest = start.elapsed().as_secs_f64() - tests - solved.seconds - solved.verification;
        let adapter = self.device.as_ref().map(|d| d.adapter.clone());
        let stats = Stats {
            points: scene.cloud.len(),
            surfels: geometry.surfels.len(),
            method,
            backend: if adapter.is_some() { "gpu" } else { "cpu" }.into(),
            adapter,
            tolerance,
            order: expanded(method).then_some(geometry.order),
            iterations: solved.ended.iterations,
            residual: solved.ended.residual,
            converged: solved.ended.converged,
            seconds: Seconds {
                visibility: tests,
                solve: solved.seconds - checks,
                checks,
                verification: solved.verification,
                links: rest.max(0.0),
                ..std::mem::take(&mut self.prepared)
            },
            links: solved.links,
            rays: solved.rays.map(|rays| rays.count),
            segments: visibility.segments(),
            peak_memory_bytes: None,
            holes: geometry.holes.shares,
            row_sum: solved.checked.map(|c| c.row_sum),
            checks: solved.checked.map(|c| c.checks),
            error: solved.verified,
            surface_error: None,
            model_error: solved.model_error,
            fitted: geometry.fitted,
            repairs,
            plan: self.plan.clone(),
        };
        let mut direct = solved.direct;
        geometry.holes.fill(&mut direct);
        Ok(Illumination {
            map: geometry.map(scene, &solved.irradiance, progress)?,
            surfels: geometry.surfels.clone(),
            direct,
            stats,
        })
    }

    /// What decides on the light: input, options, the links that are there, and the version. Not the
    /// backend: what one has begun, another can go on with.
    fn fingerprint(&self, scene: &Scene, tolerance: f64) -> Result<u64> {
        let cloud = &scene.cloud;
        let told = format!(
            "{} {:?} {} {:?} {tolerance} {} {}",
            env!("CARGO_PKG_VERSION"),
            self.method,
            self.untested,
            self.options,
            self.geometry.order,
            self.geometry.fingerprint,
        );
        let lights: Vec<_> = (scene.lights.iter())
            .map(|light| (light.position, light.intensity))
            .collect();
        let colours = (&cloud.reflectance, &cloud.emission);
        let kept = (self.linked.kept(), self.cast.as_ref().map(Cast::state));
        fingerprint(&(told, lights, scene.sky, colours, kept))
    }
}

/// Another method than `Fmm`, and what it takes.
struct Way<'a> {
    method: Method,
    first: First,
    occluders: Option<&'a Occluders>,
    gpu: Option<&'a Gpu>,
}

impl Way<'_> {
    /// Nothing is kept for other lights but what rays met.
    fn solve(
        &self,
        task: &Task,
        cast: &mut Option<Cast>,
        repairs: &mut Vec<String>,
    ) -> Result<Solved> {
        let (surfels, octree, progress) = (task.surfels, task.octree, task.progress);
        let gpu = self.gpu;
        let solve = |links: &Links, work: &Work| match gpu {
            None => work.solve_by_links(&Fmm::new(surfels, octree, links), progress),
            Some(gpu) => work.solve(&GpuFmm::new(gpu, surfels, octree, links)?, progress),
        };
        match (self.method, self.occluders) {
            (Method::Gather, Some(occluders)) => {
                task.gather(occluders, self.first, cast, repairs, &solve)
            }
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
            _ => task.direct(repairs),
        }
    }
}

/// A solution that is one stage, and what it mended.
fn in_stage(
    stages: &Stages,
    repairs: &mut Vec<String>,
    solve: impl FnOnce(&mut Vec<String>) -> Result<Solved>,
) -> Result<Solved> {
    let (solved, mended) = stages.next(|| {
        let mut mended = Vec::new();
        Ok((solve(&mut mended)?, mended))
    })?;
    repairs.extend(mended);
    Ok(solved)
}

impl Device {
    /// The device of a backend, if it has one, after a trial.
    fn of(
        backend: Backend,
        occluders: Option<Arc<Occluders>>,
        order: usize,
    ) -> Result<Option<Device>> {
        let Backend::Gpu {
            device,
            queue,
            adapter,
        } = backend
        else {
            return Ok(None);
        };
        let gpu = Gpu::new(device, queue);
        trial(&gpu, order)?;
        let visibility = occluders.map(|occluders| GpuVisibility::new(&gpu, occluders));
        Ok(Some(Device {
            visibility: visibility.transpose()?,
            gpu,
            adapter: adapter.to_owned(),
        }))
    }
}

/// What tests segments: f64 for the reference, f32 or the device for the product.
fn tester<'a>(
    geometry: &'a Geometry,
    method: Method,
    device: Option<&'a Device>,
) -> Box<dyn Visibility + 'a> {
    let on_device = device.and_then(|d| d.visibility.as_ref());
    match (&geometry.occluders, on_device) {
        (None, _) => Box::new(NothingInTheWay),
        (Some(_), Some(on_device)) => Box::new(on_device),
        (Some(occluders), None) if method == Method::Direct => {
            Box::new(CpuVisibility::<f64>::new(occluders))
        }
        (Some(occluders), None) => Box::new(CpuVisibility::<f32>::new(occluders)),
    }
}
