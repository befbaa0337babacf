//! The operator on a device: each stage against its twin on the CPU, the whole against the CPU in
//! f32 and f64, arithmetic on fields, and a caller's own device and buffers.

mod common;

use common::{clutter, gpu, polygons, random, room, sphere};
use fmmgi_gpu::expansion::{Expansions, Surface, coefficients};
use fmmgi_gpu::links::{self, Accuracy, Entry, Links, MIXED_ORDER, Rows};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Fields, Fmm, GpuFields, GpuFmm, HostFields, TransportOperator};
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::passes::gpu::{Batch, Batches, Gpu, GpuFormFactors, MAX_ORDER, Stages, adapter};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::solve::{Stop, solve};
use fmmgi_gpu::visibility::NothingInTheWay;
use fmmgi_gpu::{Backend, Error, Method, Occlusion, Options, Result, Scene, Surfels, illuminate};
use glam::{DVec3, Vec3};
use rand::RngExt;
use wgpu::{Buffer, BufferUsages};

/// A cloud with octree and links.
struct Case {
    name: &'static str,
    surfels: Surfels,
    octree: Octree,
    links: Links,
}

impl Case {
    /// With the links that the product would find.
    fn linked(name: &'static str, surfels: &Surfels, error: f32) -> Case {
        let (octree, surfels) = Octree::build(surfels, LEAF_SIZE);
        let facets = octree.facets.len();
        let accuracy = Accuracy {
            order: 1,
            error,
            radiosity: vec![1.0; facets],
            target_factor: vec![1.0; facets],
            seed: 1,
        };
        let links = links::build(&surfels, &octree, &accuracy, &NothingInTheWay, &Silent).unwrap();
        Case {
            name,
            surfels,
            octree,
            links,
        }
    }

    /// With those of surfels that nothing stands between, of orders up to `order`.
    fn open(name: &'static str, surfels: &Surfels, order: usize, error: f32) -> Case {
        let (octree, surfels) = Octree::build(surfels, LEAF_SIZE);
        let accuracy = Accuracy {
            order,
            error,
            radiosity: vec![1.0; octree.facets.len()],
            target_factor: vec![1.0; octree.facets.len()],
            seed: 1,
        };
        let links = links::build_open(&surfels, &octree, &accuracy, &Silent).unwrap();
        println!("{name}: {:?}", links.counts());
        Case {
            name,
            surfels,
            octree,
            links,
        }
    }

    /// With random links of all kinds, to the full order and half of it; every third row has none.
    fn tangled(name: &'static str, surfels: &Surfels, order: usize, seed: u64) -> Case {
        let (octree, surfels) = Octree::build(surfels, LEAF_SIZE);
        let mut rng = random(seed);
        let mut rows = |targets: usize, apart: &dyn Fn(usize, usize) -> bool| {
            let mut entries = Vec::new();
            for target in (0..targets).filter(|t| t % 3 != 1) {
                for _ in 0..rng.random_range(0..12) {
                    let source = rng.random_range(0..targets);
                    if apart(target, source) {
                        entries.push(Entry {
                            target: target as u32,
                            source: source as u32,
                            weight: rng.random_range(0.0..1.0),
                        });
                    }
                }
            }
            Rows::new(targets, entries)
        };
        let facets = &octree.facets;
        let apart = |t: usize, s: usize| {
            let reach = facets[t].scale() + facets[s].scale();
            facets[t].centre.distance(facets[s].centre) > reach
        };
        let links = Links {
            m2l: (0..=order)
                .map(|q| match [order, order / 2].contains(&q) {
                    true => rows(facets.len(), &apart),
                    false => Rows::none(facets.len()),
                })
                .collect(),
            p2l: rows(facets.len(), &apart),
            m2p: rows(facets.len(), &apart),
            p2p: rows(facets.len(), &|_, _| true),
            mixed: rows(facets.len(), &apart),
            sampled: rows(facets.len(), &|_, _| true),
            near: rows(surfels.len(), &|_, _| true),
            ..Links::none(facets.len(), surfels.len())
        };
        Case {
            name,
            octree,
            links,
            surfels,
        }
    }

