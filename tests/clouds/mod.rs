//! Clouds of known shapes, for the tests of the transport.
#![allow(dead_code)]

use std::f64::consts::{PI, TAU};

use fmmgi_gpu::points::Prepared;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{PointCloud, Surfels};
use glam::{DQuat, DVec2, DVec3, Vec2, Vec3};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

pub fn random(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

pub fn direction(rng: &mut impl Rng) -> DVec3 {
    let z: f64 = rng.random_range(-1.0..1.0);
    (DVec2::from_angle(rng.random_range(0.0..TAU)) * (1.0 - z * z).sqrt()).extend(z)
}

pub fn rotation(seed: u64) -> DQuat {
    let mut rng = random(seed);
    DQuat::from_axis_angle(direction(&mut rng), rng.random_range(0.5..2.5))
}

/// A grey cloud without areas.
pub fn cloud(points: impl IntoIterator<Item = (DVec3, DVec3)>) -> PointCloud {
    let (positions, normals): (Vec<_>, Vec<_>) =
        points.into_iter().map(|(p, n)| (p, n.as_vec3())).unzip();
    PointCloud {
        reflectance: vec![Vec3::splat(0.5); positions.len()],
        emission: vec![Vec3::ZERO; positions.len()],
        positions,
        normals,
        ..PointCloud::default()
    }
}

pub fn prepare(cloud: &PointCloud) -> Prepared {
    Surfels::prepare(cloud, &Silent).expect("a usable cloud")
}

pub fn surfels(cloud: &PointCloud) -> Surfels {
    prepare(cloud).surfels
}

pub fn joined(clouds: impl IntoIterator<Item = PointCloud>) -> PointCloud {
    let mut all = PointCloud::default();
    for c in clouds {
        all.positions.extend(c.positions);
        all.normals.extend(c.normals);
        all.areas.extend(c.areas);
        all.reflectance.extend(c.reflectance);
        all.emission.extend(c.emission);
    }
    all
}

/// x -> scale * rotation * x + shift
pub fn moved(cloud: &PointCloud, rotation: DQuat, scale: f64, shift: DVec3) -> PointCloud {
    let mut moved = cloud.clone();
    for p in &mut moved.positions {
        *p = rotation * *p * scale + shift;
    }
    for n in &mut moved.normals {
        *n = (rotation * n.as_dvec3()).as_vec3();
    }
    for a in &mut moved.areas {
        *a *= (scale * scale) as f32;
    }
    moved
}

/// Entry k is entry `order[k]` of the cloud.
pub fn permuted(cloud: &PointCloud, order: &[usize]) -> PointCloud {
    let pick = |v: &[Vec3]| order.iter().map(|&i| v[i]).collect::<Vec<_>>();
    PointCloud {
        positions: order.iter().map(|&i| cloud.positions[i]).collect(),
        normals: pick(&cloud.normals),
        areas: match cloud.areas.is_empty() {
            true => Vec::new(),
            false => order.iter().map(|&i| cloud.areas[i]).collect(),
        },
        reflectance: pick(&cloud.reflectance),
        emission: pick(&cloud.emission),
        ..PointCloud::default()
    }
}

pub fn shuffled(n: usize, seed: u64) -> Vec<usize> {
    let mut rng = random(seed);
    let mut order: Vec<usize> = (0..n).collect();
    for i in (1..n).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
    order
}

/// The same with normals tilted by `tilt` radians and positions moved along them by `shift` (both
/// standard deviations).
pub fn noisy(cloud: &PointCloud, tilt: f64, shift: f64, seed: u64) -> PointCloud {
    let mut rng = random(seed);
    let mut gauss = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let mut noisy = cloud.clone();
    for (p, n) in noisy.positions.iter_mut().zip(&mut noisy.normals) {
        let normal = n.as_dvec3();
        let a = normal.any_orthonormal_vector();
        let b = normal.cross(a);
        *p += normal * (shift * gauss());
        *n = (normal + a * (tilt * gauss()) + b * (tilt * gauss()))
            .normalize()
            .as_vec3();
    }
    noisy
}

/// k by k points on the parallelogram, one in the middle part `jitter` of each stratum; the normal
/// is that of u × v.
pub fn quad(corner: DVec3, u: DVec3, v: DVec3, k: usize, jitter: f64, seed: u64) -> PointCloud {
    let mut rng = random(seed);
    let normal = u.cross(v).normalize();
    cloud((0..k * k).map(|i| {
        let mut at = |q: usize| (q as f64 + 0.5 + jitter * (rng.random::<f64>() - 0.5)) / k as f64;
        (corner + u * at(i / k) + v * at(i % k), normal)
    }))
}

/// `n` points anywhere on the unit square z = 0.
pub fn random_square(n: usize, seed: u64) -> PointCloud {
    let mut rng = random(seed);
    cloud((0..n).map(|_| (DVec3::new(rng.random(), rng.random(), 0.0), DVec3::Z)))
}

/// The unit cube seen from inside (or outside), k by k points a face.
pub fn cube(k: usize, jitter: f64, inside: bool, seed: u64) -> PointCloud {
    let faces = [
        (DVec3::ZERO, DVec3::X, DVec3::Y),
        (DVec3::Z, DVec3::Y, DVec3::X),
        (DVec3::ZERO, DVec3::Y, DVec3::Z),
        (DVec3::X, DVec3::Z, DVec3::Y),
        (DVec3::ZERO, DVec3::Z, DVec3::X),
        (DVec3::Y, DVec3::X, DVec3::Z),
    ];
    joined(faces.iter().enumerate().map(|(f, &(corner, u, v))| {
        let (u, v) = if inside { (u, v) } else { (v, u) };
        quad(corner, u, v, k, jitter, seed * 6 + f as u64)
    }))
}

/// Places spread over the unit sphere (Fibonacci), moved at random by `jitter` of their spacing.
pub fn on_sphere(n: usize, jitter: f64, seed: u64) -> Vec<DVec3> {
    let mut rng = random(seed);
    let golden = PI * (5f64.sqrt() - 1.0);
    let spacing = (4.0 * PI / n as f64).sqrt();
    (0..n)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / n as f64;
            let p = (DVec2::from_angle(golden * i as f64) * (1.0 - z * z).sqrt()).extend(z);
            let shift = DVec3::from_array(std::array::from_fn(|_| rng.random::<f64>() - 0.5));
            (p + shift * (jitter * spacing)).normalize()
        })
        .collect()
}

/// The unit sphere seen from inside or outside.
pub fn sphere(n: usize, jitter: f64, inside: bool, seed: u64) -> PointCloud {
    let side = if inside { -1.0 } else { 1.0 };
    cloud(
        on_sphere(n, jitter, seed)
            .into_iter()
            .map(|p| (p, p * side)),
    )
}

/// Surfels as they are given, even several at one place, each a square cell of this area.
pub fn bare(points: impl IntoIterator<Item = (DVec3, DVec3)>, area: f64) -> Surfels {
    let mut s = Surfels::default();
    let half = (0.5 * area.sqrt()) as f32;
    for (p, n) in points {
        let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)];
        let corner = |k: usize| Vec2::from(corners[k.min(3)]) * half;
        s.points.push(s.positions.len() as u32);
        s.positions.push(p.as_vec3());
        s.normals.push(n.as_vec3());
        s.areas.push(area as f32);
        s.reflectance.push(Vec3::splat(0.5));
        s.emission.push(Vec3::ZERO);
        s.offsets.push(0.02 * half);
        s.depths.push(0.0);
        s.cells.tangents.push(n.any_orthonormal_vector().as_vec3());
        s.cells.corners.push(std::array::from_fn(corner));
    }
    s
}
