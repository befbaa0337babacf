//! The stages on the CPU in f32 and on the adapter found: `cargo bench --bench stages`.

use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::links::{self, Accuracy, Entry, Links, MIXED_ORDER, Rows};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Fields, Fmm, GpuFmm, TransportOperator};
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::passes::gpu::{Batch, Batches, Gpu, GpuFormFactors, Stages, adapter};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{Result, Scene, Surfels};
use glam::{DVec3, Vec3};
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Pairs of surfels whose form factors are found in one batch.
const PAIRS: usize = 100_000;

/// The scene "cave" with the links of the default tolerance.
struct Case {
    surfels: Surfels,
    octree: Octree,
    links: Links,
}

impl Case {
    fn new() -> Case {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cave.toml");
        let options = SceneOptions {
            points: Some(30_000),
            seed: 1,
            ..SceneOptions::default()
        };
        let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
        let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
        let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
        let occluders = Occluders::build(&surfels);
        let facets = octree.facets.len();
        let accuracy = Accuracy {
            order: 1,
            error: 0.03,
            radiosity: vec![1.0; facets],
            target_factor: vec![1.0; facets],
            seed: 1,
        };
        let visibility = CpuVisibility::<f32>::new(&occluders);
        let links = links::build(&surfels, &octree, &accuracy, &visibility, &Silent).unwrap();
        println!("{} surfels, links {:?}", surfels.len(), links.counts());
        Case {
            surfels,
            octree,
            links,
        }
    }
}

fn stages(criterion: &mut Criterion) {
    let case = Case::new();
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
        passes(criterion, &case, gpu.as_ref(), order);
    }

    let mut group = criterion.benchmark_group("m2l, one thread");
    let pool = ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for order in 1..=6 {
        m2l(&mut group, order, &case, &pool);
    }
    group.finish();

    let mut group = criterion.benchmark_group("apply");
    group.sample_size(20);
    apply(
        &mut group,
        "cpu",
        &Fmm::<f32>::new(&case.surfels, &case.octree, &case.links),
        &case,
    );
    if let Some(gpu) = &gpu {
        let device = GpuFmm::new(gpu, &case.surfels, &case.octree, &case.links).unwrap();
        apply(&mut group, "gpu", &device, &case);
    }
    group.finish();
}

