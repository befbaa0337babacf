//! Links against rays at equal error, all-in: `cargo bench --bench against_gather`, with
//! `-- 20000 cornell cave` for another number of points or some of the scenes.
//!
//! Each method is held against its own limit on some receivers: links against exact sums, rays against
//! very many rays, both of the radiosity that the finest run has found. The true surface, path-traced,
//! is the same for both (the tracer knows no cave). Times compared are those of all threads together.

// Its tests are not run here.
#[allow(unused_imports)]
#[path = "../tests/tracer/mod.rs"]
mod tracer;

use fmmgi_gpu::chart::{Clock, Spent};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::exact_irradiance;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders, first_hit};
use fmmgi_gpu::{Backend, Method, Options, Scene, Surfels, illuminate, lights};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use tracer::{Bounces, Receiver, Room};

const POINTS: usize = 100_000;
const SCENES: [&str; 3] = ["cornell", "organic", "cave"];
const TRACED: [&str; 2] = ["cornell", "organic"];
const RECEIVERS: usize = 400;
/// Rays from each receiver that stand for all there are, the square of a number of strata: 0.05% or so.
const STRATA: u32 = 192;
/// Tolerances of the links.
const TOLERANCES: [f64; 5] = [0.1, 0.05, 0.03, 0.02, 0.01];
/// Rays from each point, and the tolerance for lights that goes with them.
const RAYS: [(u32, f64); 5] = [
    (16, 0.1),
    (64, 0.05),
    (256, 0.03),
    (512, 0.02),
    (1024, 0.01),
];
const PATHS: usize = 4096;

fn main() {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let points = given.iter().find_map(|a| a.parse().ok()).unwrap_or(POINTS);
    let asked = |name: &&str| given.iter().any(|a| a == name);
    let any = SCENES.iter().any(asked);
    for name in SCENES.iter().filter(|name| !any || asked(name)) {
        compare(name, points);
    }
}

/// Light at the receivers: all of it, and what was reflected.
struct Light {
    all: Vec<DVec3>,
    reflected: Vec<DVec3>,
}

/// A run, with its errors: of all light, of what was reflected, against the surface.
struct Run {
    seconds: f64,
    errors: [f64; 3],
}

fn compare(name: &str, points: usize) {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
        ..SceneOptions::default()
    };
    let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    let case = Case::new(&scene);
    let by_links: Vec<_> = TOLERANCES
        .map(|t| solve(&case, Method::Fmm, None, t))
        .into();
    let by_rays: Vec<_> = RAYS
        .map(|(rays, t)| solve(&case, Method::Gather, Some(rays), t))
        .into();
    let direct = case.exact(&case.emission());
    let point_lights = lights::point_lights(&case.surfels, &scene.lights, &case.tester(), &Silent);
    let point_lights = case.at_receivers(&point_lights.unwrap().irradiance);
    let direct: Vec<DVec3> = (direct.iter().zip(point_lights))
        .map(|(a, b)| *a + b)
        .collect();
    let limit = |reflected: Vec<DVec3>| Light {
        all: (reflected.iter().zip(&direct))
            .map(|(a, b)| *a + *b)
            .collect(),
        reflected,
    };
    let sums = limit(case.exact(&case.reflected(&by_links[by_links.len() - 1].map)));
    let rays = limit(case.many_rays(&case.reflected(&by_rays[by_rays.len() - 1].map)));
    let traced = TRACED.contains(&name).then(|| case.traced(name));
    println!("{name}, {} points", case.surfels.len());
    println!("  method and setting   wall s  CPU s | error: all, reflected, to the surface");
    let runs = |solved: &[Solved], limit: &Light, settings: Vec<String>| -> Vec<Run> {
        let runs = solved.iter().zip(settings).map(|(s, setting)| {
            let found = case.surfels_of(&s.map);
            let direct = case.surfels_of(&s.direct);
            let reflected: Vec<DVec3> = (found.iter().zip(&direct)).map(|(a, b)| *a - *b).collect();
            let errors = [
                error(&found, &limit.all),
                error(&reflected, &limit.reflected),
                traced
                    .as_ref()
                    .map_or(f64::NAN, |truth| error(&found, truth)),
            ];
            let [a, b, c] = errors.map(|e| 100.0 * e);
            println!(
                "  {setting:20} {:6.2} {:6.2} | {a:5.2}% {b:5.2}% {c:5.2}%",
                s.wall, s.seconds
            );
            Run {
                seconds: s.seconds,
                errors,
            }
        });
        runs.collect()
    };
    let settings = TOLERANCES.iter().map(|t| format!("links to {t}"));
    let by_links = runs(&by_links, &sums, settings.collect());
    let settings = RAYS.iter().map(|(r, _)| format!("{r} rays"));
    let by_rays = runs(&by_rays, &rays, settings.collect());
    for (which, what) in ["all light", "reflected light", "the surface"]
        .iter()
        .enumerate()
    {
        let ratios = by_links.iter().filter_map(|run| {
            let rays = seconds_at(&by_rays, which, run.errors[which])?;
            Some(format!(
                "{:.1} at {:.2}%",
                rays / run.seconds,
                100.0 * run.errors[which]
            ))
        });
        let ratios: Vec<String> = ratios.collect();
        println!("  times rays take as long, {what}: {}", ratios.join(", "));
    }
}

