//! Surfel by surfel with the point kernel (P2P), on the CPU in f32 and f64 and on the device: against
//! the sum of the kernel over pairs, at any scale and place, and all pairs at once.

mod common;

use std::f32::consts::FRAC_1_SQRT_2;
use std::f64::consts::PI;

use common::{clutter, gpu, polygons, random, room, sphere};
use fmmgi_gpu::Surfels;
use fmmgi_gpu::expansion::{NEAR_SPACINGS, Surface};
use fmmgi_gpu::links::{Entry, Links, Rows, Span};
use fmmgi_gpu::math::{Colour, Real, Vector};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::operator::{AllPairs, Fields, TransportOperator};
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::passes::gpu::{Batches, Gpu, Stages};
use glam::{DVec3, Quat, Vec3};
use rand::RngExt;
use wgpu::Features;

/// Links between facets of a cloud.
struct Case {
    octree: Octree,
    surfels: Surfels,
    rows: Rows,
}

impl Case {
    /// Random links of random weight between facets of every level; every third facet has none.
    fn tangled(surfels: &Surfels, leaf_size: usize, seed: u64) -> Case {
        let (octree, surfels) = Octree::build(surfels, leaf_size);
        let facets = octree.facets.len();
        let mut rng = random(seed);
        let mut entries = Vec::new();
        for target in (0..facets as u32).filter(|t| t % 3 != 1) {
            for _ in 0..rng.random_range(0..12) {
                let source = rng.random_range(0..facets as u32);
                // Some facets side by side with one weight.
                for source in source..(source + rng.random_range(1..4)).min(facets as u32) {
                    let weight = [1.0, rng.random_range(0.0..1.0)][rng.random_range(0..2)];
                    entries.push(Entry {
                        target,
                        source,
                        weight,
                    });
                }
            }
        }
        Case {
            rows: Rows::new(facets, entries),
            octree,
            surfels,
        }
    }

    /// One link, from the root to itself.
    fn whole(surfels: &Surfels) -> Case {
        let (octree, surfels) = Octree::build(surfels, 32);
        let entry = Entry {
            target: 0,
            source: 0,
            weight: 1.0,
        };
        Case {
            rows: Rows::new(octree.facets.len(), vec![entry]),
            octree,
            surfels,
        }
    }

    fn colours(&self, seed: u64) -> Vec<DVec3> {
        let mut rng = random(seed);
        let mut value = || rng.random_range(0.0..2.0);
        (0..self.surfels.len())
            .map(|_| DVec3::new(value(), value(), value()))
            .collect()
    }

    /// What P2P adds to `before`.
    fn cpu<T: Real>(&self, radiosity: &[DVec3], before: &[DVec3]) -> Vec<DVec3> {
        let narrow = |v: &DVec3| T::Vec3::from_rgb(v.to_array().map(T::from_f64));
        let radiosity: Vec<T::Vec3> = radiosity.iter().map(narrow).collect();
        let mut irradiance: Vec<T::Vec3> = before.iter().map(narrow).collect();
        let surface = Surface::<T>::new(&self.surfels);
        cpu::p2p(
            &self.octree,
            &surface,
            &self.rows,
            &radiosity,
            &mut irradiance,
        );
        let wide = |v: &T::Vec3| DVec3::from_array(v.to_array().map(T::to_f64));
        irradiance.iter().map(wide).collect()
    }

