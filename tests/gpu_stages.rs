//! Each stage on a device against its twin on the CPU, whatever is cut into parts.

mod cases;
mod common;

use cases::*;
use common::{clutter, gpu, polygons, random, room, sphere};
use fmmgi_gpu::Error;
use fmmgi_gpu::expansion::{Expansions, Surface, coefficients};
use fmmgi_gpu::links::{Entry, Links, MIXED_ORDER, Rows};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::operator::{Fmm, GpuFmm};
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::passes::gpu::{GpuFormFactors, MAX_ORDER};
use glam::{DVec3, Vec3};
use rand::RngExt;

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
    cpu::near_field::<f32, _>(&links.near, &radiosity, &mut expected);
    let found = run(&irradiance, |batch| stages.near_field(batch, &irradiance));
    same("near_field", &found, &expected);
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
