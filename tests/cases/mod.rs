//! Clouds with links, and their light, on both sides.
#![allow(dead_code)]

use crate::common::{clutter, gpu, polygons, random, room, sphere};
use fmmgi_gpu::expansion::Expansions;
use fmmgi_gpu::links::{self, Accuracy, Entry, Links, Rows};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Fields, GpuFmm, TransportOperator};
use fmmgi_gpu::passes::gpu::{Batch, Batches, Stages};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::visibility::NothingInTheWay;
use fmmgi_gpu::{Result, Surfels};
use glam::{DVec3, Vec3};
use rand::RngExt;
use wgpu::Buffer;

/// A cloud with octree and links.
pub struct Case {
    pub name: &'static str,
    pub surfels: Surfels,
    pub octree: Octree,
    pub links: Links,
}

impl Case {
    /// With the links that the product would find.
    pub fn linked(name: &'static str, surfels: &Surfels, error: f32) -> Case {
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
    pub fn open(name: &'static str, surfels: &Surfels, order: usize, error: f32) -> Case {
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
    pub fn tangled(name: &'static str, surfels: &Surfels, order: usize, seed: u64) -> Case {
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

    pub fn stages(&self) -> Stages {
        Stages::new(gpu(), &self.surfels, &self.octree, &self.links).unwrap()
    }

    pub fn operator(&self) -> GpuFmm {
        GpuFmm::new(gpu(), &self.surfels, &self.octree, &self.links).unwrap()
    }
}
/// Rooms and clutter; then a single surfel, a root that is a leaf, many surfels at one place (a
/// large leaf of scale 1), no links at all.
pub fn cases() -> Vec<Case> {
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

pub fn colours(n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = random(seed);
    (0..n)
        .map(|_| DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.0..2.0))))
        .collect()
}

/// A buffer on the device of the tests that holds these colours, with NaN as the fourth.
pub fn buffer(colours: &[Vec3]) -> Buffer {
    let vectors: Vec<[f32; 4]> = colours
        .iter()
        .map(|c| c.extend(f32::NAN).to_array())
        .collect();
    let buffer = gpu().storage("test", vectors.len() * 16).unwrap();
    fill(&buffer, &vectors);
    buffer
}

pub fn fill(buffer: &Buffer, vectors: &[[f32; 4]]) {
    gpu()
        .queue
        .write_buffer(buffer, 0, bytemuck::cast_slice(vectors));
}

pub fn poison(buffer: &Buffer) {
    fill(buffer, &vec![[f32::NAN; 4]; buffer.size() as usize / 16]);
}

/// Runs a stage; returns the colours that `result` holds then.
pub fn run(result: &Buffer, record: impl FnOnce(&mut Batch) -> Result<()>) -> Vec<Vec3> {
    let batches = Batches::new(gpu()).unwrap();
    let count = result.size() as usize / 16;
    let vectors: Vec<[f32; 4]> = batches.run_and_read("test", result, count, record).unwrap();
    vectors
        .iter()
        .map(|&[r, g, b, _]| Vec3::new(r, g, b))
        .collect()
}

/// Expansions in the device's layout.
pub fn as_colours(expansions: &Expansions<f32>) -> Vec<Vec3> {
    expansions.as_slice().iter().map(|&c| c.into()).collect()
}

/// Largest difference in units of the largest value.
pub fn difference(a: &[Vec3], b: &[Vec3]) -> f32 {
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

pub fn relative_l2(a: &[DVec3], b: &[DVec3]) -> f64 {
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
pub const ROUNDING: f32 = 4e-6;

pub fn vectors(colours: &[Vec3]) -> Vec<[f32; 4]> {
    colours.iter().map(|c| c.extend(0.0).to_array()).collect()
}

pub fn on_host<O: TransportOperator>(operator: &O, radiosity: &[DVec3]) -> Vec<DVec3> {
    let fields = operator.fields();
    let irradiance = operator.apply(&fields.upload(radiosity).unwrap()).unwrap();
    fields.download(&irradiance).unwrap()
}
