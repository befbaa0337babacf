//! Scene files and built-in shapes: what comes out is the surface that was asked for.

use std::f64::consts::PI;
use std::fs;
use std::path::{Path, PathBuf};

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Error, PointCloud, Result, Scene};
use glam::{DVec3, Vec3, dvec3};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use proptest::prelude::*;

fn options(points: impl Into<Option<usize>>, seed: u64) -> SceneOptions {
    SceneOptions {
        points: points.into(),
        seed,
    }
}

fn load_text(text: &str, points: impl Into<Option<usize>>) -> Result<Scene> {
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

const SCENES: [&str; 7] = [
    "cornell",
    "furnace",
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

#[test]
fn everything_in_a_scene_file_arrives() {
    let text = r#"
        points = 10
        tolerance = 0.01
        sky = [0.1, 0.2, 0.3]
        [camera]
        position = [0, 0, 5]
        look_at = [0, 0, 0]
        [[light]]
        position = [1, 2, 3]
        intensity = 4
        [[shape]]
        quad = { corner = [0, 0, 0], u = [1, 0, 0], v = [0, 1, 0] }
        reflectance = [0.1, 0.2, 0.3]
        emission = 2
        [[shape]]
        box = { centre = [5, 0, 0], size = [1, 1, 1], open = ["left", "back"], faces = { top = 0.9 } }
    "#;
    let scene = load_text(text, None).unwrap();
    assert_eq!(scene.cloud.len(), 10);
    assert_eq!(scene.tolerance, Some(0.01));
    assert_eq!(scene.sky, Vec3::new(0.1, 0.2, 0.3));
    let camera = scene.camera.unwrap();
    assert_eq!((camera.up, camera.fov), (DVec3::Y, 45.0));
    assert_eq!(scene.lights.len(), 1);
    assert_eq!(scene.lights[0].position, dvec3(1.0, 2.0, 3.0));
    assert_eq!(scene.lights[0].intensity, Vec3::splat(4.0));
    let cloud = &scene.cloud;
    assert_eq!(cloud.reflectance[0], Vec3::new(0.1, 0.2, 0.3));
    assert_eq!(cloud.emission[0], Vec3::splat(2.0));
    assert_eq!(cloud.normals[0], Vec3::Z);
    for i in (0..10).filter(|&i| cloud.positions[i].x > 2.0) {
        let top = cloud.normals[i].y > 0.5;
        assert_eq!(cloud.reflectance[i].x, if top { 0.9 } else { 0.5 });
        assert!(cloud.normals[i].x > -0.5 && cloud.normals[i].z > -0.5);
    }
    // A quarter turn about y takes z to x, and the front with it.
    let turned =
        "box = { centre = [0, 0, 0], size = [1, 1, 1], rotate = [0, 90, 0], open = [\"front\"] }";
    assert!(shape(turned, 60).normals.iter().all(|n| n.x < 0.5));
    // About x first, then y: y goes to z, and z to x.
    let turned =
        "box = { centre = [0, 0, 0], size = [1, 1, 1], rotate = [90, 90, 0], open = [\"top\"] }";
    assert!(shape(turned, 60).normals.iter().all(|n| n.x < 0.5));
}

#[test]
fn bad_scene_files_are_refused_in_words() {
    let camera = |rest: &str| format!("[camera]\n{rest}\n[[shape]]\n{QUAD}");
    let with = |rest: &str| format!("[[shape]]\n{rest}");
    let cases: &[(String, &[&str])] = &[
        ("".into(), &["nothing to light"]),
        ("points = [".into(), &["line 1"]),
        (
            "\nsky = 1\nskye = 2".into(),
            &["line 3", "unknown key `skye`", "tolerance", "light"],
        ),
        (
            with(&format!("{QUAD}\nreflectence = 1")),
            &["line 3", "reflectence", "`reflectance`"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0], w = [0,1,0] }"),
            &["line 2", "`w`", "`v`"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0] }"),
            &["line 2", "missing key", "`v`"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0], v = [2,0,0] }"),
            &["line 2", "span an area"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0], v = [0,0,0] }"),
            &["span an area"],
        ),
        (
            with("quad = { corner = [0,0,nan], u = [1,0,0], v = [0,1,0] }"),
            &["line 2", "NaN"],
        ),
        (
            with("quad = { corner = [0,0,inf], u = [1,0,0], v = [0,1,0] }"),
            &["inf"],
        ),
        (
            with("quad = { corner = [0,0], u = [1,0,0], v = [0,1,0] }"),
            &["three numbers", "got 2"],
        ),
        (
            with("quad = { corner = [0,0,0,0], u = [1,0,0], v = [0,1,0] }"),
            &["got 4"],
        ),
        (with("quad = 3"), &["line 2", "expected a table", "corner"]),
        (
            with("quad = { corner = 1, u = [1,0,0], v = [0,1,0] }"),
            &["expected a list of numbers"],
        ),
        (
            with(
                "quad = { corner = [0,0,0], u = [1,0,0], v = [0,1,0], hole = { u = [0.5, 1.5], v = [0, 0.5] } }",
            ),
            &["hole", "within the edges"],
        ),
        (
            with(
                "quad = { corner = [0,0,0], u = [1,0,0], v = [0,1,0], hole = { u = [0, 1], v = [0, 1] } }",
            ),
            &["leaves nothing"],
        ),
        (
            with(
                "quad = { corner = [0,0,0], u = [1,0,0], v = [0,1,0], hole = { u = [0.5, 0.5], v = [0, 1] } }",
            ),
            &["from < to"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 0 }"),
            &["line 2", "above 0"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = -1 }"),
            &["above 0"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1e300 }"),
            &["1e12"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1, bumps = 2 }"),
            &["bumps 2", "0.8"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1, bumps = nan }"),
            &["bumps NaN"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1, inward = 1 }"),
            &["expected a boolean"],
        ),
        (
            with("box = { centre = [0,0,0], size = [1,0,1] }"),
            &["above 0"],
        ),
        (
            with("box = { centre = [0,0,0], size = [1,1,1], open = [\"lid\"] }"),
            &["lid", "top"],
        ),
        (
            with("box = { centre = [0,0,0], size = [1,1,1], faces = { top = 2 } }"),
            &["reflectance", "between 0 and 1"],
        ),
        (
            with(
                "box = { centre = [0,0,0], size = [1,1,1], open = [\"left\",\"right\",\"top\",\"bottom\",\"front\",\"back\"] }",
            ),
            &["left out"],
        ),
        (
            with("cave = { start = [0,0,0], radius = 1, length = 1000, columns = 1 }"),
            &["100 times"],
        ),
        (
            with("cave = { start = [0,0,0], radius = 1, length = 10, columns = 1000000 }"),
            &["columns 1000000"],
        ),
        (with("reflectance = 0.5"), &["line 1", "exactly one"]),
        (with(&format!("{QUAD}\n{SPHERE}")), &["exactly one"]),
        (
            with(&format!("{QUAD}\nreflectance = 1.5")),
            &["line 3", "between 0 and 1"],
        ),
        (
            with(&format!("{QUAD}\nreflectance = [0, -0.1, 0]")),
            &["between 0 and 1"],
        ),
        (
            with(&format!("{QUAD}\nreflectance = [0, 1]")),
            &["invalid length 2"],
        ),
        (
            with(&format!("{QUAD}\nreflectance = \"red\"")),
            &["a number or three"],
        ),
        (
            with(&format!("{QUAD}\nemission = -1")),
            &["line 3", "from 0 on"],
        ),
        (with(&format!("{QUAD}\nemission = nan")), &["NaN"]),
        (with(&format!("{QUAD}\nemission = 1e300")), &["below 1e15"]),
        (
            format!("points = 0\n{}", with(QUAD)),
            &["line 1", "at least 1"],
        ),
        (format!("points = -5\n{}", with(QUAD)), &["-5"]),
        (format!("points = 1.5\n{}", with(QUAD)), &["whole number"]),
        (
            format!("points = 1000000000000\n{}", with(QUAD)),
            &["1000000000000 points"],
        ),
        (
            format!("points = 4000000000\n{}", with(QUAD)),
            &["4000000000 points", "MiB"],
        ),
        (
            format!("tolerance = 0\n{}", with(QUAD)),
            &["line 1", "between 0 and 1"],
        ),
        (format!("sky = -1\n{}", with(QUAD)), &["line 1", "-1"]),
        (
            format!(
                "[[light]]\nposition = [0,0,0]\nintensity = -1\n{}",
                with(QUAD)
            ),
            &["line 3"],
        ),
        (
            format!(
                "[[light]]\nposition = [0,nan,0]\nintensity = 1\n{}",
                with(QUAD)
            ),
            &["line 2"],
        ),
        (
            format!("[[light]]\nposition = [0,0,0]\n{}", with(QUAD)),
            &["line 1", "intensity"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [0,0,0]"),
            &["line 1", "same place"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [0,3,0]"),
            &["along the view"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [0,3,0]\nup = [0,0,0]"),
            &["zero"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [1,0,0]\nfov = 180"),
            &["fov 180"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [1,0,0]\nfov = nan"),
            &["fov NaN"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [1,0,0]\nfow = 50"),
            &["line 4", "`fow`", "`fov`"],
        ),
        (
            "[[cloud]]\nfile = \"scene.toml\"".into(),
            &["scene.toml", "scene file"],
        ),
        ("[[cloud]]\nfile = \"none.ply\"".into(), &["none.ply"]),
        (
            "[[cloud]]\nfile = \"none.ply\"\nscale = 0".into(),
            &["line 3", "above 0"],
        ),
    ];
    for (text, words) in cases {
        let Err(error) = load_text(text, None) else {
            panic!("accepted:\n{text}");
        };
        let message = error.to_string();
        for word in *words {
            assert!(
                message.contains(word),
                "`{word}` is not in:\n{message}\nfor:\n{text}"
            );
        }
        assert_eq!(error.exit_code(), 1);
    }
}

#[test]
fn bad_requests_are_refused_in_words() {
    let text = format!("[[shape]]\n{BLOCK}");
    assert!(matches!(load_text(&text, 0), Err(Error::Usage(_))));
    assert!(matches!(load_text(&text, 5), Err(Error::Usage(m)) if m.contains("too few")));
    let trillion = load_text(&text, 1_000_000_000_000);
    assert!(matches!(trillion, Err(Error::TooLarge(_))));
    // The number of points is for shapes.
    let cloud = load_text("[[cloud]]\nfile = \"a.ply\"", 100);
    assert!(matches!(cloud, Err(Error::Usage(m)) if m.contains("built-in shapes")));

    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("none.toml");
    let load = |path: &Path| Scene::load(path, &SceneOptions::default(), &Silent);
    assert!(matches!(load(&missing), Err(Error::Io { path, .. }) if path == missing));
    let directory = folder.path().join("folder.toml");
    fs::create_dir(&directory).unwrap();
    assert!(matches!(load(&directory), Err(Error::Io { .. })));
    let binary = folder.path().join("binary.toml");
    fs::write(&binary, [0xff, 0xfe, 0x00]).unwrap();
    assert!(load(&binary).unwrap_err().to_string().contains("UTF-8"));
    let long = folder.path().join("long.toml");
    fs::write(&long, vec![b'#'; (16 << 20) + 1]).unwrap();
    assert!(load(&long).unwrap_err().to_string().contains("16 MiB"));
    // A ball within a block: nothing of it is left, and of two blocks at one place something is.
    let hidden = format!("{text}\n[[shape]]\nsphere = {{ centre = [1, 2, 3], radius = 0.1 }}");
    let cloud = load_text(&hidden, 5_000).unwrap().cloud;
    let block = shape(BLOCK, 5_000);
    assert!((area(&cloud) / area(&block) - 1.0).abs() < 1e-6);
}

/// Values of every kind, in and out of range.
fn value() -> impl Strategy<Value = String> {
    let number = prop_oneof![
        any::<f64>().prop_map(|x| format!("{x:?}").replace("NaN", "nan")),
        any::<i64>().prop_map(|x| x.to_string()),
        (-3i32..4).prop_map(|x| x.to_string()),
        (0.0..1.0f64).prop_map(|x| format!("{x:?}")),
    ];
    let other = prop_oneof![
        Just("true".to_string()),
        Just("\"top\"".to_string()),
        Just("[\"top\"]".to_string()),
        Just("{}".to_string()),
        Just("1979-05-27".to_string()),
    ];
    let vector = prop::collection::vec(number.clone(), 0..5);
    let triple = prop::collection::vec(number.clone(), 3..4);
    let list = |v: Vec<String>| format!("[{}]", v.join(", "));
    prop_oneof![
        3 => number,
        1 => vector.prop_map(list),
        4 => triple.prop_map(list),
        1 => other,
    ]
}

/// A scene file with some of its values replaced.
fn distorted() -> impl Strategy<Value = String> {
    let lines = [
        ("points", "40"),
        ("sky", "0.5"),
        ("tolerance", "0.1"),
        ("[camera]\nposition", "[0, 0, 9]"),
        ("look_at", "[0, 0, 0]"),
        ("fov", "50"),
        ("[[light]]\nposition", "[0, 0, 9]"),
        ("intensity", "1"),
        ("[[shape]]\nreflectance", "0.5"),
        ("emission", "1"),
        ("quad.corner", "[0, 0, 0]"),
        ("quad.u", "[1, 0, 0]"),
        ("quad.v", "[0, 1, 0]"),
        ("quad.hole.u", "[0.1, 0.2]"),
        ("quad.hole.v", "[0.1, 0.2]"),
        ("[[shape]]\nbox.centre", "[0, 0, 1]"),
        ("box.size", "[1, 1, 1]"),
        ("box.rotate", "[0, 40, 0]"),
        ("[[shape]]\nsphere.centre", "[0, 0, 1.5]"),
        ("sphere.radius", "1"),
        ("sphere.bumps", "0.3"),
        ("[[shape]]\ncave.start", "[0, 0, -1]"),
        ("cave.radius", "1"),
        ("cave.length", "4"),
        ("cave.columns", "2"),
    ];
    let at = prop::sample::select((0..lines.len()).collect::<Vec<_>>());
    prop::collection::vec((at, value()), 0..3).prop_map(move |changes| {
        let mut values = lines.map(|(_, v)| v.to_string());
        for (i, value) in changes {
            values[i] = value;
        }
        let text = lines.iter().zip(&values);
        text.map(|((key, _), value)| format!("{key} = {value}\n"))
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_scene_file_breaks_the_loader(text in prop_oneof![4 => distorted(), 1 => "\\PC{0,200}"]) {
        match load_text(&text, 60) {
            Ok(scene) => {
                let cloud = &scene.cloud;
                prop_assert!(!cloud.is_empty() && cloud.len() <= 60);
                prop_assert!(cloud.positions.iter().all(|p| p.is_finite()));
                prop_assert!(cloud.normals.iter().all(|n| n.is_normalized()));
                prop_assert!(cloud.areas.iter().all(|&a| a > 0.0 && a.is_finite()));
                prop_assert!(cloud.emission.iter().all(|e| e.is_finite()));
            }
            Err(error) => prop_assert!(error.to_string().contains("scene.toml")),
        }
    }
}