    fn stages(&self) -> Stages {
        Stages::new(gpu(), &self.surfels, &self.octree, &self.links).unwrap()
    }

    fn operator(&self) -> GpuFmm {
        GpuFmm::new(gpu(), &self.surfels, &self.octree, &self.links).unwrap()
    }
}

/// Rooms and clutter; then a single surfel, a root that is a leaf, many surfels at one place (a
/// large leaf of scale 1), no links at all.
fn cases() -> Vec<Case> {
    let one_place: Vec<_> = (0..9).map(|_| (Vec3::ONE, Vec3::Z)).collect();
    let unlinked = Case::tangled("unlinked", &clutter(100, 0.1, 9), 1, 3);
    let facets = unlinked.octree.facets.len();
    vec![
        Case::linked("room", &room(12), 0.02),
        Case::linked("sphere", &sphere(1500), 0.01),
        Case::open("open sphere", &sphere(3000), 4, 1e-3),
        Case::open("open clutter", &clutter(2000, 0.05, 7), 2, 1e-2),
        Case::tangled("clutter", &clutter(3000, 0.05, 7), 1, 1),
        Case::tangled("few", &clutter(65, 0.1, 8), 1, 2),
        Case::linked("single", &polygons(&[(Vec3::ONE, Vec3::X)], 4, 0.1), 0.1),
        Case::tangled(
            "one leaf",
            &polygons(&[(Vec3::X, Vec3::Z), (Vec3::Y, Vec3::Z)], 4, 0.1),
            1,
            4,
        ),
        Case::tangled("one place", &polygons(&one_place, 5, 0.1), 1, 5),
        Case {
            name: "unlinked",
            links: Links {
                m2l: vec![Rows::none(facets); 2],
                ..Links::none(facets, unlinked.surfels.len())
            },
            ..unlinked
        },
    ]
}

fn colours(n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = random(seed);
    (0..n)
        .map(|_| DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..2.0))))
        .collect()
}

/// A buffer on the device of the tests that holds these colours, with NaN as the fourth.
fn buffer(colours: &[Vec3]) -> Buffer {
    let vectors: Vec<[f32; 4]> = colours
        .iter()
        .map(|c| c.extend(f32::NAN).to_array())
        .collect();
    let buffer = gpu().storage("test", vectors.len() * 16).unwrap();
    fill(&buffer, &vectors);
    buffer
}

fn fill(buffer: &Buffer, vectors: &[[f32; 4]]) {
    gpu()
        .queue
        .write_buffer(buffer, 0, bytemuck::cast_slice(vectors));
}

fn poison(buffer: &Buffer) {
    fill(buffer, &vec![[f32::NAN; 4]; buffer.size() as usize / 16]);
}

/// Runs a stage; returns the colours that `result` holds then.
fn run(result: &Buffer, record: impl FnOnce(&mut Batch) -> Result<()>) -> Vec<Vec3> {
    let batches = Batches::new(gpu()).unwrap();
    let count = result.size() as usize / 16;
    let vectors: Vec<[f32; 4]> = batches.run_and_read("test", result, count, record).unwrap();
    vectors
        .iter()
        .map(|&[r, g, b, _]| Vec3::new(r, g, b))
        .collect()
}

/// Expansions in the device's layout.
fn as_colours(expansions: &Expansions<f32>) -> Vec<Vec3> {
    expansions.as_slice().iter().map(|&c| c.into()).collect()
}

/// Largest difference in units of the largest value.
fn difference(a: &[Vec3], b: &[Vec3]) -> f32 {
    assert_eq!(a.len(), b.len());
    let largest = b
        .iter()
        .fold(f32::MIN_POSITIVE, |m, v| m.max(v.abs().max_element()));
    let largest_difference = a.iter().zip(b).fold(0.0, |m: f32, (a, b)| {
        assert!(a.is_finite(), "not written");
        m.max((*a - *b).abs().max_element())
    });
    largest_difference / largest
}

fn relative_l2(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let of = |values: &mut dyn Iterator<Item = DVec3>| -> f64 {
        values.map(|v| v.length_squared()).sum::<f64>().sqrt()
    };
    let norm = of(&mut b.iter().copied());
    let off = of(&mut a.iter().zip(b).map(|(a, b)| *a - *b));
    if off == 0.0 { 0.0 } else { off / norm }
}

