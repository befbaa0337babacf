//! Readers, points a second: `cargo bench --bench readers`. The files are a lit Cornell box, as `solve`
//! writes it, in a folder that is removed at the end.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use fmmgi_gpu::map::IlluminationMap;
use fmmgi_gpu::output;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan::{ReadOptions, Scan};
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Scene, Surfels};
use glam::DVec3;

const POINTS: usize = 200_000;

fn readers(criterion: &mut Criterion) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell.toml");
    let options = SceneOptions {
        points: Some(POINTS),
        ..SceneOptions::default()
    };
    let cloud = Scene::load(path.as_ref(), &options, &Silent).unwrap().cloud;
    let prepared = Surfels::prepare(&cloud, &Silent).unwrap();
    let places = prepared.places(&prepared.surfels);
    let light = vec![DVec3::ONE; prepared.surfels.len()];
    let map = IlluminationMap::new(&cloud, &places, &prepared.surfels, &light, &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut group = criterion.benchmark_group("readers");
    group.sample_size(10);
    group.throughput(Throughput::Elements(cloud.len() as u64));
    for ending in ["ply", "las", "laz", "csv"] {
        let path = folder.path().join(format!("scan.{ending}"));
        output::write(&path, &cloud, &map).unwrap();
        group.bench_function(BenchmarkId::new(ending, cloud.len()), |b| {
            b.iter(|| Scan::read(&path, &ReadOptions::default(), &Silent).unwrap())
        });
    }
    group.finish();
}

criterion_group!(benches, readers);
criterion_main!(benches);
