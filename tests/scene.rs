//! Built-in shapes and scenes: the points stand for the surface that was asked for.

use std::f64::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{PointCloud, Scene};
use glam::{DVec3, Vec3, dvec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};

fn options(points: impl Into<Option<usize>>, seed: u64) -> SceneOptions {
    SceneOptions {
        points: points.into(),
        seed,
        ..SceneOptions::default()
    }
}

fn load_text(text: &str, points: impl Into<Option<usize>>) -> fmmgi_gpu::Result<Scene> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    fs::write(&path, text).unwrap();
    Scene::load(&path, &options(points, 1), &Silent)
}

fn shape(shape: &str, points: usize) -> PointCloud {
    load_text(&format!("[[shape]]\n{shape}"), points)
        .unwrap()
        .cloud
}

const SCENES: [&str; 8] = [
    "cornell",
    "furnace",
    "room",
    "plates_parallel",
    "plates_perpendicular",
    "two_rooms",
    "organic",
    "cave",
];

fn scene_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("scenes")
        .join(name)
        .with_extension("toml")
}

fn built_in(name: &str, points: impl Into<Option<usize>>) -> Scene {
    Scene::load(&scene_path(name), &options(points, 1), &Silent).unwrap()
}

fn area(cloud: &PointCloud) -> f64 {
    cloud.areas.iter().map(|&a| f64::from(a)).sum()
}

fn sum(cloud: &PointCloud, f: impl Fn(DVec3, DVec3) -> DVec3) -> DVec3 {
    let normals = cloud.normals.iter().map(|n| n.as_dvec3());
    let points = cloud.positions.iter().zip(normals).zip(&cloud.areas);
    points.map(|((&p, n), &a)| f(p, n) * f64::from(a)).sum()
}

/// Sum of A n: zero for a closed surface.
fn area_vector(cloud: &PointCloud) -> DVec3 {
    sum(cloud, |_, n| n)
}

/// Volume behind a closed surface by the divergence theorem: a third of the sum of A p·n.
fn volume(cloud: &PointCloud) -> f64 {
    sum(cloud, |p, n| dvec3(p.dot(n) / 3.0, 0.0, 0.0)).x
}

/// Distances to the nearest other point, over the spacing √(area / points).
fn distances(cloud: &PointCloud) -> Vec<f64> {
    let spacing = (area(cloud) / cloud.len() as f64).sqrt();
    let positions: Vec<[f64; 3]> = cloud.positions.iter().map(|p| p.to_array()).collect();
    let tree = ImmutableKdTree::new_from_slice(&positions).unwrap();
    let two = std::num::NonZeroUsize::new(2).unwrap();
    positions
        .iter()
        .map(|p| {
            let query = tree.query(p).nearest_n::<SquaredEuclidean<f64>>(two);
            query.execute()[1].distance.sqrt() / spacing
        })
        .collect()
}

fn min_and_mean(values: &[f64]) -> (f64, f64) {
    let min = values.iter().copied().fold(f64::MAX, f64::min);
    (min, values.iter().sum::<f64>() / values.len() as f64)
}

const QUAD: &str = "quad = { corner = [1, 2, 3], u = [2, 0, 0], v = [1, 3, 0] }";
const ROOM: &str = "box = { centre = [1, 2, 3], size = [1, 2, 3], inward = true }";
const BLOCK: &str = "box = { centre = [1, 2, 3], size = [1, 2, 3], rotate = [10, 20, 30] }";
const SPHERE: &str = "sphere = { centre = [5, 0, 0], radius = 2 }";
const BUMPS: &str = "sphere = { centre = [5, 0, 0], radius = 2, bumps = 0.35 }";
const CAVE: &str = "cave = { start = [1, 2, 3], radius = 2, length = 10, columns = 0 }";

#[test]
fn simple_shapes_have_the_number_of_points_asked_for() {
    for text in [QUAD, ROOM, BLOCK, SPHERE, BUMPS, CAVE] {
        for n in [6, 7, 100, 501, 5_000, 12_345] {
            assert_eq!(shape(text, n).len(), n, "{text}");
        }
    }
    assert_eq!(shape(QUAD, 1).len(), 1);
    assert_eq!(shape(SPHERE, 1).len(), 1);
}

