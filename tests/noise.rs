//! Noise of scanners: points beside their surface, normals that tilt.

mod clouds;
mod rooms;

use std::path::Path;

use clouds::*;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Method, Options, Scene, Surfels, illuminate};
use glam::Vec3;

fn solved(scene: &Scene, method: Method) -> Vec<Vec3> {
    let options = Options {
        method,
        tolerance: Some(0.01),
        seed: 1,
        ..Options::default()
    };
    illuminate(scene, &options, Backend::Cpu, &Silent)
        .unwrap()
        .map
        .irradiance
}

#[test]
fn a_noisy_room() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    let options = SceneOptions {
        points: Some(20_000),
        seed: 1,
    };
    let scene = Scene::load(&path, &options, &Silent).unwrap();
    let method = match std::env::var("METHOD") {
        Ok(_) => Method::Direct,
        _ => Method::Fmm,
    };
    let clean = solved(&scene, method);
    let spacing = (scene.cloud.areas.iter().map(|&a| f64::from(a)).sum::<f64>()
        / scene.cloud.len() as f64)
        .sqrt();
    for (degrees, shift) in [
        (0.0_f64, 0.0),
        (2.0, 0.02),
        (2.0, 0.0),
        (0.0, 0.02),
        (5.0, 0.05),
        (5.0, 0.0),
        (0.0, 0.05),
    ] {
        let mut noisy = scene.clone();
        noisy.cloud = clouds::noisy(&scene.cloud, degrees.to_radians(), shift * spacing, 7);
        let s: Surfels = surfels(&noisy.cloud);
        let light = solved(&noisy, method);
        // Of normals alone: direct light at tilted receivers.
        let pairs: Vec<(f64, f64)> = light
            .iter()
            .zip(&clean)
            .map(|(a, b)| (f64::from(a.element_sum()), f64::from(b.element_sum())))
            .collect();
        let [l2, bias] = rooms::errors(pairs);
        let offset = s.offsets[0] / s.areas[0].sqrt();
        println!(
            "noise {degrees} {shift}: offset {offset:.3}, scale {:.3}: rel L2 {l2:.4}, bias {bias:+.4}",
            s.occluder_scale
        );
    }
}
