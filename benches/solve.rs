//! Whole solves of the Cornell box on the CPU and on the adapter found, one after the other:
//! `cargo bench --bench solve`.

use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Method, Options, Scene, illuminate};

const SIZES: [usize; 2] = [5_000, 20_000];

fn cornell(points: usize) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
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
        let scene = cornell(points);
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

criterion_group!(benches, whole_solves);
criterion_main!(benches);
