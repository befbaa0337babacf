//! The main job: scene in, illumination map and what it took out.

use std::collections::BTreeMap;
use std::time::Instant;

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use serde::Serialize;

use crate::error::{Error, Result};
use crate::lights;
use crate::links::{self, Accuracy, Links};
use crate::map::IlluminationMap;
use crate::octree::Octree;
use crate::operator::{Direct, Fields, Fmm, GpuFmm, TransportOperator};
use crate::passes::gpu::{Gpu, GpuVisibility};
use crate::points::{Prepared, Surfels};
use crate::progress::Progress;
use crate::scene::Scene;
use crate::solve::{Ended, Stop, solve};
use crate::visibility::{Counted, CpuVisibility, NothingInTheWay, Occluders, Visibility};

/// How the transport operator is applied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Exact sum over all pairs of surfels, in f64 on the CPU: the truth, for small clouds.
    Direct,
    /// Links between facets, expansions, tested visibility.
    Fmm,
    /// `Direct` where that is cheaper, otherwise `Fmm`.
    #[default]
    Auto,
}

/// What stands in the way of light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Occlusion {
    /// The cells of the surfels.
    #[default]
    Surfels,
    /// Nothing.
    None,
}

/// What is asked for.
#[derive(Clone, Debug, Default)]
pub struct Options {
    pub method: Method,
    pub occlusion: Occlusion,
    /// Relative error asked for; `None` takes the scene's, or 0.03.
    pub tolerance: Option<f64>,
    /// Bounces to follow; `None` goes on until the solution stands.
    pub max_bounces: Option<u32>,
    pub seed: u64,
}

/// Seconds spent, by stage.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Seconds {
    /// Reading or generating the points.
    pub load: f64,
    /// Neighbours, cells, duplicates.
    pub prepare: f64,
    pub octree: f64,
    /// Finding links, without their segments.
    pub links: f64,
    /// Testing segments, for links and lights.
    pub visibility: f64,
    /// Applying the operator until convergence.
    pub solve: f64,
    pub write: f64,
    pub total: f64,
}

/// Row sums of the operator before any clamp: at most 1 for a true form-factor matrix.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct RowSum {
    pub max: f64,
    pub mean: f64,
}

/// What a solve took and how well it went: the content of `--stats`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Stats {
    /// Points of the cloud.
    pub points: usize,
    /// Points that take part in the transport.
    pub surfels: usize,
    pub method: Method,
    /// "cpu" or "gpu".
    pub backend: String,
    /// Name of the GPU adapter, if one was used.
    pub adapter: Option<String>,
    pub tolerance: f64,
    /// Applications of the operator by the solver.
    pub iterations: u32,
    /// Relative L2 residual of the radiosity equation at the end.
    pub residual: f64,
    pub converged: bool,
    pub seconds: Seconds,
    /// Number of links by kind.
    pub links: BTreeMap<String, u64>,
    /// Segments tested for visibility.
    pub segments: u64,
    pub peak_memory_bytes: Option<u64>,
    pub row_sum: RowSum,
    /// What was repaired or left out, in words with counts.
    pub repairs: Vec<String>,
}

/// The map and what it took.
#[derive(Clone, Debug, Default)]
pub struct Illumination {
    pub map: IlluminationMap,
    /// The surfels that the points stood for, in the order of the octree.
    pub surfels: Surfels,
    pub stats: Stats,
}

/// Where the passes run.
pub enum Backend<'a> {
    /// f32 on all threads of the current rayon pool.
    Cpu,
    /// WGSL on a device that the caller made.
    Gpu {
        device: &'a wgpu::Device,
        queue: &'a wgpu::Queue,
        adapter: &'a str,
    },
}

/// Clouds up to this size are summed up directly when the method is left open: finding links
/// would cost more segments than testing all pairs.
const DIRECT_UP_TO: usize = 1000;

/// Default of [`Options::tolerance`].
pub const DEFAULT_TOLERANCE: f64 = 0.03;

