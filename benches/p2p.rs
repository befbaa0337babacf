//! Surfel by surfel with the point kernel, in pairs a second, on the CPU in f32 and on the adapter
//! found: `cargo bench --bench p2p`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::Surfels;
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::links::{Entry, Links, Rows};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::operator::{Fields, GpuFields};
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::passes::gpu::{Batch, Batches, Gpu, Stages, adapter};
use fmmgi_gpu::points::{Cells, MAX_EDGES};
use glam::{DVec3, Vec2, Vec3};

/// Spheres seen from inside, in Fibonacci points.
fn sphere(n: usize) -> Surfels {
    let golden = std::f32::consts::PI * (5f32.sqrt() - 1.0);
    let place = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f32 / n as f32;
        ((1.0 - z * z).sqrt() * Vec2::from_angle(golden * i as f32)).extend(z)
    };
    let positions: Vec<Vec3> = (0..n).map(place).collect();
    Surfels {
        normals: positions.iter().map(|&p| -p).collect(),
        areas: vec![4.0 * std::f32::consts::PI / n as f32; n],
        reflectance: vec![Vec3::splat(0.5); n],
        emission: vec![Vec3::ZERO; n],
        cells: Cells {
            tangents: positions
                .iter()
                .map(|p| p.any_orthonormal_vector())
                .collect(),
            corners: vec![[Vec2::ZERO; MAX_EDGES]; n],
        },
        offsets: vec![0.0; n],
        depths: vec![0.0; n],
        occluder_scale: 1.0,
        points: (0..n as u32).collect(),
        positions,
        ..Surfels::default()
    }
}

/// Every leaf from the 24 leaves beside it, in the octree's order.
fn leaves(octree: &Octree) -> Rows {
    let leaves: Vec<usize> = (0..octree.facets.len())
        .filter(|&f| octree.facets[f].is_leaf())
        .collect();
    let mut entries = Vec::new();
    for &target in &leaves {
        let centre = octree.facets[target].centre;
        let mut sources = leaves.clone();
        sources.sort_by(|&a, &b| {
            let distance = |f: usize| octree.facets[f].centre.distance_squared(centre);
            distance(a).total_cmp(&distance(b))
        });
        sources.truncate(24);
        sources.sort_by_key(|&f| octree.facets[f].begin);
        entries.extend(sources.iter().map(|&source| Entry {
            target: target as u32,
            source: source as u32,
            weight: 1.0,
        }));
    }
    Rows::new(octree.facets.len(), entries)
}

fn whole(octree: &Octree) -> Rows {
    let entry = Entry {
        target: 0,
        source: 0,
        weight: 1.0,
    };
    Rows::new(octree.facets.len(), vec![entry])
}

fn pairs(octree: &Octree, rows: &Rows) -> u64 {
    let pairs = |t: usize| -> u64 {
        let sources = rows.row(t).map(|(s, _)| octree.facets[s].len() as u64);
        octree.facets[t].len() as u64 * sources.sum::<u64>()
    };
    (0..octree.facets.len()).map(pairs).sum()
}

fn p2p(criterion: &mut Criterion) {
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
    // Leaves of 33 surfels on the average.
    for (name, n, leaf_size, rows) in [
        ("all pairs", 16_384, 32, whole as fn(&Octree) -> Rows),
        ("leaves", 120_000, 64, leaves),
    ] {
        let (octree, surfels) = Octree::build(&sphere(n), leaf_size);
        let rows = rows(&octree);
        let surface = Surface::<f32>::new(&surfels);
        let radiosity = vec![Vec3::ONE; n];
        let mut group = criterion.benchmark_group(format!("p2p {name}"));
        group.sample_size(20);
        group.throughput(Throughput::Elements(pairs(&octree, &rows)));
        let leaves = octree.facets.iter().filter(|f| f.is_leaf()).count();
        println!("{n} surfels in {leaves} leaves");
        group.bench_function("cpu", |b| {
            let mut irradiance = vec![Vec3::ZERO; surfels.len()];
            b.iter(|| cpu::p2p(&octree, &surface, &rows, &radiosity, &mut irradiance))
        });
        if let Some(gpu) = &gpu {
            let links = Links {
                m2l: vec![Rows::none(octree.facets.len()); 2],
                p2p: rows,
                ..Links::none(octree.facets.len(), n)
            };
            let stages = Stages::new(gpu, &surfels, &octree, &links).unwrap();
            let fields = GpuFields::new(gpu, n).unwrap();
            let ones = fields.upload(&vec![DVec3::ONE; n]).unwrap();
            let irradiance = fields.copy(&ones).unwrap();
            let batches = Batches::new(gpu).unwrap();
            let run = |batch: &mut Batch| {
                stages.take(batch, &ones);
                stages.p2p(batch, &irradiance)
            };
            group.bench_function("gpu", |b| {
                b.iter(|| batches.run_and_wait("p2p", run).unwrap())
            });
        }
        group.finish();
    }
}

criterion_group!(benches, p2p);
criterion_main!(benches);
