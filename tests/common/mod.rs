//! Clouds made by hand, shipped scenes, and a device to test on.
#![allow(dead_code)]

use std::sync::OnceLock;

use fmmgi_gpu::passes::gpu::{Gpu, adapter};
use fmmgi_gpu::points::{Cells, MAX_EDGES};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{NO_SURFEL, Segment};
use fmmgi_gpu::{Scene, Surfels};
use glam::{DVec2, DVec3, Vec2, Vec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A device, real or software, shared by the tests of one binary.
pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| match adapter::open(&adapter::AdapterChoice::Any) {
        Ok(open) => {
            println!("tested on {}", open.info);
            Gpu::new(&open.device, &open.queue)
        }
        Err(error) => panic!(
            "this test needs a GPU or software Vulkan, which runs on any CPU (Debian and Ubuntu: \
             apt install mesa-vulkan-drivers): {error}"
        ),
    })
}

/// A device with lower limits than it could have, and with these features as far as it has them.
pub fn limited(required_limits: wgpu::Limits, features: wgpu::Features) -> Gpu {
    let instance = wgpu::Instance::default();
    let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        required_limits,
        required_features: features & adapter.features(),
        ..Default::default()
    }))
    .unwrap();
    Gpu::new(&device, &queue)
}

/// A shipped scene with about so many points.
pub fn scene(name: &str, points: usize) -> Scene {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
        ..SceneOptions::default()
    };
    Scene::load(path.as_ref(), &options, &Silent).unwrap()
}

pub fn random(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

/// Uniform in the box from -1 to 1.
pub fn in_box(rng: &mut impl Rng) -> Vec3 {
    Vec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

pub fn direction(rng: &mut impl Rng) -> Vec3 {
    loop {
        let v = in_box(rng);
        let length = v.length();
        if length > 0.1 && length < 1.0 {
            return v / length;
        }
    }
}

/// Surfels with regular cells of `edges` corners at distance `radius`.
pub fn polygons(places: &[(Vec3, Vec3)], edges: usize, radius: f32) -> Surfels {
    let n = places.len();
    let corner = |k: usize| {
        let angle = std::f32::consts::TAU * (k.min(edges - 1) as f32 + 0.5) / edges as f32;
        radius * Vec2::from_angle(angle)
    };
    let corners: [Vec2; MAX_EDGES] = std::array::from_fn(corner);
    let area = 0.5 * edges as f32 * radius * radius * (std::f32::consts::TAU / edges as f32).sin();
    Surfels {
        positions: places.iter().map(|p| p.0).collect(),
        normals: places.iter().map(|p| p.1).collect(),
        areas: vec![area; n],
        reflectance: vec![Vec3::splat(0.5); n],
        emission: vec![Vec3::ZERO; n],
        cells: Cells {
            tangents: places.iter().map(|p| tangent(p.1)).collect(),
            corners: vec![corners; n],
        },
        offsets: vec![0.1 * radius; n],
        depths: vec![0.0; n],
        occluder_scale: 1.0,
        points: (0..n as u32).collect(),
        ..Surfels::default()
    }
}

/// A unit vector orthogonal to `normal`; along an axis where `normal` is.
fn tangent(normal: Vec3) -> Vec3 {
    let n = normal.abs();
    let axis = match n.min_position() {
        0 => Vec3::X,
        1 => Vec3::Y,
        _ => Vec3::Z,
    };
    normal.cross(axis).normalize()
}

/// The box from -1 to 1, seen from inside, each wall in `k` by `k` squares.
pub fn room(k: usize) -> Surfels {
    let side = 2.0 / k as f32;
    let at = |i: usize| (i as f32 + 0.5) * side - 1.0;
    let mut places = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            for i in 0..k * k {
                let mut position = Vec3::splat(sign);
                position[(axis + 1) % 3] = at(i / k);
                position[(axis + 2) % 3] = at(i % k);
                let mut normal = Vec3::ZERO;
                normal[axis] = -sign;
                places.push((position, normal));
            }
        }
    }
    polygons(&places, 4, side * std::f32::consts::FRAC_1_SQRT_2)
}