/// Computes the illumination map of a scene.
pub fn illuminate(
    scene: &Scene,
    options: &Options,
    backend: Backend,
    progress: &dyn Progress,
) -> Result<Illumination> {
    let tolerance = options
        .tolerance
        .or(scene.tolerance)
        .unwrap_or(DEFAULT_TOLERANCE);
    let mut clock = Clock::start();
    let prepared = Surfels::prepare(&scene.cloud, progress)?;
    let prepare = clock.lap();
    progress.stage("octree", 1);
    let (octree, surfels) = Octree::build(&prepared.surfels);
    let occluders = match options.occlusion {
        Occlusion::Surfels => Some(Occluders::build(&surfels)),
        Occlusion::None => None,
    };
    let octree_seconds = clock.lap();

    let method = match (options.method, &backend) {
        (Method::Direct, Backend::Gpu { .. }) => {
            return Err(Error::Usage(
                "the direct method is the reference in f64 and runs on the CPU only: use \
                 --backend cpu, or --method fmm"
                    .into(),
            ));
        }
        (Method::Auto, Backend::Cpu) if surfels.len() <= DIRECT_UP_TO => Method::Direct,
        (Method::Auto, _) => Method::Fmm,
        (chosen, _) => chosen,
    };
    let on_cpu;
    let on_gpu;
    let tester: &dyn Visibility = match (&occluders, &backend) {
        (None, _) => &NothingInTheWay,
        (Some(occluders), Backend::Cpu) => {
            on_cpu = CpuVisibility::<f32>::new(occluders);
            &on_cpu
        }
        (Some(occluders), Backend::Gpu { device, queue, .. }) => {
            on_gpu = GpuVisibility::new(&Gpu::new(device, queue), occluders)?;
            &on_gpu
        }
    };
    let visibility = Counted::new(tester);
    let task = Task {
        scene,
        surfels: &surfels,
        octree: &octree,
        visibility: &visibility,
        tolerance,
        max_bounces: options.max_bounces,
        seed: options.seed,
        progress,
    };
    let mut repairs = prepared.repairs.clone();
    let solved = match (method, &backend) {
        (Method::Direct, _) => task.direct(&mut repairs)?,
        (_, Backend::Cpu) => task.fmm(&mut repairs, &|links, work| {
            work.solve(&Fmm::<f32>::new(&surfels, &octree, links), progress)
        })?,
        (_, Backend::Gpu { device, queue, .. }) => task.fmm(&mut repairs, &|links, work| {
            let gpu = Gpu::new(device, queue);
            work.solve(&GpuFmm::new(&gpu, &surfels, &octree, links)?, progress)
        })?,
    };
    let rest = clock.lap();
    let map = to_points(scene, &prepared, &surfels, &solved.irradiance);
    let (name, adapter) = match backend {
        Backend::Cpu => ("cpu", None),
        Backend::Gpu { adapter, .. } => ("gpu", Some(adapter.to_owned())),
    };
    Ok(Illumination {
        map,
        stats: Stats {
            points: scene.cloud.len(),
            surfels: surfels.len(),
            method,
            backend: name.into(),
            adapter,
            tolerance,
            iterations: solved.ended.iterations,
            residual: solved.ended.residual,
            converged: solved.ended.converged,
            seconds: Seconds {
                prepare,
                octree: octree_seconds,
                visibility: visibility.seconds(),
                solve: solved.seconds,
                links: (rest - visibility.seconds() - solved.seconds).max(0.0),
                ..Seconds::default()
            },
            links: solved.links,
            segments: visibility.segments(),
            peak_memory_bytes: None,
            row_sum: solved.row_sum,
            repairs,
        },
        surfels,
    })
}

/// What stays the same through a run.
struct Task<'a> {
    scene: &'a Scene,
    surfels: &'a Surfels,
    octree: &'a Octree,
    visibility: &'a Counted<'a>,
    tolerance: f64,
    max_bounces: Option<u32>,
    seed: u64,
    progress: &'a dyn Progress,
}

/// Irradiance of the surfels, and how it was found.
#[derive(Default)]
struct Solved {
    irradiance: Vec<DVec3>,
    ended: Ended,
    row_sum: RowSum,
    links: BTreeMap<String, u64>,
    /// Seconds of the solver.
    seconds: f64,
}

/// A radiosity equation to solve: everything but the operator.
struct Work<'a> {
    surfels: &'a Surfels,
    /// Irradiance straight from the lights.
    lights: &'a [DVec3],
    /// Reflected radiosity to start from.
    start: Option<&'a [DVec3]>,
    stop: Stop,
}

/// Solution of a [`Work`].
struct Bounced {
    irradiance: Vec<DVec3>,
    reflected: Vec<DVec3>,
    ended: Ended,
    row_sum: RowSum,
}

