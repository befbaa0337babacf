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
fn a_noisy_room_is_lit_as_the_true_one() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    let options = SceneOptions {
        points: Some(20_000),
        seed: 1,
    };
    let scene = Scene::load(&path, &options, &Silent).unwrap();
    let chosen: Vec<usize> = (0..scene.cloud.len()).step_by(13).collect();
    let receivers: Vec<Receiver> = chosen
        .iter()
        .map(|&i| Receiver {
            place: scene.cloud.positions[i],
            normal: scene.cloud.normals[i].as_dvec3(),
        })
        .collect();
    let truth = Room::load("cornell").irradiance(&receivers, Bounces::All, 8192);
    let sum = |part: fn(&tracer::Estimate) -> f64| truth.iter().map(part).sum::<f64>();
    let own = sum(|e| e.error.length_squared()) / sum(|e| e.irradiance.length_squared());
    let truth: Vec<Vec3> = truth.iter().map(|e| e.irradiance.as_vec3()).collect();
    println!("path tracing: own noise {:.4}", own.sqrt());
    for (degrees, shift, most) in [(0.0_f64, 0.0, 0.015), (2.0, 0.02, 0.035), (5.0, 0.05, 0.065)] {
        let shift_length = shift * spacing(&scene.cloud);
        let mut noisy = scene.clone();
        noisy.cloud = clouds::noisy(&scene.cloud, degrees.to_radians(), shift_length, 7);
        let found = irradiance(&noisy);
        let found: Vec<Vec3> = chosen.iter().map(|&i| found[i]).collect();
        let c = compare(&found, &truth).unwrap();
        println!(
            "cornell with {degrees} degrees and {shift} spacings of noise: relative L2 {:.4} ({:.4} \
             without the noise of the truth), median {:.4}, p95 {:.4}, bias {:+.4}",
            c.rel_l2,
            (c.rel_l2 * c.rel_l2 - own).max(0.0).sqrt(),
            c.median,
            c.p95,
            c.bias
        );
        assert!(c.rel_l2 < most && c.bias.abs() < 0.01);
    }
}

#[test]
fn debug_floor() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    let options = SceneOptions { points: Some(20_000), seed: 1 };
    let scene = Scene::load(&path, &options, &Silent).unwrap();
    let chosen: Vec<usize> = (0..scene.cloud.len()).step_by(13).collect();
    let at = |c: &PointCloud| -> Vec<Receiver> { chosen.iter().map(|&i| Receiver { place: scene.cloud.positions[i], normal: c.normals[i].as_dvec3() }).collect() };
    let noisy = clouds::noisy(&scene.cloud, 5f64.to_radians(), 0.05 * spacing(&scene.cloud), 7);
    let room = Room::load("cornell");
    let truth: Vec<Vec3> = room.irradiance(&at(&scene.cloud), Bounces::All, 8192).iter().map(|e| e.irradiance.as_vec3()).collect();
    let tilted: Vec<Vec3> = room.irradiance(&at(&noisy), Bounces::All, 8192).iter().map(|e| e.irradiance.as_vec3()).collect();
    let c = compare(&tilted, &truth).unwrap();
    println!("floor: {c:?}");
    let mut s = scene.clone();
    s.cloud = noisy;
    let found = irradiance(&s);
    let found: Vec<Vec3> = chosen.iter().map(|&i| found[i]).collect();
    println!("against tilted: {:?}", compare(&found, &tilted).unwrap());
    // by part: y of place and normal
    for (name, keep) in [("ceiling", (|p: glam::DVec3, _: glam::DVec3| p.y > 0.999) as fn(glam::DVec3, glam::DVec3) -> bool), ("floor", |p, _| p.y < 1e-3), ("walls", |p, _| p.x < 1e-3 || p.x > 0.999 || p.z < 1e-3), ("blocks", |p, _| p.x > 1e-3 && p.x < 0.999 && p.z > 1e-3 && p.y > 1e-3 && p.y < 0.999)] {
        let idx: Vec<usize> = (0..chosen.len()).filter(|&k| keep(scene.cloud.positions[chosen[k]], scene.cloud.normals[chosen[k]].as_dvec3())).collect();
        let e = |a: &[Vec3], b: &[Vec3]| idx.iter().map(|&k| (a[k] - b[k]).length_squared()).sum::<f32>();
        let t: f32 = truth.iter().map(|v| v.length_squared()).sum();
        println!("{name} {}: share of squared error: floor {:.5}, found {:.5}, of tilted {:.5}", idx.len(), e(&tilted, &truth) / t, e(&found, &truth) / t, e(&found, &tilted) / t);
        let mut worst: Vec<(f32, usize)> = idx.iter().map(|&k| ((found[k] - tilted[k]).length_squared() / t, k)).collect();
        worst.sort_by(|a, b| b.0.total_cmp(&a.0));
        for &(x, k) in worst.iter().take(4) { println!("   {x:.6} at {:?} found {} tilted {} truth {}", scene.cloud.positions[chosen[k]], found[k].x, tilted[k].x, truth[k].x); }
    }
}
