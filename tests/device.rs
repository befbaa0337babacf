//! Work on a device: batches, tables and dispatches of any size, and what can go wrong.

mod common;

use common::{clutter, differing, gpu, segment, some_segments, sphere};
use fmmgi_gpu::Surfels;
use fmmgi_gpu::error::Error;
use fmmgi_gpu::passes::gpu::{Gpu, GpuVisibility, TABLE_WIDTH, adapter};
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
    let device = GpuVisibility::new(gpu(), &Occluders::build(&surfels)).unwrap();
    let answers = device.visible(&segments).unwrap();
    assert!(differing(&answers, &on_cpu(&surfels, &segments)) <= 3);
}

/// A device with lower limits than it could have.
fn limited(required_limits: wgpu::Limits) -> Gpu {
    let instance = wgpu::Instance::default();
    let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        required_limits,
        ..Default::default()
    }))
    .unwrap();
    Gpu::new(&device, &queue)
}

#[test]
fn a_dispatch_of_several_rows_of_workgroups_is_complete() {
    let gpu = limited(wgpu::Limits {
        max_compute_workgroups_per_dimension: 7,
        ..Default::default()
    });
    let surfels = clutter(2000, 0.1, 4);
    let device = GpuVisibility::new(&gpu, &Occluders::build(&surfels)).unwrap();
    // 32 workgroups: 5 rows of 7.
    let segments = some_segments(&surfels, 2000);
    let answers = device.visible(&segments).unwrap();
    assert!(differing(&answers, &on_cpu(&surfels, &segments)) <= 2);
}

#[test]
fn a_table_that_is_too_large_is_an_error() {
    let gpu = limited(wgpu::Limits {
        max_texture_dimension_2d: 2,
        ..Default::default()
    });
    let data = vec![[0u32; 4]; 2 * TABLE_WIDTH as usize + 1];
    let result = gpu.table("nodes", &data);
    assert!(matches!(result.map(|_| ()), Err(Error::TooLarge(_))));
}

#[test]
fn a_lost_device_is_an_error() {
    let open = adapter::open(&adapter::AdapterChoice::Any).unwrap();
    let gpu = Gpu::new(&open.device, &open.queue);
    let device = GpuVisibility::new(&gpu, &Occluders::build(&sphere(10))).unwrap();
    open.device.destroy();
    let answer = device.visible(&[segment(Vec3::X, Vec3::Y)]);
    assert!(matches!(answer, Err(Error::Device(_))), "{answer:?}");
}
