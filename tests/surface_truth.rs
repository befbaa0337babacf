//! How near the product comes to the true surface: 20,000 points at a tolerance of 0.01, against
//! closed forms and against path tracing of the shapes that the points were taken from.

mod closed_forms;
mod tracer;

use std::path::Path;

use closed_forms::{parallel, perpendicular};
use fmmgi_gpu::compare::{Comparison, compare};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Method, Occlusion, Options, Scene, illuminate};
use glam::{DVec2, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tracer::{Bounces, Estimate, Receiver, Room};

fn scene(name: &str) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
    let options = SceneOptions {
        points: Some(20_000),
        seed: 1,
        ..SceneOptions::default()
    };
    Scene::load(&path, &options, &Silent).unwrap()
}

/// Irradiance of all points.
fn solve(name: &str, scene: &Scene, method: Method, max_bounces: Option<u32>) -> Vec<Vec3> {
    let options = Options {
        method,
        occlusion: Occlusion::Surfels,
        tolerance: Some(0.01),
        order: None,
        max_bounces,
        rays: None,
        below_model: false,
        seed: 1,
    };
    let lit = illuminate(scene, &options, Backend::Cpu, &Silent).unwrap();
    let stats = &lit.stats;
    assert!(stats.converged);
    println!(
        "{name}, {method:?}: {} segments, {:.1} s",
        stats.segments,
        stats.seconds.links + stats.seconds.visibility + stats.seconds.solve
    );
    lit.map.irradiance
}

/// Compares at some of the points, and says so.
fn against(name: &str, found: &[Vec3], chosen: &[usize], truth: &[Vec3]) -> Comparison {
    let found: Vec<Vec3> = chosen.iter().map(|&i| found[i]).collect();
    let c = compare(&found, truth).unwrap();
    println!(
        "{name}: relative L2 {:.4}, median {:.4}, p95 {:.4}, p99 {:.4}, max {:.3}, bias {:+.4}",
        c.rel_l2, c.median, c.p95, c.p99, c.max, c.bias
    );
    c
}

/// The points of the dark plate against a closed form.
fn plate(name: &str, truth: impl Fn(DVec3) -> f64) -> Comparison {
    let scene = scene(name);
    let found = solve(name, &scene, Method::Fmm, None);
    let dark: Vec<usize> = (0..scene.cloud.len())
        .filter(|&i| scene.cloud.emission[i] == Vec3::ZERO)
        .collect();
    let truth: Vec<Vec3> = dark
        .iter()
        .map(|&i| Vec3::splat(truth(scene.cloud.positions[i]) as f32))
        .collect();
    against(name, &found, &dark, &truth)
}

#[test]
fn parallel_plates() {
    let found = plate("plates_parallel", |p| parallel(DVec2::new(p.x, p.z)));
    assert!(found.p95 < 0.002);
}

#[test]
fn perpendicular_plates() {
    let found = plate("plates_perpendicular", |p| {
        perpendicular(DVec2::new(p.x, p.y))
    });
    assert!(found.rel_l2 < 0.01);
}

#[test]
fn furnace() {
    let scene = scene("furnace");
    let found = solve("furnace", &scene, Method::Fmm, None);
    let all: Vec<usize> = (0..found.len()).collect();
    let found = against("furnace", &found, &all, &vec![Vec3::splat(2.0); all.len()]);
    assert!(found.rel_l2 < 0.005);
}

/// One point at random from each of `count` stretches of the cloud, which follows the surfaces.
fn receivers(scene: &Scene, count: usize, keep: impl Fn(DVec3) -> bool) -> Vec<usize> {
    let kept: Vec<usize> = (0..scene.cloud.len())
        .filter(|&i| keep(scene.cloud.positions[i]))
        .collect();
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let begin = |k: usize| k * kept.len() / count;
    (0..count)
        .map(|k| kept[random.random_range(begin(k)..begin(k + 1))])
        .collect()
}

/// Path-traced irradiance of some points, with the standard errors of its L2 norm and mean, relative.
struct Traced {
    irradiance: Vec<Vec3>,
    noise: f64,
    bias: f64,
}