    fn gpu(&self, gpu: &Gpu, radiosity: &[DVec3], before: &[DVec3]) -> Vec<DVec3> {
        let links = Links {
            m2l: vec![Rows::none(self.octree.facets.len()); 2],
            p2p: self.rows.clone(),
            ..Links::none(self.octree.facets.len(), self.surfels.len())
        };
        let stages = Stages::new(gpu, &self.surfels, &self.octree, &links).unwrap();
        let upload = |values: &[DVec3]| {
            let texels: Vec<[f32; 4]> = values
                .iter()
                .map(|v| v.as_vec3().extend(f32::NAN).to_array())
                .collect();
            let buffer = gpu.storage("test", texels.len() * 16).unwrap();
            gpu.queue
                .write_buffer(&buffer, 0, bytemuck::cast_slice(&texels));
            buffer
        };
        let (radiosity, irradiance) = (upload(radiosity), upload(before));
        let batches = Batches::new(gpu).unwrap();
        let found: Vec<[f32; 4]> = batches
            .run_and_read("test", &irradiance, before.len(), |batch| {
                stages.take(batch, &radiosity);
                stages.p2p(batch, &irradiance)
            })
            .unwrap();
        found
            .iter()
            .map(|&[r, g, b, _]| Vec3::new(r, g, b).as_dvec3())
            .collect()
    }

    /// The same link by link and pair by pair, in f64; which pairs are near is found in other reals.
    fn expected<T: Real>(&self, radiosity: &[DVec3], before: &[DVec3]) -> Vec<DVec3> {
        let surface = Surface::<f64>::new(&self.surfels);
        let ranges = Surface::<T>::new(&self.surfels);
        let mut irradiance = before.to_vec();
        for (t, target) in self.octree.facets.iter().enumerate() {
            for (s, weight) in self.rows.row(t) {
                for i in target.surfels() {
                    for j in self.octree.facets[s].surfels() {
                        if ranges.is_near(i, j) {
                            continue;
                        }
                        let form_factor = surface.point_form_factor(i, j);
                        irradiance[i] += radiosity[j] * (form_factor * f64::from(weight));
                    }
                }
            }
        }
        irradiance
    }
}

/// Two plates face to face, at the very range of what is near: rounding decides, which devices may do
/// in their own way.
fn grids() -> Surfels {
    let side = 0.1;
    let turn = Quat::from_axis_angle(Vec3::new(0.36, 0.48, 0.8), 0.7);
    let places: Vec<_> = (0..800)
        .map(|k| {
            let sign = [1.0, -1.0][k % 2];
            let place = Vec3::new(
                (k / 40) as f32,
                (k / 2 % 20) as f32,
                -sign * 0.5 * NEAR_SPACINGS as f32,
            );
            (turn * (side * place), turn * (sign * Vec3::Z))
        })
        .collect();
    let mut surfels = polygons(&places, 4, side * FRAC_1_SQRT_2);
    surfels.areas.fill(side * side);
    surfels
}

/// Facets of one surfel to all of them; surfels in the same place; a single surfel.
fn cases() -> Vec<(&'static str, Case)> {
    let twice = {
        let mut surfels = clutter(200, 0.1, 5);
        let half = surfels.positions[..100].to_vec();
        surfels.positions[100..].copy_from_slice(&half);
        surfels
    };
    vec![
        ("room", Case::tangled(&room(12), 4, 1)),
        ("sphere", Case::tangled(&sphere(1500), 32, 2)),
        ("clutter", Case::tangled(&clutter(1000, 0.05, 3), 100, 3)),
        (
            "single surfels",
            Case::tangled(&clutter(150, 0.05, 4), 1, 4),
        ),
        ("twice", Case::tangled(&twice, 8, 5)),
        ("one", Case::whole(&clutter(1, 0.1, 6))),
        ("whole", Case::whole(&clutter(1001, 0.1, 7))),
    ]
}

/// Largest difference in units of the largest value.
fn difference(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let largest = b
        .iter()
        .fold(f64::MIN_POSITIVE, |m, v| m.max(v.abs().max_element()));
    let off = a.iter().zip(b).fold(0.0, |m: f64, (a, b)| {
        assert!(a.is_finite(), "{a}");
        m.max((*a - *b).abs().max_element())
    });
    off / largest
}

