//! Whole solves of the Cornell box on the CPU and on the adapter found, one after the other; and of an empty room,
//! grey and in colours: `cargo bench --bench solve`.

use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Method, Options, Scene, illuminate};
use glam::Vec3;

const SIZES: [usize; 2] = [5_000, 20_000];

fn shipped(name: &str, points: usize) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
    let options = SceneOptions {
        points: Some(points),
        seed: 0,
        ..SceneOptions::default()
    };
    Scene::load(&path, &options, &Silent).unwrap()
}

/// From the points to their map: everything but files.
fn whole_solves(criterion: &mut Criterion) {
    let gpu = match adapter::open(&AdapterChoice::Any) {
        Ok(open) => {
            println!("adapter {}", open.info);
            Some(open)
        }
        Err(error) => {
            println!("the CPU alone is measured: {error}");
            None
        }
    };
    let options = Options {
        method: Method::Fmm,
        ..Options::default()
    };
    for points in SIZES {
        let scene = shipped("cornell", points);
        let solve = |backend| illuminate(&scene, &options, backend, &Silent).unwrap();
        let mut group = criterion.benchmark_group(format!("whole solve, {points} points"));
        group.sample_size(10);
        group.throughput(Throughput::Elements(scene.cloud.len() as u64));
        group.bench_function("CPU", |b| b.iter(|| solve(Backend::Cpu)));
        if let Some(gpu) = &gpu {
            let backend = || Backend::Gpu {
                device: &gpu.device,
                queue: &gpu.queue,
                adapter: &gpu.info.name,
            };
            group.bench_function(&gpu.info.name, |b| b.iter(|| solve(backend())));
        }
    }
}

/// What one colour instead of three saves, where nothing takes time but the transport: no tests for links, hardly
/// any for lamps.
fn colours(criterion: &mut Criterion) {
    let mut scene = shipped("room", 100_000);
    let options = Options {
        tolerance: Some(0.003),
        ..Options::default()
    };
    let mut group = criterion.benchmark_group("whole solve, an empty room of 100000 points");
    group.sample_size(10);
    for name in ["three colours", "one colour"] {
        let solve = || illuminate(&scene, &options, Backend::Cpu, &Silent).unwrap();
        let seconds = solve().stats.seconds;
        println!(
            "{name}: {:.2} of {:.2} s solve",
            seconds.solve, seconds.total
        );
        group.bench_function(name, |b| b.iter(solve));
        let cloud = &mut scene.cloud;
        for colour in cloud.reflectance.iter_mut().chain(&mut cloud.emission) {
            *colour = Vec3::splat(colour.element_sum() / 3.0);
        }
    }
}

criterion_group!(benches, whole_solves, colours);
criterion_main!(benches);
