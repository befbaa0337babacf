//! Octree and lists, surfels a second: `cargo bench --bench lists`. For ten million surfels, and for
//! memory, there is the example of the same name.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::links::{Cosines, Mac, THETA, adaptive, dual};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::progress::Silent;

#[path = "../examples/lists/room.rs"]
mod room;

fn lists(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("lists");
    group.sample_size(10);
    for n in [100_000, 1_000_000] {
        let given = room::with_ball(n);
        let (octree, surfels) = Octree::build(&given, 32);
        let facets = &octree.facets;
        group.throughput(Throughput::Elements(n as u64));
        group.bench_function(BenchmarkId::new("octree", n), |b| {
            b.iter(|| Octree::build(&given, 32))
        });
        for (name, cosines) in [
            ("signed", Cosines::Signed),
            ("clamped", Cosines::Clamped { tolerance: 1e-4 }),
        ] {
            let mac = Mac {
                theta: THETA,
                order: 3,
                cosines,
            };
            let judge = |t: u32, s: u32| mac.judge(&facets[t as usize], &facets[s as usize]);
            group.bench_function(BenchmarkId::new(format!("dual, {name}"), n), |b| {
                b.iter(|| dual(&octree, &surfels, mac.order, judge, &Silent).unwrap())
            });
            group.bench_function(BenchmarkId::new(format!("adaptive, {name}"), n), |b| {
                b.iter(|| adaptive(&octree, &surfels, cosines, 3, &Silent).unwrap())
            });
        }
    }
    group.finish();
}

criterion_group!(benches, lists);
criterion_main!(benches);