impl Traced {
    /// The path tracer's noise, which does not depend on what is compared, adds its square.
    fn less_noise(&self, mut found: Comparison) -> Comparison {
        let square = found.rel_l2.powi(2) - self.noise.powi(2);
        found.rel_l2 = square.max(0.0).sqrt();
        println!("    relative L2 without that noise {:.4}", found.rel_l2);
        found
    }
}

fn trace(name: &str, scene: &Scene, chosen: &[usize], bounces: Bounces, paths: usize) -> Traced {
    let cloud = &scene.cloud;
    let receivers: Vec<Receiver> = chosen
        .iter()
        .map(|&i| Receiver {
            place: cloud.positions[i],
            normal: cloud.normals[i].as_dvec3().normalize(),
        })
        .collect();
    let found = Room::load(name).irradiance(&receivers, bounces, paths);
    let sum = |part: fn(&Estimate) -> f64| found.iter().map(part).sum::<f64>();
    let error = sum(|e| e.error.length_squared());
    let traced = Traced {
        irradiance: found.iter().map(|e| e.irradiance.as_vec3()).collect(),
        noise: (error / sum(|e| e.irradiance.length_squared())).sqrt(),
        bias: error.sqrt() / sum(|e| e.irradiance.element_sum()),
    };
    println!(
        "{name}, path tracing, {} receivers: own noise {:.4}, of the mean {:.5}",
        chosen.len(),
        traced.noise,
        traced.bias
    );
    traced
}

const PATHS: usize = 8192;

/// All bounces on 300 receivers by a method.
fn room(name: &str, scene: &Scene, method: Method) -> Comparison {
    let chosen = receivers(scene, 300, |_| true);
    let truth = trace(name, scene, &chosen, Bounces::All, PATHS);
    let found = solve(name, scene, method, None);
    truth.less_noise(against(name, &found, &chosen, &truth.irradiance))
}

fn holds(c: Comparison) {
    assert!(c.rel_l2 < 0.015 && c.bias.abs() < 0.005);
}

#[test]
fn cornell() {
    holds(room("cornell", &scene("cornell"), Method::Fmm));
}

#[test]
fn organic() {
    holds(room("organic", &scene("organic"), Method::Fmm));
}

#[test]
fn two_rooms() {
    let scene = scene("two_rooms");
    holds(room("two_rooms", &scene, Method::Fmm));
    let found = solve("two_rooms", &scene, Method::Fmm, None);
    let behind = receivers(&scene, 200, behind_the_door);
    let truth = trace("two_rooms", &scene, &behind, Bounces::All, 2 * PATHS);
    let c = against("behind the door", &found, &behind, &truth.irradiance);
    assert!(c.bias.abs() < 0.03);
}

fn behind_the_door(p: DVec3) -> bool {
    p.x > 4.05
}

/// Where no ray of the lamp comes.
#[test]
fn no_direct_light_behind_the_door() {
    let scene = scene("two_rooms");
    let found = solve("two_rooms", &scene, Method::Fmm, Some(0));
    let behind = receivers(&scene, 2000, behind_the_door);
    let truth = trace("two_rooms", &scene, &behind, Bounces::None, 2048);
    let mean = found.iter().map(|h| f64::from(h.x)).sum::<f64>() / found.len() as f64;
    let dark: Vec<f64> = behind
        .iter()
        .zip(&truth.irradiance)
        .filter(|(_, truth)| **truth == Vec3::ZERO)
        .map(|(&i, _)| f64::from(found[i].x))
        .collect();
    let leak = dark.iter().sum::<f64>() / dark.len() as f64 / mean;
    println!(
        "{} of {} receivers behind the door are dark: {leak:.1e} of the mean light",
        dark.len(),
        behind.len()
    );
    assert!(dark.len() > 1000 && leak < 1e-3);
}

/// What is left where the sums are exact: the part of the model.
#[test]
#[ignore = "minutes"]
fn rooms_by_exact_sums() {
    for name in ["cornell", "organic", "two_rooms"] {
        let found = room(name, &scene(name), Method::Direct);
        // Measured: 0.0020, 0.0113, 0.0038; biases of +0.0002, -0.0028, +0.0008.
        assert!(found.rel_l2 < 0.013 && found.bias.abs() < 0.004);
    }
}