/// Rounding of a few thousand f32 operations at most. (Measured: 8e-7 at order 6; 1.7e-6 for a
/// thousand mixed links a surfel.)
const ROUNDING: f32 = 4e-6;

/// Every stage gets what its twin on the CPU got, not what the device's stage before it made.
#[test]
fn each_stage_is_like_its_twin() {
    for case in cases() {
        compare_stages(&case);
    }
}

#[test]
fn each_stage_is_like_its_twin_at_every_order() {
    for order in [0, 1, 2, 3, 4, MAX_ORDER] {
        let case = Case::tangled("clutter", &clutter(500, 0.05, 7), order, 1);
        compare_stages(&case);
    }
}

fn compare_stages(case: &Case) {
    let (octree, links) = (&case.octree, &case.links);
    let order = links.order();
    let surface = Surface::<f32>::new(&case.surfels);
    let stages = case.stages();
    let radiosity: Vec<Vec3> = colours(case.surfels.len(), 1)
        .iter()
        .map(|c| c.as_vec3())
        .collect();
    let field = buffer(&radiosity);
    let same = |stage: &str, found: &[Vec3], expected: &[Vec3]| {
        let off = difference(found, expected);
        println!("{} of order {order}, {stage}: {off:e}", case.name);
        assert!(
            off < ROUNDING,
            "{} of order {order}, {stage}: {off}",
            case.name
        );
    };
    // Expansions degree by degree: those of another degree are of another size.
    let same_expansions = |stage: &str, found: &[Vec3], expected: &Expansions<f32>| {
        let expected = as_colours(expected);
        let ends = (0..=order).map(coefficients);
        let begins = [0, 1].into_iter().chain(ends.clone());
        for (begin, end) in begins.zip([1].into_iter().chain(ends)) {
            let part = |all: &[Vec3]| -> Vec<Vec3> {
                let facets = all.chunks(coefficients(order));
                facets.flat_map(|c| c[begin..end].to_vec()).collect()
            };
            same(stage, &part(found), &part(&expected));
        }
    };

    poison(&stages.moments);
    let mut moments = cpu::p2m(order, octree, &surface, &radiosity);
    let found = run(&stages.moments, |batch| {
        stages.take(batch, &field);
        stages.p2m(batch)
    });
    same_expansions("p2m", &found, &moments);

    fill(&stages.moments, &vectors(&as_colours(&moments)));
    cpu::m2m(octree, &mut moments);
    let found = run(&stages.moments, |batch| stages.m2m(batch));
    same_expansions("m2m", &found, &moments);

    // From here on the moments are in the table.
    fill(&stages.moments, &vectors(&as_colours(&moments)));
    poison(&stages.locals);
    let mut locals = cpu::m2l(octree, links, &moments);
    let found = run(&stages.locals, |batch| {
        stages
            .expansions
            .copy_from(&stages.moments, batch.encoder());
        stages.m2l(batch)
    });
    same_expansions("m2l", &found, &locals);

    let mut expected = vec![Vec3::ONE; case.surfels.len()];
    let irradiance = buffer(&expected);
    cpu::m2p(octree, &links.m2p, &surface, &moments, &mut expected);
    let found = run(&irradiance, |batch| stages.m2p(batch, &irradiance));
    same("m2p", &found, &expected);

    fill(&stages.locals, &vectors(&as_colours(&locals)));
    cpu::p2l(octree, &links.p2l, &surface, &radiosity, &mut locals);
    let found = run(&stages.locals, |batch| stages.p2l(batch));
    same_expansions("p2l", &found, &locals);

    fill(&stages.locals, &vectors(&as_colours(&locals)));
    cpu::l2l(octree, &mut locals);
    let found = run(&stages.locals, |batch| stages.l2l(batch));
    same_expansions("l2l", &found, &locals);

    let irradiance = buffer(&vec![Vec3::ZERO; case.surfels.len()]);
    let mut expected = cpu::l2p(octree, &surface, &locals);
    let found = run(&irradiance, |batch| {
        stages.expansions.copy_from(&stages.locals, batch.encoder());
        stages.l2p(batch, &irradiance)
    });
    same("l2p", &found, &expected);

    expected.fill(Vec3::ONE);
    let irradiance = buffer(&expected);
    let mixed_order = order.min(MIXED_ORDER);
    cpu::mixed(
        mixed_order,
        octree,
        &links.mixed,
        &surface,
        &radiosity,
        &moments,
        &mut expected,
    );
    let found = run(&irradiance, |batch| stages.mixed(batch, &irradiance));
    same("mixed", &found, &expected);

    let irradiance = buffer(&expected);
    cpu::p2p(octree, &surface, &links.p2p, &radiosity, &mut expected);
    let found = run(&irradiance, |batch| stages.p2p(batch, &irradiance));
    same("p2p", &found, &expected);

    let irradiance = buffer(&expected);
    cpu::near_field::<f32>(&links.near, &radiosity, &mut expected);
    let found = run(&irradiance, |batch| stages.near_field(batch, &irradiance));
    same("near_field", &found, &expected);
}

