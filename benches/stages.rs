//! The stages on the CPU in f32 and on the adapter found: `cargo bench --bench stages`.

use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::Scene;
use fmmgi_gpu::chart::stages::{Linked, OnGpu};
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::links::{Links, Rows};
use fmmgi_gpu::operator::{Fields, Fmm, GpuFmm, TransportOperator};
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::passes::gpu::{Gpu, GpuFormFactors, adapter};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use glam::{DVec3, Vec3};
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Pairs of surfels whose form factors are found in one batch.
const PAIRS: usize = 100_000;

/// The scene "cave" with links of the default tolerance.
fn cave() -> Linked {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cave.toml");
    let options = SceneOptions {
        points: Some(30_000),
        seed: 1,
        ..SceneOptions::default()
    };
    let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    let case = Linked::new(&scene, &Silent).unwrap();
    println!(
        "{} surfels, links {:?}",
        case.surfels.len(),
        case.links.counts()
    );
    case
}

fn stages(criterion: &mut Criterion) {
    let case = cave();
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

    let mut group = criterion.benchmark_group("form factors");
    group.throughput(Throughput::Elements(PAIRS as u64));
    let near: Vec<(u32, u32)> = near_pairs(&case);
    let surface = Surface::<f32>::new(&case.surfels);
    group.bench_function("cpu, one thread", |b| {
        b.iter(|| {
            let sum = |&(i, j): &(u32, u32)| surface.form_factor(i as usize, j as usize);
            near.iter().map(sum).sum::<f32>()
        })
    });
    if let Some(gpu) = &gpu {
        let device = GpuFormFactors::new(gpu, &case.surfels).unwrap();
        group.bench_function("gpu", |b| b.iter(|| device.compute(&near).unwrap()));
    }
    group.finish();

    for order in [1, 2, 4] {
        let mut visit =
            |stage: &str, elements: usize, on_cpu: &mut dyn FnMut(), on_gpu: Option<OnGpu>| {
                bench(
                    criterion,
                    &format!("{stage}, order {order}"),
                    elements,
                    on_cpu,
                    on_gpu,
                );
                Ok(())
            };
        case.expansions(gpu.as_ref(), order, &mut visit).unwrap();
    }
    let mut visit =
        |stage: &str, elements: usize, on_cpu: &mut dyn FnMut(), on_gpu: Option<OnGpu>| {
            bench(criterion, stage, elements, on_cpu, on_gpu);
            Ok(())
        };
    case.pairs(gpu.as_ref(), &mut visit).unwrap();

    let mut group = criterion.benchmark_group("m2l, one thread");
    let pool = ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for order in 1..=6 {
        m2l(&mut group, order, &case, &pool);
    }
    group.finish();

    let mut group = criterion.benchmark_group("apply");
    group.sample_size(20);
    let counts = case.links.counts().map(|(_, links)| links);
    group.throughput(Throughput::Elements(counts.iter().sum()));
    let host = Fmm::<f32>::new(&case.surfels, &case.octree, &case.links);
    apply(&mut group, "cpu", &host, &case);
    apply(&mut group, "cpu, one colour", &host.grey(), &case);
    if let Some(gpu) = &gpu {
        let device = GpuFmm::new(gpu, &case.surfels, &case.octree, &case.links).unwrap();
        apply(&mut group, "gpu", &device, &case);
    }
    group.finish();
}

/// One stage on both sides.
fn bench(
    criterion: &mut Criterion,
    name: &str,
    elements: usize,
    on_cpu: &mut dyn FnMut(),
    on_gpu: Option<OnGpu>,
) {
    let mut group = criterion.benchmark_group(name);
    group.sample_size(10);
    group.throughput(Throughput::Elements(elements as u64));
    group.bench_function("cpu", |b| b.iter(&mut *on_cpu));
    if let Some(on_gpu) = on_gpu {
        group.bench_function("gpu", |b| b.iter(|| on_gpu().unwrap()));
    }
    group.finish();
}

/// The links of the first order, as if they were of this one.
fn m2l(
    group: &mut BenchmarkGroup<criterion::measurement::WallTime>,
    order: usize,
    case: &Linked,
    pool: &ThreadPool,
) {
    let (octree, surface) = (&case.octree, Surface::<f32>::new(&case.surfels));
    let facets = octree.facets.len();
    let mut links = Links::none(facets, surface.len());
    links.m2l = vec![Rows::none(facets); order];
    links.m2l.push(case.links.m2l[1].clone());
    let mut moments = cpu::p2m(order, octree, &surface, &vec![Vec3::ONE; surface.len()]);
    cpu::m2m(octree, &mut moments);
    group.throughput(Throughput::Elements(links.m2l[order].len() as u64));
    group.bench_function(format!("order {order}"), |b| {
        pool.install(|| b.iter(|| cpu::m2l(octree, &links, &moments)))
    });
}

/// Pairs of surfels beside each other in the octree.
fn near_pairs(case: &Linked) -> Vec<(u32, u32)> {
    let n = case.surfels.len();
    (0..PAIRS)
        .map(|k| ((k / 8 % n) as u32, ((k / 8 + k % 8 + 1) % n) as u32))
        .collect()
}

fn apply<O: TransportOperator>(
    group: &mut BenchmarkGroup<criterion::measurement::WallTime>,
    name: &str,
    operator: &O,
    case: &Linked,
) {
    let ones = vec![DVec3::ONE; case.surfels.len()];
    let radiosity = operator.fields().upload(&ones).unwrap();
    group.bench_function(name, |b| b.iter(|| operator.apply(&radiosity).unwrap()));
}

criterion_group!(benches, stages);
criterion_main!(benches);