impl Task<'_> {
    /// Everything by exact sums, the light of emitting surfels too.
    fn direct(&self, repairs: &mut Vec<String>) -> Result<Solved> {
        let operator = Direct::new(self.surfels, self.visibility, self.progress)?;
        let mut lights = self.lights(repairs)?;
        let emission: Vec<DVec3> = self.surfels.emission.iter().map(|e| e.as_dvec3()).collect();
        let start = Instant::now();
        for (light, emitted) in lights.iter_mut().zip(operator.apply(&emission)?) {
            *light += emitted;
        }
        let bounced = self
            .work(&lights, None, self.stop())
            .solve(&operator, self.progress)?;
        Ok(Solved {
            irradiance: bounced.irradiance,
            ended: bounced.ended,
            row_sum: bounced.row_sum,
            seconds: start.elapsed().as_secs_f64(),
            ..Solved::default()
        })
    }

    /// Lights per surfel, then links for what is reflected: rough ones first, whose solution says
    /// where light is strong and where it is weak, then those that keep the tolerance.
    fn fmm(
        &self,
        repairs: &mut Vec<String>,
        solve: &dyn Fn(&Links, &Work) -> Result<Bounced>,
    ) -> Result<Solved> {
        let mut lights = self.lights(repairs)?;
        let emitted = lights::emitters(
            self.surfels,
            self.tolerance,
            self.seed,
            self.visibility,
            self.progress,
        )?;
        for (light, emitted) in lights.iter_mut().zip(emitted) {
            *light += emitted;
        }
        let reflectance = || self.surfels.reflectance.iter().map(|r| r.as_dvec3());
        let ambient: DVec3 = lights.iter().sum::<DVec3>() / lights.len() as f64;
        let guess: Vec<DVec3> = lights
            .iter()
            .zip(reflectance())
            .map(|(h, r)| r * (*h + ambient))
            .collect();
        if guess.iter().all(|b| *b == DVec3::ZERO) || self.max_bounces == Some(0) {
            // Nothing is reflected.
            return Ok(Solved {
                irradiance: lights,
                ended: Ended {
                    converged: true,
                    ..Ended::default()
                },
                ..Solved::default()
            });
        }
        let rough_stop = Stop {
            residual: ROUGH_RESIDUAL,
            bounces: None,
        };
        let mut seconds = 0.0;
        let mut run = |accuracy: &Accuracy, start: Option<&[DVec3]>, stop: Stop| {
            let links = links::build(
                self.surfels,
                self.octree,
                accuracy,
                self.visibility,
                self.progress,
            )?;
            let clock = Instant::now();
            let bounced = solve(&links, &self.work(&lights, start, stop))?;
            seconds += clock.elapsed().as_secs_f64();
            Ok((links, bounced))
        };
        let rough = self.accuracy(&guess, None, ROUGH_ERROR);
        let (_, rough) = run(&rough, None, rough_stop)?;
        let fine = self.accuracy(
            &rough.reflected,
            Some(&rough.irradiance),
            ERROR_A_LINK * self.tolerance,
        );
        let (links, fine) = run(&fine, Some(&rough.reflected), self.stop())?;
        Ok(Solved {
            irradiance: fine.irradiance,
            ended: fine.ended,
            row_sum: fine.row_sum,
            links: links
                .counts()
                .map(|(kind, n)| (kind.to_owned(), n))
                .into_iter()
                .collect(),
            seconds,
        })
    }

    /// Point lights and sky.
    fn lights(&self, repairs: &mut Vec<String>) -> Result<Vec<DVec3>> {
        let scene = self.scene;
        let lit =
            lights::point_lights(self.surfels, &scene.lights, self.visibility, self.progress)?;
        if lit.too_close > 0 {
            repairs.push(format!(
                "{} surfels lie closer to a light than their own radius: lit as from that radius",
                lit.too_close
            ));
        }
        let mut irradiance = lit.irradiance;
        if scene.sky != Vec3::ZERO {
            let sky = lights::sky(
                self.surfels,
                scene.sky,
                self.tolerance,
                self.seed,
                self.visibility,
                self.progress,
            )?;
            for (h, s) in irradiance.iter_mut().zip(sky) {
                *h += s;
            }
        }
        Ok(irradiance)
    }

    /// The accuracy asked of links: `relative` to the mean irradiance, and finer or coarser where
    /// a first solution says that a place is darker or brighter than the mean.
    fn accuracy(
        &self,
        reflected: &[DVec3],
        irradiance: Option<&[DVec3]>,
        relative: f64,
    ) -> Accuracy {
        let mean = |field: &[DVec3]| {
            field.iter().map(|h| h.element_sum() / 3.0).sum::<f64>() / field.len() as f64
        };
        let level = mean(irradiance.unwrap_or(reflected)).max(f64::MIN_POSITIVE);
        let local = |range: std::ops::Range<usize>| {
            let least = irradiance.map_or(level, |h| {
                h[range]
                    .iter()
                    .map(|h| h.element_sum() / 3.0)
                    .fold(f64::INFINITY, f64::min)
            });
            (least / level).clamp(LOCAL_TOLERANCE[0], LOCAL_TOLERANCE[1]) as f32
        };
        let strongest = |range: std::ops::Range<usize>| {
            reflected[range]
                .iter()
                .map(|b| b.max_element())
                .fold(0.0, f64::max) as f32
        };
        let facets = &self.octree.facets;
        Accuracy {
            error: (relative * level) as f32,
            radiosity: facets.par_iter().map(|f| strongest(f.surfels())).collect(),
            target_factor: facets.par_iter().map(|f| local(f.surfels())).collect(),
            seed: self.seed,
        }
    }

    fn work<'w>(&'w self, lights: &'w [DVec3], start: Option<&'w [DVec3]>, stop: Stop) -> Work<'w> {
        Work {
            surfels: self.surfels,
            lights,
            start,
            stop,
        }
    }

    fn stop(&self) -> Stop {
        Stop {
            residual: (0.03 * self.tolerance).min(1e-3),
            bounces: self.max_bounces,
        }
    }
}