#[test]
fn areas_add_up_to_the_surface() {
    // The table of a sphere's area element is a midpoint rule of 1024 rows: 4e-7 off; f32 areas
    // add 6e-8.
    for (text, exact) in [
        (QUAD, 6.0),
        (ROOM, 22.0),
        (BLOCK, 22.0),
        (SPHERE, 16.0 * PI),
    ] {
        for n in [6, 501, 10_000] {
            let ratio = area(&shape(text, n)) / exact;
            assert!((ratio - 1.0).abs() < 1e-6, "{text} at {n}: {ratio}");
        }
    }
    let hole = "quad = { corner = [0, 0, 0], u = [4, 0, 0], v = [0, 3, 0], hole = { u = [1, 2], v = [0, 2] } }";
    let cloud = shape(hole, 3_000);
    assert!((area(&cloud) / 10.0 - 1.0).abs() < 1e-6);
    let in_hole = |p: &&DVec3| (1.0..2.0).contains(&p.x) && (0.0..2.0).contains(&p.y);
    assert_eq!(cloud.positions.iter().filter(in_hole).count(), 0);
}

#[test]
fn closed_shapes_are_closed_and_have_their_volume() {
    for (text, exact) in [
        (BLOCK, 6.0),
        (ROOM, -6.0),
        (SPHERE, 32.0 / 3.0 * PI),
        // No closed form here: their own fine sampling.
        (BUMPS, volume(&shape(BUMPS, 200_000))),
        (CAVE, volume(&shape(CAVE, 200_000))),
    ] {
        let cloud = shape(text, 20_000);
        let gap = area_vector(&cloud).length() / area(&cloud);
        let error = volume(&cloud) / exact - 1.0;
        println!("{text}: gap {gap:.1e}, volume {exact:.3}, error {error:.1e}");
        assert!(gap < 1e-3, "{text}: {gap}");
        assert!(error.abs() < 2e-3, "{text}: {error}");
    }
    assert!(volume(&shape(CAVE, 20_000)) < 0.0, "a cave faces inwards");
}

#[test]
fn normals_of_spheres_point_from_and_to_the_centre() {
    for (inward, sign) in [(false, 1.0), (true, -1.0)] {
        let text = format!("sphere = {{ centre = [5, 0, 0], radius = 2, inward = {inward} }}");
        let cloud = shape(&text, 2_000);
        for (p, n) in cloud.positions.iter().zip(&cloud.normals) {
            let exact = (*p - dvec3(5.0, 0.0, 0.0)) / 2.0 * sign;
            assert!((exact.length() - 1.0).abs() < 1e-12);
            assert!((n.as_dvec3() - exact).length() < 1e-6);
        }
    }
}

#[test]
fn points_keep_their_distance() {
    // Random points have a mean of 0.5 and a minimum near 0; a square grid has 1 and 1.
    for (text, least) in [
        (QUAD, 0.35),
        (BLOCK, 0.3),
        (SPHERE, 0.25),
        (BUMPS, 0.1),
        (CAVE, 0.1),
    ] {
        let (min, mean) = min_and_mean(&distances(&shape(text, 20_000)));
        println!("{text}: nearest neighbour min {min:.3}, mean {mean:.3}");
        assert!(min > least && mean > 0.65, "{text}: {min} {mean}");
    }
}

#[test]
fn the_seed_decides_and_the_threads_do_not() {
    let with = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let load = || Scene::load(&scene_path("cave"), &options(9_000, seed), &Silent).unwrap();
        pool.unwrap().install(load).cloud
    };
    let (one, four, other) = (with(1, 1), with(4, 1), with(4, 2));
    assert_eq!(one.positions, four.positions);
    assert_eq!(one.normals, four.normals);
    let same = one.positions.iter().filter(|p| other.positions.contains(p));
    assert_eq!(same.count(), 0);
}