/// When a method gets to an error: between two of its runs as a power law.
fn seconds_at(runs: &[Run], which: usize, error: f64) -> Option<f64> {
    runs.windows(2).find_map(|w| {
        let [a, b] = [&w[0], &w[1]].map(|r| (r.errors[which].ln(), r.seconds.ln()));
        let part = (error.ln() - a.0) / (b.0 - a.0);
        (0.0..=1.0)
            .contains(&part)
            .then(|| (a.1 + part * (b.1 - a.1)).exp())
    })
}

fn error(found: &[DVec3], truth: &[DVec3]) -> f64 {
    let pairs = found.iter().zip(truth);
    let error: f64 = pairs.map(|(a, b)| (*a - *b).length_squared()).sum();
    (error / truth.iter().map(|b| b.length_squared()).sum::<f64>()).sqrt()
}

/// Light of the points.
struct Solved {
    map: Vec<DVec3>,
    direct: Vec<DVec3>,
    wall: f64,
    /// Of all threads.
    seconds: f64,
}

fn solve(case: &Case, method: Method, rays: Option<u32>, tolerance: f64) -> Solved {
    let lit = |max_bounces| {
        let options = Options {
            method,
            rays,
            max_bounces,
            tolerance: Some(tolerance),
            ..Options::default()
        };
        let lit = illuminate(case.scene, &options, Backend::Cpu, &Silent).unwrap();
        lit.map.irradiance.iter().map(|h| h.as_dvec3()).collect()
    };
    let clock = Clock::start();
    let map = lit(None);
    let Spent { wall, cpu } = clock.spent();
    Solved {
        map,
        direct: lit(Some(0)),
        wall,
        seconds: cpu,
    }
}

/// The surfels of a scene, and some of them that receive.
struct Case<'a> {
    scene: &'a Scene,
    surfels: Surfels,
    occluders: Occluders,
    receivers: Vec<usize>,
}

impl<'a> Case<'a> {
    fn new(scene: &'a Scene) -> Case<'a> {
        let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
        let surfels = Octree::build(&prepared.surfels, LEAF_SIZE).1;
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let begin = |k: usize| k * surfels.len() / RECEIVERS;
        let receivers = (0..RECEIVERS).map(|k| random.random_range(begin(k)..begin(k + 1)));
        Case {
            scene,
            occluders: Occluders::build(&surfels),
            receivers: receivers.collect(),
            surfels,
        }
    }

    fn tester(&self) -> CpuVisibility<'_, f32> {
        CpuVisibility::new(&self.occluders)
    }

    fn at_receivers(&self, light: &[DVec3]) -> Vec<DVec3> {
        self.receivers.iter().map(|&i| light[i]).collect()
    }

    /// Light of the points, at the receivers.
    fn surfels_of(&self, map: &[DVec3]) -> Vec<DVec3> {
        let point = |&i: &usize| map[self.surfels.points[i] as usize];
        self.receivers.iter().map(point).collect()
    }

    fn emission(&self) -> Vec<DVec3> {
        self.surfels.emission.iter().map(|e| e.as_dvec3()).collect()
    }

    /// What the surfels reflect of a map.
    fn reflected(&self, solved: &[DVec3]) -> Vec<DVec3> {
        let pairs = self.surfels.points.iter().zip(&self.surfels.reflectance);
        pairs
            .map(|(&p, r)| solved[p as usize] * r.as_dvec3())
            .collect()
    }

    fn exact(&self, radiosity: &[DVec3]) -> Vec<DVec3> {
        let rows = exact_irradiance(&self.surfels, &self.tester(), &self.receivers, radiosity);
        rows.unwrap().into_iter().map(|(h, _)| h).collect()
    }

    fn many_rays(&self, radiosity: &[DVec3]) -> Vec<DVec3> {
        let reach = self.surfels.reach();
        let light = |&i: &usize| {
            let mut random = Pcg64Mcg::seed_from_u64(i as u64);
            let normal = self.surfels.normals[i];
            let (a, b) = normal.any_orthonormal_pair();
            let rays = (0..STRATA * STRATA).filter_map(|k| {
                let [u, v] = [k / STRATA, k % STRATA]
                    .map(|s| (s as f32 + random.random::<f32>()) / STRATA as f32);
                let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
                let way = u.sqrt() * (cos * a + sin * b) + (1.0 - u).sqrt() * normal;
                let hit = first_hit::<f32>(&self.occluders, &self.surfels.ray(i, way * reach))?;
                hit.front.then(|| radiosity[hit.surfel as usize])
            });
            rays.sum::<DVec3>() / f64::from(STRATA * STRATA)
        };
        self.receivers.par_iter().map(light).collect()
    }

    fn traced(&self, name: &str) -> Vec<DVec3> {
        let receivers = self.receivers.iter().map(|&i| Receiver {
            place: self.surfels.positions[i].as_dvec3() + self.surfels.origin,
            normal: self.surfels.normals[i].as_dvec3(),
        });
        let receivers: Vec<Receiver> = receivers.collect();
        let found = Room::load(name).irradiance(&receivers, Bounces::All, PATHS);
        found.into_iter().map(|e| e.irradiance).collect()
    }
}
