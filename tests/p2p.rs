//! Surfel by surfel with the point kernel (P2P), on the CPU in f32 and f64 and on the device: against
//! the sum of the kernel over pairs, at any scale and place, and all pairs at once.

mod common;

use common::{clutter, gpu, random, room, sphere};
use fmmgi_gpu::Surfels;
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::links::{Entry, Links, Rows};
use fmmgi_gpu::math::{Real, Vector};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::passes::gpu::{Batches, Gpu, Stages};
use glam::{DVec3, Vec3};
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
        let narrow = |v: &DVec3| T::Vec3::new(T::from_f64(v.x), T::from_f64(v.y), T::from_f64(v.z));
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

    /// The same link by link and pair by pair.
    fn expected(&self, radiosity: &[DVec3], before: &[DVec3]) -> Vec<DVec3> {
        let surface = Surface::<f64>::new(&self.surfels);
        let mut irradiance = before.to_vec();
        for (t, target) in self.octree.facets.iter().enumerate() {
            for (s, weight) in self.rows.row(t) {
                for i in target.surfels() {
                    for j in self.octree.facets[s].surfels() {
                        let form_factor = surface.point_form_factor(i, j);
                        irradiance[i] += radiosity[j] * (form_factor * f64::from(weight));
                    }
                }
            }
        }
        irradiance
    }
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
    for (name, case) in cases() {
        let (radiosity, before) = (case.colours(1), case.colours(2));
        let expected = case.expected(&radiosity, &before);
        let double = difference(&case.cpu::<f64>(&radiosity, &before), &expected);
        let single = difference(&case.cpu::<f32>(&radiosity, &before), &expected);
        println!("{name}: f64 {double:.1e}, f32 {single:.1e}");
        assert!(double < 1e-14, "{name}: {double}");
        assert!(single < 1e-6, "{name}: {single}");
    }
}

/// With subgroups, where the device has them, and without.
#[test]
fn the_device_gets_what_the_cpu_gets() {
    let without = common::limited(wgpu::Limits::default());
    assert!(!without.device.features().contains(Features::SUBGROUP));
    for (name, case) in cases() {
        let (radiosity, before) = (case.colours(1), case.colours(2));
        let expected = case.cpu::<f32>(&radiosity, &before);
        for (kind, gpu) in [("shared", gpu()), ("alone", &without)] {
            let found = case.gpu(gpu, &radiosity, &before);
            let off = difference(&found, &expected);
            println!("{name}, {kind}: {off:.1e}");
            assert!(off < 1e-6, "{name}, {kind}: {off}");
        }
    }
}