#[test]
fn sums_are_those_of_the_kernel_over_pairs() {
    let grids = ("grids", Case::whole(&grids()));
    for (name, case) in cases().into_iter().chain([grids]) {
        let (radiosity, before) = (case.colours(1), case.colours(2));
        let expected = case.expected::<f64>(&radiosity, &before);
        let double = difference(&case.cpu::<f64>(&radiosity, &before), &expected);
        let expected = case.expected::<f32>(&radiosity, &before);
        let single = difference(&case.cpu::<f32>(&radiosity, &before), &expected);
        println!("{name}: f64 {double:.1e}, f32 {single:.1e}");
        // Measured: 4e-15, 3e-7.
        assert!(double < 1e-14, "{name}: {double}");
        assert!(single < 1e-6, "{name}: {single}");
    }
}

#[test]
fn surfels_face_to_face_light_each_other_and_none_behind_them() {
    // The first two at distance 2; the third behind the first, seen from none.
    let places = [
        (Vec3::ZERO, Vec3::Z),
        (2.0 * Vec3::Z, Vec3::NEG_Z),
        (Vec3::NEG_Z, Vec3::NEG_Z),
    ];
    let case = Case::whole(&polygons(&places, 4, 0.1));
    let area = f64::from(case.surfels.areas[0]);
    let expected: Vec<DVec3> = case
        .surfels
        .positions
        .iter()
        .map(|p| DVec3::splat(if p.z < 0.0 { 0.0 } else { area / (4.0 * PI) }))
        .collect();
    let [ones, zeros] = [1.0, 0.0].map(|v| vec![DVec3::splat(v); 3]);
    assert!(difference(&case.cpu::<f64>(&ones, &zeros), &expected) < 1e-15);
    assert!(difference(&case.cpu::<f32>(&ones, &zeros), &expected) < 1e-6);
    assert!(difference(&case.gpu(gpu(), &ones, &zeros), &expected) < 1e-6);
}

/// Between any two points of the unit sphere, seen from inside, the kernel is 1 / (4 π).
#[test]
fn all_pairs_of_a_sphere_get_the_same() {
    let mut surfels = sphere(10_000);
    // So small that none is near another.
    surfels.areas.fill(1e-6);
    let area = f64::from(surfels.areas[0]);
    let expected = vec![DVec3::splat(9999.0 * area / (4.0 * PI)); 10_000];
    let double = all_pairs::<f64>(&surfels);
    let single = all_pairs::<f32>(&surfels);
    let (model, rounding) = (difference(&double, &expected), difference(&single, &double));
    println!("f64 {model:.1e}, f32 to f64 {rounding:.1e}");
    // Measured: 2e-11, 6e-7. Equal terms are the worst case: their roundings go the same way.
    assert!(model < 1e-9, "{model}");
    assert!(rounding < 2e-6, "{rounding}");
}

fn all_pairs<T: Real>(surfels: &Surfels) -> Vec<DVec3> {
    let operator = AllPairs::<T>::new(surfels);
    let fields = operator.fields();
    let ones = fields.upload(&vec![DVec3::ONE; surfels.len()]).unwrap();
    fields.download(&operator.apply(&ones).unwrap()).unwrap()
}

#[test]
fn scale_and_place_do_not_matter() {
    // Lengths in a tenth of a millimetre, metres, and hundreds of kilometres; a corner of a map.
    for (scale, place) in [(1e-4, 0.0), (1.0, 0.0), (1e5, 0.0), (1.0, 300.0)] {
        let mut surfels = clutter(700, 0.05, 8);
        for i in 0..surfels.len() {
            surfels.positions[i] = surfels.positions[i] * scale + Vec3::splat(place);
            surfels.areas[i] *= scale * scale;
            surfels.cells.corners[i] = surfels.cells.corners[i].map(|c| c * scale);
        }
        let case = Case::tangled(&surfels, 16, 8);
        let (radiosity, before) = (case.colours(1), case.colours(2));
        let expected = case.expected::<f32>(&radiosity, &before);
        let host = difference(&case.cpu::<f32>(&radiosity, &before), &expected);
        let device = difference(&case.gpu(gpu(), &radiosity, &before), &expected);
        println!("{scale:e}, {place}: host {host:.1e}, device {device:.1e}");
        assert!(host < 1e-6, "{scale:e}, {place}: {host}");
        assert!(device < 1e-6, "{scale:e}, {place}: {device}");
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let case = Case::tangled(&clutter(1000, 0.05, 3), 32, 9);
    let (radiosity, before) = (case.colours(1), case.colours(2));
    let [one, four] = [1, 4].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        pool.install(|| case.cpu::<f32>(&radiosity, &before))
    });
    assert_eq!(one, four);
}

