//! The Cornell box on the CPU and on an adapter, one after the other: whole solves, one application of the
//! operator, a batch of segments.
//!
//! The adapter is the best GPU, or software Vulkan where there is none. Without any adapter only
//! the CPU is measured.

use std::path::Path;

use criterion::measurement::WallTime;
use criterion::{BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::links::{self, Accuracy, Links};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::operator::{Fields, Fmm, GpuFmm, TransportOperator};
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice, OpenDevice};
use fmmgi_gpu::passes::gpu::{Gpu, GpuVisibility};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders, Segment, Visibility};
use fmmgi_gpu::{Backend, Options, Scene, Surfels, illuminate};
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const SIZES: [usize; 2] = [5_000, 20_000];
const SEGMENTS: usize = 100_000;
const CPU: &str = "CPU";

type Group<'a> = BenchmarkGroup<'a, WallTime>;

fn cornell(points: usize) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    let options = SceneOptions {
        points: Some(points),
        seed: 0,
    };
    Scene::load(&path, &options, &Silent).expect("the scene is there")
}

/// What an operator is made of.
struct Prepared {
    octree: Octree,
    surfels: Surfels,
    occluders: Occluders,
}

impl Prepared {
    fn new(points: usize) -> Prepared {
        let prepared = Surfels::prepare(&cornell(points).cloud, &Silent).expect("a sound cloud");
        let (octree, surfels) = Octree::build(&prepared.surfels);
        let occluders = Occluders::build(&surfels);
        Prepared {
            octree,
            surfels,
            occluders,
        }
    }

    /// Links for a radiosity of 1 everywhere, each of which may be off by 0.015.
    fn links(&self) -> Links {
        let facets = self.octree.facets.len();
        let accuracy = Accuracy {
            error: 0.015,
            radiosity: vec![1.0; facets],
            target_factor: vec![1.0; facets],
            seed: 0,
        };
        let visibility = CpuVisibility::<f32>::new(&self.occluders);
        links::build(&self.surfels, &self.octree, &accuracy, &visibility, &Silent).expect("links")
    }

    /// Segments between surfels drawn at random.
    fn segments(&self) -> Vec<Segment> {
        let mut rng = Pcg64Mcg::seed_from_u64(0);
        let mut any = || rng.random_range(0..self.surfels.len());
        (0..SEGMENTS)
            .map(|_| self.surfels.segment(any(), any()))
            .collect()
    }
}

/// From the scene to its map, everything included.
fn whole_solve(c: &mut Criterion, points: usize, open: Option<&OpenDevice>) {
    let scene = cornell(points);
    let solve = |backend| illuminate(&scene, &Options::default(), backend, &Silent).expect("a map");
    let mut group = c.benchmark_group(format!("whole solve, {points} points"));
    group.sample_size(10);
    group.bench_function(CPU, |b| b.iter(|| solve(Backend::Cpu)));
    if let Some(open) = open {
        group.bench_function(&open.info.name, |b| {
            b.iter(|| {
                solve(Backend::Gpu {
                    device: &open.device,
                    queue: &open.queue,
                    adapter: &open.info.name,
                })
            });
        });
    }
}

/// Radiosity to irradiance, by the same links; fields stay where the operator is.
fn one_application(c: &mut Criterion, points: usize, open: Option<&OpenDevice>) {
    let prepared = Prepared::new(points);
    let (surfels, octree) = (&prepared.surfels, &prepared.octree);
    let links = prepared.links();
    let mut group = c.benchmark_group(format!("one application, {points} points"));
    group.sample_size(20);
    let on_cpu = Fmm::<f32>::new(surfels, octree, &links);
    apply(&mut group, CPU, &on_cpu, surfels.len());
    if let Some(open) = open {
        let gpu = Gpu::new(&open.device, &open.queue);
        let operator = GpuFmm::new(&gpu, surfels, octree, &links).expect("room on the device");
        apply(&mut group, &open.info.name, &operator, surfels.len());
    }
}

fn apply<O: TransportOperator>(group: &mut Group, name: &str, operator: &O, surfels: usize) {
    let ones = vec![DVec3::ONE; surfels];
    let radiosity = operator.fields().upload(&ones).expect("a field");
    group.bench_function(name, |b| {
        b.iter(|| operator.apply(&radiosity).expect("a field"))
    });
}

/// Who sees whom, for segments between surfels drawn at random.
fn segments(c: &mut Criterion, open: Option<&OpenDevice>) {
    let prepared = Prepared::new(20_000);
    let segments = prepared.segments();
    let mut group = c.benchmark_group(format!("{SEGMENTS} segments, 20000 points"));
    group.throughput(Throughput::Elements(SEGMENTS as u64));
    group.sample_size(20);
    let mut test = |name: &str, visibility: &dyn Visibility| {
        group.bench_function(name, |b| {
            b.iter(|| visibility.visible(&segments).expect("answers"))
        });
    };
    test(CPU, &CpuVisibility::<f32>::new(&prepared.occluders));
    if let Some(open) = open {
        let gpu = Gpu::new(&open.device, &open.queue);
        let visibility = GpuVisibility::new(&gpu, &prepared.occluders).expect("room on the device");
        test(&open.info.name, &visibility);
    }
}

fn all(c: &mut Criterion) {
    let open = match adapter::open(&AdapterChoice::Any) {
        Ok(open) => {
            println!("adapter: {}", open.info);
            Some(open)
        }
        Err(error) => {
            println!("only the CPU is measured: {error}");
            None
        }
    };
    for points in SIZES {
        whole_solve(c, points, open.as_ref());
        one_application(c, points, open.as_ref());
    }
    segments(c, open.as_ref());
}

criterion_group!(benches, all);
criterion_main!(benches);