#[test]
fn what_lies_under_or_in_a_solid_is_removed() {
    // A block on a floor, another on top of it, and a ball half in the upper block's side.
    let text = r#"
        [[shape]]
        quad = { corner = [-2, 0, -2], u = [0, 0, 4], v = [4, 0, 0] }
        [[shape]]
        box = { centre = [0, 0.5, 0], size = [2, 1, 2], open = ["bottom"] }
        [[shape]]
        box = { centre = [0, 1.5, 0], size = [1, 1, 1], open = ["bottom"] }
        [[shape]]
        sphere = { centre = [0.5, 1.5, 0], radius = 0.25 }
    "#;
    let cloud = load_text(text, 40_000).unwrap().cloud;
    let exact = (16.0 - 4.0) + (4.0 * 2.0 + 4.0 - 1.0) + (4.0 + 1.0 - PI / 16.0) + PI / 8.0;
    let ratio = area(&cloud) / exact;
    // The edges of what is covered (8 + 4 + π/2 long) pass through strata of 0.027, each counted or
    // not: half a stratum is the worst that a row of them can make.
    let bound = 0.5 * 0.027 * 13.6 / exact;
    assert!((ratio - 1.0).abs() < bound, "{ratio}");
    let gap = area_vector(&cloud) - dvec3(0.0, 16.0, 0.0);
    assert!(gap.length() / exact < bound, "{gap}");
    for p in &cloud.positions {
        assert!(!(p.y < 0.99 && p.x.abs() < 0.999 && p.z.abs() < 0.999));
        assert!(!(p.y < 1.99 && p.x.abs() < 0.499 && p.z.abs() < 0.499));
        assert!((*p - dvec3(0.5, 1.5, 0.0)).length() > 0.2499);
    }
}

#[test]
fn every_scene_is_sound_at_every_size() {
    for name in SCENES {
        let truth = area(&built_in(name, 200_000).cloud);
        for points in [Some(500), Some(5_000), None] {
            let scene = built_in(name, points);
            let cloud = &scene.cloud;
            let n = cloud.len();
            assert!(points.is_none_or(|p| n <= p && n * 10 > p * 8), "{name}");
            assert!((400..=60_000).contains(&n), "{name}: {n}");
            for len in [
                cloud.normals.len(),
                cloud.areas.len(),
                cloud.reflectance.len(),
                cloud.emission.len(),
            ] {
                assert_eq!(len, n, "{name}");
            }
            assert!(cloud.positions.iter().all(|p| p.is_finite()));
            assert!(cloud.normals.iter().all(|n| n.is_normalized()));
            assert!(cloud.areas.iter().all(|&a| a > 0.0 && a.is_finite()));
            let in_range = |r: &Vec3| r.min_element() >= 0.0 && r.max_element() <= 1.0;
            assert!(cloud.reflectance.iter().all(in_range));
            assert!(cloud.emission.iter().any(|e| e.max_element() > 0.0));
            assert!(scene.camera.is_some());

            let error = area(cloud) / truth - 1.0;
            let (min, mean) = min_and_mean(&distances(cloud));
            println!("{name} {n}: area {error:.1e}, distance min {min:.3} mean {mean:.3}");
            assert!(error.abs() < 0.02, "{name} at {n}: {error}");
            assert!(mean > 0.6 && min > 0.02, "{name} at {n}: {min} {mean}");
        }
    }
}

#[test]
fn scenes_have_no_gaps() {
    // What the free space is bounded by is closed, but for the front of the Cornell box.
    for (name, open) in [
        ("cornell", dvec3(0.0, 0.0, 1.0)),
        ("furnace", DVec3::ZERO),
        ("room", DVec3::ZERO),
        ("two_rooms", DVec3::ZERO),
        ("organic", DVec3::ZERO),
        ("cave", DVec3::ZERO),
    ] {
        let cloud = built_in(name, None).cloud;
        let gap = (area_vector(&cloud) - open).length() / area(&cloud);
        println!("{name}: {gap:.1e}");
        assert!(gap < 3e-3, "{name}: {gap}");
    }
}

#[test]
fn two_rooms_are_joined_by_the_door_only() {
    let cloud = built_in("two_rooms", None).cloud;
    for (p, n) in cloud.positions.iter().zip(&cloud.normals) {
        let behind_door = (0.9..=1.6).contains(&p.z) && p.y <= 2.0;
        if (3.999..4.051).contains(&p.x) {
            let on_side = n.x.abs() > 0.999;
            // Each side of the wall faces its room.
            assert!(!on_side || (!behind_door && (n.x < 0.0) == (p.x < 4.01)));
        }
    }
    // 5 cm of wall on both sides and the door's frame: 2 x (7.5 - 1.4) + 2 x (2 + 0.7) x 0.05.
    let wall = (0..cloud.len()).filter(|&i| {
        let p = cloud.positions[i];
        (3.9999..4.0501).contains(&p.x) && (cloud.normals[i].x.abs() > 0.5 || p.y < 2.0001)
    });
    let wall: f64 = wall.map(|i| f64::from(cloud.areas[i])).sum();
    assert!((wall - 12.47).abs() < 0.05, "{wall}");
}