fn vectors(colours: &[Vec3]) -> Vec<[f32; 4]> {
    colours.iter().map(|c| c.extend(0.0).to_array()).collect()
}

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

fn on_host<O: TransportOperator>(operator: &O, radiosity: &[DVec3]) -> Vec<DVec3> {
    let fields = operator.fields();
    let irradiance = operator.apply(&fields.upload(radiosity).unwrap()).unwrap();
    fields.download(&irradiance).unwrap()
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
    };
    let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    let options = Options {
        method: Method::Fmm,
        occlusion: Occlusion::Surfels,
        tolerance: None,
        order: None,
        max_bounces: None,
        seed: 1,
    };
    let on_device = Backend::Gpu {
        device: &gpu().device,
        queue: &gpu().queue,
        adapter: "test",
    };
    let [found, expected] = [on_device, Backend::Cpu].map(|backend| {
        let result = illuminate(&scene, &options, backend, &Silent).unwrap();
        let map = result.map.irradiance.iter();
        map.map(|h| h.as_dvec3()).collect::<Vec<_>>()
    });
    let off = relative_l2(&found, &expected);
    println!("map: {off:e}");
    assert!(off < 1e-4, "{off}");
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

/// Buffers of which only a part can be bound at once: the same bits.
#[test]
fn work_in_parts_of_buffers_is_the_same() {
    for (order, n) in [(1, 6000), (4, 1000)] {
        let case = Case::tangled("clutter", &clutter(n, 0.05, 7), order, 1);
        let small = common::limited(
            wgpu::Limits {
                max_storage_buffer_binding_size: 1 << 16,
                ..Default::default()
            },
            wgpu::Features::SUBGROUP,
        );
        let radiosity = colours(n, 1);
        let operator = GpuFmm::new(&small, &case.surfels, &case.octree, &case.links).unwrap();
        assert_eq!(
            on_host(&operator, &radiosity),
            on_host(&case.operator(), &radiosity)
        );
    }
}