/// A device with subgroups, if there are any, and one without.
fn devices() -> [(&'static str, Gpu); 2] {
    let without = common::limited(wgpu::Limits::default(), Features::empty());
    assert!(!without.device.features().contains(Features::SUBGROUP));
    [("shared", gpu().clone()), ("alone", without)]
}

#[test]
fn the_device_gets_what_the_cpu_gets() {
    let devices = devices();
    let sizes = [1, 2, 3, 5, 9, 16, 17, 32, 33, 64, 100];
    let ragged = sizes.map(|leaf| {
        let surfels = clutter(500 + leaf, 0.05, leaf as u64);
        ("ragged", Case::tangled(&surfels, leaf, leaf as u64))
    });
    for (name, case) in cases().into_iter().chain(ragged) {
        let (radiosity, before) = (case.colours(1), case.colours(2));
        let expected = case.cpu::<f32>(&radiosity, &before);
        for (kind, gpu) in &devices {
            let found = case.gpu(gpu, &radiosity, &before);
            let off = difference(&found, &expected);
            println!("{name}, {kind}: {off:.1e}");
            // Measured: 2e-7.
            assert!(off < 1e-6, "{name}, {kind}: {off}");
            assert_eq!(case.gpu(gpu, &radiosity, &before), found, "{name}, {kind}");
        }
    }
}

/// A row longer than the 65,535 rounds after which some drivers leave a loop.
#[test]
fn long_rows_are_summed_to_their_end() {
    let mut case = Case::whole(&clutter(70_000, 0.01, 10));
    let facets = &case.octree.facets;
    let target = (0..facets.len())
        .filter(|&f| facets[f].is_leaf())
        .max_by_key(|&f| facets[f].len())
        .unwrap();
    assert!(facets[target].len() > 16);
    let entry = Entry {
        target: target as u32,
        source: 0,
        weight: 1.0,
    };
    case.rows = Rows::new(facets.len(), vec![entry]);
    let zeros = vec![DVec3::ZERO; 70_000];
    let radiosity = case.colours(1);
    let expected = case.expected::<f32>(&radiosity, &zeros);
    for (kind, gpu) in &devices() {
        let off = difference(&case.gpu(gpu, &radiosity, &zeros), &expected);
        println!("{kind}: {off:.1e}");
        assert!(off < 1e-6, "{kind}: {off}");
    }
    let off = difference(&case.cpu::<f32>(&radiosity, &zeros), &expected);
    assert!(off < 1e-6, "{off}");
}

#[test]
fn facets_side_by_side_are_one_span_where_they_weigh_the_same() {
    let (octree, _) = Octree::build(&clutter(500, 0.05, 11), 8);
    let mut leaves: Vec<u32> = (0..octree.facets.len() as u32)
        .filter(|&f| octree.facets[f as usize].is_leaf())
        .collect();
    leaves.sort_by_key(|&f| octree.facets[f as usize].begin);
    // Out of order; the fourth is missing, the sixth weighs less.
    let entries = [2, 0, 1, 5, 4, 6].map(|k| Entry {
        target: 3,
        source: leaves[k],
        weight: if k == 5 { 0.5 } else { 1.0 },
    });
    let rows = Rows::new(octree.facets.len(), entries.to_vec());
    let span = |from: usize, to: usize, weight: f32| Span {
        begin: octree.facets[leaves[from] as usize].begin,
        end: octree.facets[leaves[to] as usize].end,
        weight,
    };
    assert_eq!(
        rows.spans(&octree, 3),
        [
            span(0, 2, 1.0),
            span(4, 4, 1.0),
            span(5, 5, 0.5),
            span(6, 6, 1.0)
        ]
    );
    assert!(rows.spans(&octree, 4).is_empty());
}