/// Allowed error of a link in units of the tolerance and the mean irradiance. Errors of many links
/// add up; the ratio is measured: links allowed 0.01 give a relative error of 0.014 to 0.028.
const ERROR_A_LINK: f64 = 0.5;
/// The same for the first, rough links.
const ROUGH_ERROR: f64 = 0.3;
/// Residual to which the rough links are solved.
const ROUGH_RESIDUAL: f64 = 0.03;
/// Bounds of the factor on a link's error from the light at its target.
const LOCAL_TOLERANCE: [f64; 2] = [0.1, 3.0];

impl Work<'_> {
    /// Solves for the reflected radiosity, then takes one more step, whose change is the residual.
    fn solve<O: TransportOperator>(
        &self,
        operator: &O,
        progress: &dyn Progress,
    ) -> Result<Bounced> {
        let fields = operator.fields();
        let reflectance: Vec<DVec3> = self
            .surfels
            .reflectance
            .iter()
            .map(|r| r.as_dvec3())
            .collect();
        let source: Vec<DVec3> = self
            .lights
            .iter()
            .zip(&reflectance)
            .map(|(h, r)| h * r)
            .collect();
        let start = self.start.map(|s| fields.upload(s)).transpose()?;
        let (reflected, ended) = solve(
            operator,
            &fields.upload(&reflectance)?,
            &fields.upload(&source)?,
            start,
            self.stop,
            progress,
        )?;
        let bounced = fields.download(&operator.apply(&reflected)?)?;
        let irradiance: Vec<DVec3> = bounced
            .iter()
            .zip(self.lights)
            .map(|(h, light)| (*h + *light).max(DVec3::ZERO))
            .collect();
        if irradiance.iter().any(|h| !h.is_finite()) {
            return Err(Error::Invalid(
                "the solution is not finite: are areas or emissions of extreme size?".into(),
            ));
        }
        let row_sums = fields
            .download(&operator.apply(&fields.upload(&vec![DVec3::ONE; self.surfels.len()])?)?)?;
        Ok(Bounced {
            reflected: irradiance
                .iter()
                .zip(&reflectance)
                .map(|(h, r)| h * r)
                .collect(),
            irradiance,
            ended,
            row_sum: RowSum {
                max: row_sums.iter().fold(0.0, |m, r| m.max(r.x)),
                mean: row_sums.iter().map(|r| r.x).sum::<f64>() / row_sums.len() as f64,
            },
        })
    }
}

/// The light of the surfels handed to the points of the cloud.
fn to_points(
    scene: &Scene,
    prepared: &Prepared,
    surfels: &Surfels,
    irradiance: &[DVec3],
) -> IlluminationMap {
    let cloud = &scene.cloud;
    let mut index_of_point = vec![0_u32; cloud.len()];
    for (k, &p) in surfels.points.iter().enumerate() {
        index_of_point[p as usize] = k as u32;
    }
    let mut map = IlluminationMap::default();
    for (i, surfel) in prepared.surfel_of_point.iter().enumerate() {
        let own = surfel.map(|s| prepared.surfels.points[s as usize] as usize);
        let (light, area) = own.map_or((Vec3::ZERO, 0.0), |p| {
            let k = index_of_point[p] as usize;
            (irradiance[k].as_vec3(), surfels.areas[k])
        });
        map.irradiance.push(light);
        map.radiosity
            .push(cloud.emission[i] + cloud.reflectance[i] * light);
        map.radius.push((area / std::f32::consts::PI).sqrt());
        map.in_transport.push(own == Some(i));
    }
    map
}

/// A stop watch with laps.
struct Clock(Instant);

impl Clock {
    fn start() -> Self {
        Clock(Instant::now())
    }

    /// Seconds since the start or the last lap.
    fn lap(&mut self) -> f64 {
        let seconds = self.0.elapsed().as_secs_f64();
        self.0 = Instant::now();
        seconds
    }
}