/// Rows longer than what a driver does in one go (see `passes::gpu::turns`).
#[test]
fn long_rows_are_worked_on_to_their_end() {
    let case = Case::tangled("clutter", &clutter(2000, 0.05, 7), 1, 1);
    let facets = &case.octree.facets;
    let mut rng = random(5);
    // All to the largest leaf, from facets of all sizes that are apart from it.
    let leaves = (0..facets.len()).filter(|&f| facets[f].is_leaf());
    let target = leaves.max_by_key(|&f| facets[f].len()).unwrap();
    let mut row = |targets: usize, links: usize, apart: bool| {
        let entry = |_| loop {
            let source = rng.random_range(0..targets);
            let near = || {
                let reach = facets[target].scale() + facets[source].scale();
                facets[target].centre.distance(facets[source].centre) < reach
            };
            if !apart || !near() {
                return Entry {
                    target: target as u32,
                    source: source as u32,
                    weight: rng.random_range(0.0..1.0),
                };
            }
        };
        Rows::new(targets, (0..links).map(entry).collect())
    };
    let n = facets.len();
    let none = || Links {
        m2l: vec![Rows::none(n); 2],
        ..Links::none(n, case.surfels.len())
    };
    let long = [
        Links {
            m2l: vec![row(n, 70_000, true), row(n, 70_000, true)],
            sampled: row(n, 70_000, false),
            ..none()
        },
        Links {
            p2l: row(n, 6000, true),
            ..none()
        },
        Links {
            m2p: row(n, 6000, true),
            ..none()
        },
        Links {
            mixed: row(n, 6000, true),
            ..none()
        },
        Links {
            p2p: row(n, 6000, true),
            ..none()
        },
        Links {
            near: row(case.surfels.len(), 150_000, false),
            ..none()
        },
    ];
    let radiosity = colours(case.surfels.len(), 1);
    for (k, links) in long.into_iter().enumerate() {
        let case = Case {
            name: "long",
            surfels: case.surfels.clone(),
            octree: case.octree.clone(),
            links,
        };
        let double = Fmm::<f64>::new(&case.surfels, &case.octree, &case.links);
        let expected = on_host(&double, &radiosity);
        let off = relative_l2(&on_host(&case.operator(), &radiosity), &expected);
        println!("long {k}: {off:e}");
        assert!(off < 1e-4, "{k}: {off}");
    }
}

#[test]
fn a_leaf_that_is_too_large_is_an_error() {
    let places = vec![(Vec3::ONE, Vec3::Z); 20_000];
    let (octree, surfels) = Octree::build(&polygons(&places, 4, 0.1), 20_000);
    let links = Links::none(octree.facets.len(), surfels.len());
    let result = GpuFmm::new(gpu(), &surfels, &octree, &links);
    assert!(matches!(result, Err(Error::TooLarge(_))));
}

#[test]
fn work_in_rows_of_workgroups_is_the_same() {
    // Rows of at most 11 workgroups of the 47 for surfels.
    let case = Case::tangled("clutter", &clutter(3000, 0.05, 7), 1, 1);
    let small = common::limited(
        wgpu::Limits {
            max_compute_workgroups_per_dimension: 11,
            ..Default::default()
        },
        wgpu::Features::SUBGROUP,
    );
    let radiosity = colours(3000, 1);
    let operator = GpuFmm::new(&small, &case.surfels, &case.octree, &case.links).unwrap();
    assert_eq!(
        on_host(&operator, &radiosity),
        on_host(&case.operator(), &radiosity)
    );
}

#[test]
fn form_factors_are_those_of_the_cpu() {
    let mut rng = random(10);
    for surfels in [room(10), sphere(500), clutter(500, 0.2, 4)] {
        let device = GpuFormFactors::new(gpu(), &surfels).unwrap();
        let single = Surface::<f32>::new(&surfels);
        let double = Surface::<f64>::new(&surfels);
        let n = surfels.len();
        let pairs: Vec<(u32, u32)> = (0..n * n)
            .filter(|_| rng.random_range(0..10) < 3)
            .map(|k| ((k / n) as u32, (k % n) as u32))
            .collect();
        let found = device.compute(&pairs).unwrap();
        let values = |f: &dyn Fn(usize, usize) -> f64| -> Vec<DVec3> {
            let of = |&(i, j): &(u32, u32)| DVec3::new(f(i as usize, j as usize), 0.0, 0.0);
            pairs.iter().map(of).collect()
        };
        let found: Vec<DVec3> = found
            .iter()
            .map(|&f| DVec3::new(f.into(), 0.0, 0.0))
            .collect();
        let exact = values(&|i, j| double.form_factor(i, j));
        let twin = values(&|i, j| single.form_factor(i, j).into());
        let off = relative_l2(&found, &exact);
        println!("device {off:e}, twin {:e}", relative_l2(&twin, &exact));
        assert!(off < 3e-6, "{off}");
        let worst = found
            .iter()
            .zip(&exact)
            .fold(0.0, |m: f64, (a, b)| m.max((a.x - b.x).abs()));
        assert!(worst < 1e-6, "{worst}");
    }
}

#[test]
fn no_pairs_have_no_form_factors() {
    let device = GpuFormFactors::new(gpu(), &sphere(10)).unwrap();
    assert!(device.compute(&[]).unwrap().is_empty());
}