/// A room of tiles that only touch, with clutter in it.
pub fn furnished_room() -> Surfels {
    let mut all = room(16);
    let things = clutter(500, 0.1, 5);
    all.positions.extend(&things.positions);
    all.normals.extend(&things.normals);
    all.depths.extend(&things.depths);
    all.cells.tangents.extend(&things.cells.tangents);
    all.cells.corners.extend(&things.cells.corners);
    all
}

/// The unit sphere in `n` overlapping hexagons (Fibonacci points).
pub fn sphere(n: usize) -> Surfels {
    let golden = std::f32::consts::PI * (5f32.sqrt() - 1.0);
    let places: Vec<_> = (0..n)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f32 / n as f32;
            let p = (1.0 - z * z).sqrt() * Vec2::from_angle(golden * i as f32);
            (p.extend(z), -p.extend(z))
        })
        .collect();
    polygons(&places, 6, (4.0 / n as f32).sqrt() * 1.5)
}

/// Cells anywhere in the box from -1 to 1, of any direction, of 3 to 8 corners.
pub fn clutter(n: usize, radius: f32, seed: u64) -> Surfels {
    let mut rng = random(seed);
    let places: Vec<_> = (0..n)
        .map(|_| (in_box(&mut rng), direction(&mut rng)))
        .collect();
    let mut all = polygons(&places, 3, radius);
    for i in 0..n {
        let one = polygons(&places[i..=i], rng.random_range(3..=MAX_EDGES), radius);
        all.cells.corners[i] = one.cells.corners[0];
    }
    all
}

pub fn segment(from: Vec3, to: Vec3) -> Segment {
    Segment {
        from: from.to_array(),
        skip_from: NO_SURFEL,
        to: to.to_array(),
        skip_to: NO_SURFEL,
    }
}

/// Long and short segments anywhere, and grazing ones that run from cell to cell just above them.
pub fn some_segments(surfels: &Surfels, n: usize) -> Vec<Segment> {
    let mut rng = random(11);
    (0..n)
        .map(|k| match k % 3 {
            0 => segment(1.2 * in_box(&mut rng), 1.2 * in_box(&mut rng)),
            1 => {
                let from = in_box(&mut rng);
                segment(from, from + 0.2 * direction(&mut rng))
            }
            _ => {
                let [i, j] = [(); 2].map(|_| rng.random_range(0..surfels.len()));
                let above = |i: usize| surfels.positions[i] + 1e-3 * surfels.normals[i];
                Segment {
                    skip_from: i as u32,
                    skip_to: j as u32,
                    ..segment(above(i), above(j))
                }
            }
        })
        .collect()
}

pub fn differing(a: &[bool], b: &[bool]) -> usize {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).filter(|(a, b)| a != b).count()
}

/// The cells that a segment meets, where along it and whether on their fronts; by another way than
/// that of the crate: all cells in turn, the plane by the parameter of the line, the polygon by its
/// winding angle.
pub fn crossings(surfels: &Surfels, s: &Segment) -> impl Iterator<Item = (f64, u32, bool)> {
    let from = Vec3::from(s.from).as_dvec3();
    let along = Vec3::from(s.to).as_dvec3() - from;
    let skipped = [s.skip_from, s.skip_to];
    (0..surfels.len()).filter_map(move |i| {
        if skipped.contains(&(i as u32)) {
            return None;
        }
        let [p, n, u]: [DVec3; 3] = [
            surfels.positions[i].as_dvec3(),
            surfels.normals[i].as_dvec3(),
            surfels.cells.tangents[i].as_dvec3(),
        ];
        let t = (p - from).dot(n) / along.dot(n);
        if !(t > 0.0 && t < 1.0) {
            return None;
        }
        let h = from + t * along - p;
        let h = DVec2::new(h.dot(u), h.dot(n.cross(u)));
        let c = surfels.cells.corners[i].map(|c| (c * surfels.occluder_scale).as_dvec2() - h);
        let winding: f64 = (0..c.len())
            .map(|k| c[k].angle_to(c[(k + 1) % c.len()]))
            .sum();
        (winding.abs() > std::f64::consts::PI).then_some((t, i as u32, along.dot(n) < 0.0))
    })
}
