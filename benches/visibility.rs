//! Segments against the cells, on the CPU in f32 and on the adapter found, and rays of the gather on the
//! CPU: `cargo bench --bench visibility`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::chart::stages::segments;
use fmmgi_gpu::links::{self, Close};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::passes::gpu::{Gpu, GpuVisibility, adapter};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders, Visibility};
use fmmgi_gpu::{Scene, Surfels};

/// Segments that are tested in one batch.
const SEGMENTS: usize = 100_000;

/// Rays from each surfel.
const RAYS: u32 = 8;

/// The surfels of a scene in the order of the octree, which is that of a solve.
fn surfels(name: &str, points: usize) -> Surfels {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
        ..SceneOptions::default()
    };
    let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
    Octree::build(&prepared.surfels, LEAF_SIZE).1
}

fn visibility(criterion: &mut Criterion) {
    let gpu = match adapter::open(&adapter::AdapterChoice::Any) {
        Ok(open) => {
            println!("adapter {}", open.info);
            Some(Gpu::new(&open.device, &open.queue))
        }
        Err(error) => {
            println!("the CPU alone is measured: {error}");
            None
        }
    };
    for (name, points) in [("cornell", 100_000), ("cave", 30_000)] {
        let surfels = surfels(name, points);
        let occluders = Occluders::build(&surfels);
        let cpu = CpuVisibility::<f32>::new(&occluders);
        let device = gpu
            .as_ref()
            .map(|gpu| GpuVisibility::new(gpu, &occluders).unwrap());
        for (kind, group) in [("random", 1), ("coherent", 16)] {
            let segments = segments(&surfels, group, SEGMENTS);
            let visible = cpu.visible(&segments).unwrap();
            let share = visible.iter().filter(|&&v| v).count() as f64 / SEGMENTS as f64;
            println!("{name}: {} surfels, {share:.2} visible", surfels.len());
            let mut group = criterion.benchmark_group(format!("{name} {points}, {kind}"));
            group.throughput(Throughput::Elements(SEGMENTS as u64));
            group.sample_size(20);
            group.bench_function("cpu", |b| b.iter(|| cpu.visible(&segments).unwrap()));
            if let Some(device) = &device {
                group.bench_function("gpu", |b| b.iter(|| device.visible(&segments).unwrap()));
            }
            group.finish();
        }
        let mut group = criterion.benchmark_group(format!("{name} {points}, rays"));
        group.throughput(Throughput::Elements(u64::from(RAYS) * surfels.len() as u64));
        group.sample_size(10);
        let close = Close::none(&surfels);
        let gather =
            || links::gather::<f32>(&surfels, &occluders, &close, 0..RAYS, 1, &Silent).unwrap();
        group.bench_function("cpu", |b| b.iter(gather));
        group.finish();
    }
}

criterion_group!(benches, visibility);
criterion_main!(benches);
