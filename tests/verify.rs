//! The measured error of a solution: the estimates that it rests on, and what it says.

use std::path::Path;

use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::glam::DVec3;
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Draw, Sampler, exact_irradiance};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{Scene, Surfels};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

fn scene(name: &str, points: usize) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
    };
    Scene::load(&path, &options, &Silent).unwrap()
}

/// The mean of many estimates is the exact sum, and the more sources an estimate draws the better it
/// is.
#[test]
fn estimates_are_unbiased() {
    for name in ["cornell", "cave"] {
        let scene = scene(name, 4000);
        let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
        let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
        let occluders = Occluders::build(&surfels);
        let visibility = CpuVisibility::<f32>::new(&occluders);
        let surface = Surface::new(&surfels);
        let radiosity: Vec<DVec3> = (surfels.positions.iter().zip(&surfels.reflectance))
            .map(|(p, r)| r.as_dvec3() * f64::from(1.0 + (3.0 * p.x).sin() * p.z.cos()))
            .collect();
        let chosen: Vec<usize> = (0..100).map(|k| (2 * k + 1) * surfels.len() / 200).collect();
        let exact = exact_irradiance(&surfels, &visibility, &chosen, &radiosity).unwrap();
        let level = (exact.iter().map(|(h, _)| h.length_squared()).sum::<f64>() / 100.0).sqrt();
        let sampler = Sampler::new(&octree, &surfels, &surface, &radiosity);
        for count in [1, 8, 64] {
            let repeats = 100;
            let draws: Vec<Draw> = (0..100 * repeats)
                .map(|k| Draw {
                    receiver: chosen[k % 100] as u32,
                    count,
                })
                .collect();
            let random = |k: usize| Pcg64Mcg::seed_from_u64(k as u64 + 1000 * u64::from(count));
            let found = sampler.estimate(&draws, random, &visibility).unwrap();
            let mut worst = 0.0_f64;
            let (mut noise, mut off) = (0.0, 0.0);
            for (k, (truth, _)) in exact.iter().enumerate() {
                let of_one = found.iter().skip(k).step_by(100);
                let mean = of_one.clone().sum::<DVec3>() / repeats as f64;
                let variance = of_one.map(|h| (*h - mean).length_squared()).sum::<f64>()
                    / (repeats * repeats) as f64;
                noise += variance * repeats as f64 / 100.0;
                off += (mean - *truth).length_squared() / variance.max(1e-12 * level * level) / 100.0;
                worst = worst.max((mean - *truth).length_squared() / variance.max(1e-12 * level * level));
            }
            println!(
                "{name}, {count} draws: noise {:.4}, means off by {:.2} of their deviation, at worst {:.2}",
                noise.sqrt() / level, off.sqrt(), worst.sqrt()
            );
        }
    }
}
