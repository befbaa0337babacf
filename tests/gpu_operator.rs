//! The operator on a device against the CPU in f32 and f64, arithmetic on fields, whole maps, and a
//! caller's own device and buffers.

mod cases;
mod common;

use cases::*;
use common::{gpu, room};
use fmmgi_gpu::illuminate::checks::Checks;
use fmmgi_gpu::operator::{Fields, Fmm, GpuFields, GpuFmm, HostFields, TransportOperator};
use fmmgi_gpu::passes::gpu::{Gpu, adapter};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::solve::{Stop, solve};
use fmmgi_gpu::{Backend, Error, Method, Occlusion, Options, Scene, illuminate};
use glam::{DVec3, Vec3};
use wgpu::{Buffer, BufferUsages};

#[test]
fn the_operator_is_that_of_the_cpu() {
    for case in cases() {
        let radiosity = colours(case.surfels.len(), 2);
        let device = case.operator();
        let apply = |field: &Buffer| {
            let irradiance = device.apply(field).unwrap();
            device.fields().download(&irradiance).unwrap()
        };
        let field = device.fields().upload(&radiosity).unwrap();
        let found = apply(&field);
        let single = Fmm::<f32>::new(&case.surfels, &case.octree, &case.links);
        let double = Fmm::<f64>::new(&case.surfels, &case.octree, &case.links);
        let single = on_host(&single, &radiosity);
        let double = on_host(&double, &radiosity);
        let (off_single, off_double) = (relative_l2(&found, &single), relative_l2(&found, &double));
        assert!(off_single < 1e-6, "{}: f32 {off_single}", case.name);
        assert!(off_double < 1e-6, "{}: f64 {off_double}", case.name);
        // The same bits again, also after other work.
        apply(
            &device
                .fields()
                .upload(&colours(case.surfels.len(), 3))
                .unwrap(),
        );
        assert_eq!(apply(&field), found, "{}", case.name);
    }
}

#[test]
fn a_solution_is_that_of_the_cpu() {
    let case = Case::linked("room", &room(14), 0.02);
    let n = case.surfels.len();
    let source = colours(n, 4);
    let reflectance: Vec<DVec3> = colours(n, 5).iter().map(|c| *c * 0.45).collect();
    for bounces in [None, Some(4)] {
        let stop = Stop {
            residual: 1e-5,
            bounces,
        };
        let found = solution(&case.operator(), &reflectance, &source, stop);
        let host = Fmm::<f32>::new(&case.surfels, &case.octree, &case.links);
        let expected = solution(&host, &reflectance, &source, stop);
        let off = relative_l2(&found, &expected);
        assert!(off < 1e-5, "{bounces:?}: {off}");
    }
}

fn solution<O: TransportOperator>(
    operator: &O,
    reflectance: &[DVec3],
    source: &[DVec3],
    stop: Stop,
) -> Vec<DVec3> {
    let fields = operator.fields();
    let [reflectance, source] = [reflectance, source].map(|f| fields.upload(f).unwrap());
    let (field, ended) = solve(operator, &reflectance, &source, None, stop, &Silent).unwrap();
    assert!(ended.converged, "{ended:?}");
    fields.download(&field).unwrap()
}

#[test]
fn fields_calculate_like_those_of_the_host() {
    // One item, parts of unequal length, several pieces.
    for n in [1, 63, 64, 65, 4097, 800_000] {
        let [x, y, factor] = [1, 2, 3].map(|seed| {
            let shift = DVec3::splat(if seed == 3 { 0.0 } else { 1.0 });
            colours(n, seed)
                .iter()
                .map(|c| *c - shift)
                .collect::<Vec<_>>()
        });
        let device = GpuFields::new(gpu(), n).unwrap();
        let (found, dots) = calculate(&device, &x, &y, &factor);
        let (expected, expected_dots) = calculate(&HostFields::<f64>::default(), &x, &y, &factor);
        for (found, expected) in found.iter().zip(&expected) {
            let off = relative_l2(found, expected);
            assert!(off < 1e-6, "{n}: {off}");
        }
        // Against |x| |y|: products of any sign cancel.
        let norm = (expected_dots[1] * expected_dots[2]).sqrt();
        for (found, expected) in dots.iter().zip(&expected_dots) {
            let off = (found - expected).abs() / norm;
            assert!(off < 1e-6, "{n}: {off}");
        }
        assert_eq!(calculate(&device, &x, &y, &factor), (found, dots));
    }
}

/// Every kind of arithmetic: copies, y + 0.3 x, -2 x, factor * y, and products.
fn calculate<F: Fields>(
    fields: &F,
    x: &[DVec3],
    y: &[DVec3],
    factor: &[DVec3],
) -> (Vec<Vec<DVec3>>, Vec<f64>) {
    let [x, y, factor] = [x, y, factor].map(|f| fields.upload(f).unwrap());
    let mut sum = fields.copy(&y).unwrap();
    fields.axpy(0.3, &x, &mut sum).unwrap();
    let mut scaled = fields.copy(&x).unwrap();
    fields.scale(-2.0, &mut scaled).unwrap();
    let mut product = fields.copy(&y).unwrap();
    fields.multiply(&factor, &mut product).unwrap();
    let dots = [(&x, &y), (&x, &x), (&y, &y), (&sum, &scaled)]
        .map(|(a, b)| fields.dot(a, b).unwrap())
        .to_vec();
    // More together than are read at once.
    let three = [&sum, &y, &x];
    let all: Vec<_> = three.into_iter().cycle().take(36).collect();
    let together = fields.dots(&all, &scaled).unwrap();
    let one_by_one = three.map(|a| fields.dot(a, &scaled).unwrap());
    assert!(together.chunks(3).all(|dots| dots == one_by_one));
    // The operands of copies are as they were.
    let all = [&x, &y, &sum, &scaled, &product].map(|f| fields.download(f).unwrap());
    (all.to_vec(), dots)
}

