//! Work on a device: batches, tables and dispatches of any size, and what can go wrong.

mod common;

use common::{clutter, differing, gpu, limited, polygons, segment, some_segments, sphere};
use fmmgi_gpu::Surfels;
use fmmgi_gpu::error::Error;
use fmmgi_gpu::passes::gpu::{
    Batches, Gpu, GpuVisibility, Pieces, Pipeline, Shader, TABLE_WIDTH, adapter,
};
use fmmgi_gpu::visibility::{CpuVisibility, Occluders, Segment, Visibility};
use glam::Vec3;

fn on_cpu(surfels: &Surfels, segments: &[Segment]) -> Vec<bool> {
    let occluders = Occluders::build(surfels);
    CpuVisibility::<f32>::new(&occluders)
        .visible(segments)
        .unwrap()
}

#[test]
fn a_batch_of_any_size_is_answered() {
    let surfels = sphere(300);
    let occluders = Occluders::build(&surfels);
    let device = GpuVisibility::new(gpu(), &occluders).unwrap();
    for n in [0, 1, 63, 65, 150_000] {
        let segments = some_segments(&surfels, n);
        let answers = device.visible(&segments).unwrap();
        let expected = on_cpu(&surfels, &segments);
        assert!(differing(&answers, &expected) <= n / 1000);
    }
}

#[test]
fn a_table_of_several_rows_is_read_in_order() {
    // 60,000 cells of 7 texels: 51 rows and a part.
    let surfels = clutter(60_000, 0.01, 12);
    let segments = some_segments(&surfels, 3000);
    let occluders = Occluders::build(&surfels);
    let device = GpuVisibility::new(gpu(), &occluders).unwrap();
    let answers = device.visible(&segments).unwrap();
    assert!(differing(&answers, &on_cpu(&surfels, &segments)) <= 3);
}

#[test]
fn a_dispatch_of_several_rows_of_workgroups_is_complete() {
    let gpu = limited(
        wgpu::Limits {
            max_compute_workgroups_per_dimension: 7,
            ..Default::default()
        },
        wgpu::Features::empty(),
    );
    let surfels = clutter(2000, 0.1, 4);
    let occluders = Occluders::build(&surfels);
    let device = GpuVisibility::new(&gpu, &occluders).unwrap();
    // 32 workgroups: 5 rows of 7.
    let segments = some_segments(&surfels, 2000);
    let answers = device.visible(&segments).unwrap();
    assert!(differing(&answers, &on_cpu(&surfels, &segments)) <= 2);
}

/// A segment through the boxes of so many cells, but through none of them, that some drivers leave
/// the loop before its end: the CPU answers instead.
#[test]
fn a_walk_that_was_given_up_is_done_on_the_cpu() {
    let places: Vec<_> = (0..100_000)
        .map(|k| (Vec3::new(1e-3 * k as f32, 0.0, 0.0), Vec3::X))
        .collect();
    let mut surfels = polygons(&places, 4, 1.0);
    // Triangles, all in one half of their boxes.
    for corners in &mut surfels.cells.corners {
        let last = corners[2];
        corners[3..].fill(last);
    }
    let occluders = Occluders::build(&surfels);
    let device = GpuVisibility::new(gpu(), &occluders).unwrap();
    let ray = |y: f32, z: f32| segment(Vec3::new(-1.0, y, z), Vec3::new(101.0, y, z));
    let rays = [-0.5f32, 0.5].map(|y| [-0.5f32, 0.5].map(|z| ray(y, z)));
    for ray in rays.concat() {
        assert_eq!(device.visible(&[ray]).unwrap(), on_cpu(&surfels, &[ray]));
    }
    let mut segments = some_segments(&surfels, 3000);
    segments.splice(1000..1000, rays.concat());
    let answers = device.visible(&segments).unwrap();
    assert!(differing(&answers, &on_cpu(&surfels, &segments)) <= 3);
}

#[test]
fn a_table_that_is_too_large_is_an_error() {
    let gpu = limited(
        wgpu::Limits {
            max_texture_dimension_2d: 2,
            ..Default::default()
        },
        wgpu::Features::empty(),
    );
    let data = vec![[0u32; 4]; 2 * TABLE_WIDTH as usize + 1];
    let result = gpu.table("nodes", &data);
    assert!(matches!(result.map(|_| ()), Err(Error::TooLarge(_))));
}

#[test]
fn a_lost_device_is_an_error() {
    let open = adapter::open(&adapter::AdapterChoice::Any).unwrap();
    let gpu = Gpu::new(&open.device, &open.queue);
    let occluders = Occluders::build(&sphere(10));
    let device = GpuVisibility::new(&gpu, &occluders).unwrap();
    open.device.destroy();
    let answer = device.visible(&[segment(Vec3::X, Vec3::Y)]);
    assert!(matches!(answer, Err(Error::Device(_))), "{answer:?}");
}

/// Stands for a driver that gives up: a stage whose workgroups report only if `ran` says so.
fn stage(name: &'static str, ran: &'static str) -> Pipeline {
    const BINDINGS: &str = "
        @group(0) @binding(RANGE_BINDING) var<uniform> range: vec2<u32>;
        @group(0) @binding(REPORTS_BINDING) var<storage, read_write> reports: atomic<u32>;
        @compute @workgroup_size(WORKGROUP)
        fn main(@builtin(workgroup_id) group: vec3<u32>,
                @builtin(local_invocation_index) local: u32) {
            if local == 0u && range.y > 0u && ran(group.x) { atomicAdd(&reports, 1u); }
        }
    ";
    let shader = Shader {
        name,
        tables: &[],
        vectors: &[],
        lanes: 1,
        shared: Box::leak(Box::new([BINDINGS])),
        text: ran,
        order: 0,
        full_order: 0,
    };
    Pipeline::new(gpu(), &shader).unwrap()
}

#[test]
fn a_dispatch_that_was_given_up_is_an_error() {
    let complete = stage("complete", "fn ran(group: u32) -> bool { return true; }");
    let broken = stage(
        "broken",
        "fn ran(group: u32) -> bool { return group != 3u; }",
    );
    let pieces = [300, 700].map(|items| Pieces::new(gpu(), items, |_| 1).unwrap());
    let batches = Batches::new(gpu()).unwrap();
    let run = |stage: &Pipeline| {
        batches.run_and_wait("test", |batch| {
            batch.dispatch(stage, &[], &[], &pieces[0])?;
            batch.dispatch(stage, &[], &[], &pieces[1])
        })
    };
    run(&complete).unwrap();
    let error = run(&broken).unwrap_err();
    assert!(
        matches!(&error, Error::Device(m) if m.contains("2 workgroups")),
        "{error}"
    );
    run(&complete).unwrap();
    // Found out later where nobody waited for it.
    batches
        .run("test", |batch| {
            batch.dispatch(&broken, &[], &[], &pieces[0])
        })
        .unwrap();
    assert!(run(&complete).is_err());
    run(&complete).unwrap();
}
