//! Normals and areas of clouds that have none, against the true ones.

mod clouds;

use std::f64::consts::{PI, TAU};
use std::path::Path;

use clouds::*;
use fmmgi_gpu::points::Facing;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{PointCloud, Scene};
use glam::{DVec2, DVec3, Vec3};
use rand::RngExt;

/// A shape with true normals.
struct Shape {
    name: &'static str,
    cloud: PointCloud,
    area: f64,
    facing: Facing,
}

fn built_in(name: &str, points: usize) -> PointCloud {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
        ..SceneOptions::default()
    };
    let mut cloud = Scene::load(&path, &options, &Silent).unwrap().cloud;
    cloud.repairs.clear();
    cloud
}

/// Sum of the given areas, which are dropped.
fn take_area(cloud: &mut PointCloud) -> f64 {
    let areas = std::mem::take(&mut cloud.areas);
    areas.iter().map(|&a| f64::from(a)).sum()
}

/// A torus of radii 1 and 0.4, with points anywhere.
fn torus(n: usize, seed: u64) -> PointCloud {
    let mut rng = random(seed);
    let mut points = Vec::with_capacity(n);
    while points.len() < n {
        let [u, v] = [(); 2].map(|()| rng.random_range(0.0..TAU));
        let out = DVec2::from_angle(u).extend(0.0);
        let normal = out * v.cos() + DVec3::Z * v.sin();
        if rng.random_range(0.0..1.4) < 1.0 + 0.4 * v.cos() {
            points.push((out + normal * 0.4, normal));
        }
    }
    cloud(points)
}

/// A wall of two sides, `thick` spacings thick, with its edges.
fn wall(k: usize, thick: f64) -> PointCloud {
    let t = thick / k as f64;
    let rows = (thick.round() as usize).max(1);
    let mut cloud = joined([
        quad(DVec3::Z * t, DVec3::X, DVec3::Y, k, 0.7, 1),
        quad(DVec3::ZERO, DVec3::Y, DVec3::X, k, 0.7, 2),
    ]);
    let mut rng = random(3);
    for i in 0..k * rows {
        let along = ((i % k) as f64 + rng.random::<f64>()) / k as f64;
        let up = ((i / k) as f64 + rng.random::<f64>()) / rows as f64 * t;
        for (place, normal) in [
            (DVec3::new(along, 0.0, up), DVec3::NEG_Y),
            (DVec3::new(along, 1.0, up), DVec3::Y),
            (DVec3::new(0.0, along, up), DVec3::NEG_X),
            (DVec3::new(1.0, along, up), DVec3::X),
        ] {
            cloud.positions.push(place);
            cloud.normals.push(normal.as_vec3());
            cloud.reflectance.push(Vec3::splat(0.5));
            cloud.emission.push(Vec3::ZERO);
        }
    }
    cloud
}

fn shapes() -> Vec<Shape> {
    let mut cornell = built_in("cornell", 20_000);
    let mut organic = built_in("organic", 20_000);
    let mut cave = built_in("cave", 30_000);
    let [room, organic_area, cave_area] = [&mut cornell, &mut organic, &mut cave].map(take_area);
    let shape = |name, cloud, area, facing| Shape {
        name,
        cloud,
        area,
        facing,
    };
    vec![
        shape(
            "sphere",
            sphere(10_000, 1.0, false, 1),
            4.0 * PI,
            Facing::Outward,
        ),
        shape("box", cube(41, 0.9, false, 1), 6.0, Facing::Outward),
        shape(
            "torus",
            torus(10_000, 1),
            4.0 * PI * PI * 0.4,
            Facing::Outward,
        ),
        shape(
            "wall, 6 spacings",
            wall(60, 6.0),
            2.0 + 24.0 / 60.0,
            Facing::Outward,
        ),
        shape(
            "wall, 2 spacings",
            wall(60, 2.0),
            2.0 + 8.0 / 60.0,
            Facing::Outward,
        ),
        shape("cornell", cornell, room, Facing::Inward),
        shape("organic", organic, organic_area, Facing::Inward),
        shape("cave", cave, cave_area, Facing::Inward),
    ]
}

/// The same with points moved in all directions by a normal distribution of this width.
fn shaken(cloud: &PointCloud, width: f64, seed: u64) -> PointCloud {
    let mut rng = random(seed);
    let mut gauss = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    let mut shaken = cloud.clone();
    for p in &mut shaken.positions {
        *p += DVec3::new(gauss(), gauss(), gauss()) * width;
    }
    shaken
}

#[derive(Debug)]
struct Found {
    median: f64,
    p95: f64,
    wrong: f64,
    area: f64,
}

fn without_normals(cloud: &PointCloud, facing: &Facing) -> PointCloud {
    let mut bare = cloud.clone();
    bare.normals.clear();
    bare.areas.clear();
    bare.estimate_normals(facing, &Silent).unwrap();
    bare
}

/// Angles in degrees to the true normals, whatever the sign, the share of wrong signs, and the error of
/// the area.
fn measured(cloud: &PointCloud, area: f64, facing: &Facing) -> Found {
    let bare = without_normals(cloud, facing);
    let cosines: Vec<f64> = (bare.normals.iter().zip(&cloud.normals))
        .map(|(a, b)| a.as_dvec3().dot(b.as_dvec3().normalize()))
        .collect();
    let mut angles: Vec<f64> = cosines
        .iter()
        .map(|c| c.abs().min(1.0).acos().to_degrees())
        .collect();
    angles.sort_by(f64::total_cmp);
    let wrong = cosines.iter().filter(|c| **c < 0.0).count();
    let n = angles.len();
    let areas = surfels(&bare).areas;
    Found {
        median: angles[n / 2],
        p95: angles[n * 95 / 100],
        wrong: wrong as f64 / n as f64,
        area: areas.iter().map(|&a| f64::from(a)).sum::<f64>() / area - 1.0,
    }
}

#[test]
fn noise_tilts_normals_no_more_than_it_must() {
    for Shape {
        name,
        cloud,
        area,
        facing,
    } in shapes()
    {
        let spacing = (area / cloud.len() as f64).sqrt();
        for noise in [0.0, 0.1, 0.5, 1.0] {
            let found = measured(&shaken(&cloud, noise * spacing, 5), area, &facing);
            println!(
                "{name:18} noise {noise:3}: median {:5.2} p95 {:6.2} degrees, wrong signs {:6.3}%, area {:+.1}%",
                found.median,
                found.p95,
                100.0 * found.wrong,
                100.0 * found.area
            );
        }
    }
}