/// From scene to map. Who sees whom is found on the device as well, where rounding may decide some
/// segments otherwise.
#[test]
fn a_map_is_that_of_the_cpu() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell.toml");
    let options = SceneOptions {
        points: Some(3000),
        seed: 1,
        ..SceneOptions::default()
    };
    let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    let options = Options {
        method: Method::Fmm,
        occlusion: Occlusion::Surfels,
        tolerance: None,
        order: None,
        max_bounces: None,
        rays: None,
        below_model: false,
        seed: 1,
    };
    let on_device = Backend::Gpu {
        device: &gpu().device,
        queue: &gpu().queue,
        adapter: "test",
    };
    let lit = [on_device, Backend::Cpu]
        .map(|backend| illuminate(&scene, &options, backend, &Silent).unwrap());
    let [found, expected] = lit.each_ref().map(|lit| {
        let map = lit.map.irradiance.iter();
        map.map(|h| h.as_dvec3()).collect::<Vec<_>>()
    });
    let off = relative_l2(&found, &expected);
    println!("map: {off:e}");
    assert!(off < 1e-4, "{off}");
    // And so is the way there, and what the checks find.
    let [found, expected] = lit.map(|lit| lit.stats);
    assert_eq!(found.iterations, expected.iterations);
    assert!((found.residual / expected.residual - 1.0).abs() < 0.01);
    let [found, expected] = [found, expected].map(|stats| stats.checks.unwrap());
    let apart = |of: fn(&Checks) -> f64| (of(&found) - of(&expected)).abs();
    assert!(apart(|c| c.row_sum_and_sky.unwrap().mean) < 1e-3);
    assert!(apart(|c| c.energy.unwrap()) < 1e-3);
    assert!(apart(|c| c.reciprocity) < 1e-4);
}

/// A renderer has a device of its own, radiosity in a buffer of its own (whatever the fourth word
/// of an item is), and reads the irradiance on the device.
#[test]
fn device_queue_and_buffers_can_be_the_callers() {
    let open = adapter::open(&adapter::AdapterChoice::Any).unwrap();
    let (device, queue) = (&open.device, &open.queue);
    let case = Case::linked("room", &room(8), 0.02);
    let n = case.surfels.len();
    let operator = GpuFmm::new(
        &Gpu::new(device, queue),
        &case.surfels,
        &case.octree,
        &case.links,
    )
    .unwrap();
    let make = |usage| {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: n as u64 * 16,
            usage,
            mapped_at_creation: false,
        })
    };
    let radiosity = colours(n, 6);
    let vectors: Vec<[f32; 4]> = radiosity
        .iter()
        .map(|c| c.as_vec3().extend(f32::NAN).to_array())
        .collect();
    let input = make(BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST);
    queue.write_buffer(&input, 0, bytemuck::cast_slice(&vectors));

    // The caller's own commands on a result.
    let read = |mut encoder: wgpu::CommandEncoder, irradiance: &Buffer| -> Vec<DVec3> {
        let staging = make(BufferUsages::MAP_READ | BufferUsages::COPY_DST);
        encoder.copy_buffer_to_buffer(irradiance, 0, &staging, 0, n as u64 * 16);
        queue.submit([encoder.finish()]);
        staging
            .slice(..)
            .map_async(wgpu::MapMode::Read, |mapped| mapped.unwrap());
        device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
        let view = staging.slice(..).get_mapped_range().unwrap();
        let items: &[[f32; 4]] = bytemuck::cast_slice(&view);
        items
            .iter()
            .map(|&[r, g, b, _]| Vec3::new(r, g, b).as_dvec3())
            .collect()
    };
    let encoder = || device.create_command_encoder(&Default::default());
    let irradiance = operator.apply(&input).unwrap();
    let found = read(encoder(), &irradiance);
    // As a part of a frame, without a wait and into a buffer of the caller; twice the same light.
    let usage = input.usage();
    let [once, twice] = [make(usage), make(usage)];
    let mut frame = encoder();
    operator.record(&mut frame, &input, &once).unwrap();
    operator.record(&mut frame, &once, &twice).unwrap();
    operator.record(&mut frame, &input, &twice).unwrap();
    assert_eq!(read(frame, &twice), found);
    assert_eq!(operator.fields().download(&once).unwrap(), found);

    let host = Fmm::<f32>::new(&case.surfels, &case.octree, &case.links);
    assert!(relative_l2(&found, &on_host(&host, &radiosity)) < 1e-6);

    let short = operator.apply(&make(BufferUsages::STORAGE));
    assert!(matches!(short, Err(Error::Invalid(_))), "{short:?}");
}