/// Pass by pass, with expansions of one order: the far links of the scene, all of this order, and
/// those of them that end or begin at a leaf as M2P and P2L, those between leaves as mixed links.
fn passes(criterion: &mut Criterion, case: &Case, gpu: Option<&Gpu>, order: usize) {
    let (octree, facets) = (&case.octree, case.octree.facets.len());
    let far = &case.links.m2l[1];
    let of = |keep: &dyn Fn(usize, usize) -> bool| {
        let entries = (0..facets).flat_map(|t| far.row(t).map(move |(s, weight)| (t, s, weight)));
        let kept = entries.filter(|&(t, s, _)| keep(t, s));
        let entry = |(target, source, weight)| Entry {
            target: target as u32,
            source: source as u32,
            weight,
        };
        Rows::new(facets, kept.map(entry).collect())
    };
    let leaf = |f: usize| octree.facets[f].is_leaf();
    let mut links = Links {
        m2l: vec![Rows::none(facets); order + 1],
        m2p: of(&|t, _| leaf(t)),
        p2l: of(&|_, s| leaf(s)),
        mixed: of(&|t, s| leaf(t) && leaf(s)),
        ..case.links.clone()
    };
    links.m2l[order] = far.clone();
    let links = &links;
    let surface = &Surface::<f32>::new(&case.surfels);
    let radiosity = &vec![Vec3::ONE; case.surfels.len()];
    let mut moments = cpu::p2m(order, octree, surface, radiosity);
    cpu::m2m(octree, &mut moments);
    let mut locals = cpu::m2l(octree, links, &moments);
    let mut irradiance = cpu::l2p(octree, surface, &locals);

    let device = gpu.map(|gpu| {
        let stages = Stages::new(gpu, &case.surfels, octree, links).unwrap();
        let field = gpu.storage("field", radiosity.len() * 16).unwrap();
        let batches = Batches::new(gpu).unwrap();
        batches
            .run_and_wait("first", |batch| {
                stages.take(batch, &field);
                stages.p2m(batch)?;
                stages.m2m(batch)?;
                stages.m2l(batch)
            })
            .unwrap();
        (stages, field, batches)
    });
    let mut compare =
        |pass: &str,
         elements: usize,
         on_cpu: &mut dyn FnMut(),
         on_gpu: &dyn Fn(&Stages, &mut Batch, &wgpu::Buffer) -> Result<()>| {
            let mut group = criterion.benchmark_group(format!("{pass}, order {order}"));
            group.sample_size(10);
            group.throughput(Throughput::Elements(elements as u64));
            group.bench_function("cpu", |b| b.iter(&mut *on_cpu));
            if let Some((stages, field, batches)) = &device {
                let run = || {
                    batches
                        .run_and_wait("bench", |batch| on_gpu(stages, batch, field))
                        .unwrap()
                };
                group.bench_function("gpu", |b| b.iter(run));
            }
            group.finish();
        };
    let n = case.surfels.len();
    compare(
        "p2m",
        n,
        &mut || drop(cpu::p2m(order, octree, surface, radiosity)),
        &|stages, batch, _| stages.p2m(batch),
    );
    compare(
        "m2m",
        facets,
        &mut || cpu::m2m(octree, &mut moments),
        &|stages, batch, _| stages.m2m(batch),
    );
    compare(
        "m2l",
        far.len(),
        &mut || drop(cpu::m2l(octree, links, &moments)),
        &|stages, batch, _| stages.m2l(batch),
    );
    let pairs = |rows: &Rows, of_source: bool| -> usize {
        let surfels = |(t, s): (usize, usize)| octree.facets[if of_source { s } else { t }].len();
        (0..facets)
            .flat_map(|t| rows.row(t).map(move |(s, _)| (t, s)))
            .map(surfels)
            .sum()
    };
    compare(
        "p2l",
        pairs(&links.p2l, true),
        &mut || cpu::p2l(octree, &links.p2l, surface, radiosity, &mut locals),
        &|stages, batch, _| stages.p2l(batch),
    );
    compare(
        "m2p",
        pairs(&links.m2p, false),
        &mut || cpu::m2p(octree, &links.m2p, surface, &moments, &mut irradiance),
        &|stages, batch, field| stages.m2p(batch, field),
    );
    let mut inherited = cpu::m2l(octree, links, &moments);
    compare(
        "l2l",
        facets,
        &mut || cpu::l2l(octree, &mut inherited),
        &|stages, batch, _| stages.l2l(batch),
    );
    compare(
        "l2p",
        n,
        &mut || drop(cpu::l2p(octree, surface, &inherited)),
        &|stages, batch, field| stages.l2p(batch, field),
    );
    let mixed_order = order.min(MIXED_ORDER);
    compare(
        "mixed",
        links.mixed.len(),
        &mut || {
            let rows = &links.mixed;
            cpu::mixed(
                mixed_order,
                octree,
                rows,
                surface,
                radiosity,
                &moments,
                &mut irradiance,
            )
        },
        &|stages, batch, field| stages.mixed(batch, field),
    );
    compare(
        "near field",
        links.near.len(),
        &mut || cpu::near_field::<f32>(&links.near, radiosity, &mut irradiance),
        &|stages, batch, field| stages.near_field(batch, field),
    );
}

/// The links of the first order, as if they were of this one.
fn m2l(
    group: &mut BenchmarkGroup<criterion::measurement::WallTime>,
    order: usize,
    case: &Case,
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
fn near_pairs(case: &Case) -> Vec<(u32, u32)> {
    let n = case.surfels.len();
    (0..PAIRS)
        .map(|k| ((k / 8 % n) as u32, ((k / 8 + k % 8 + 1) % n) as u32))
        .collect()
}

fn apply<O: TransportOperator>(
    group: &mut BenchmarkGroup<criterion::measurement::WallTime>,
    name: &str,
    operator: &O,
    case: &Case,
) {
    let ones = vec![DVec3::ONE; case.surfels.len()];
    let radiosity = operator.fields().upload(&ones).unwrap();
    group.bench_function(name, |b| b.iter(|| operator.apply(&radiosity).unwrap()));
}

criterion_group!(benches, stages);
criterion_main!(benches);
