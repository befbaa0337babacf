//! Surfaces that are fitted to points without normals, against the true ones.

mod clouds;

use std::f64::consts::{PI, TAU};
use std::path::{Path, PathBuf};

use clouds::*;
use fmmgi_gpu::points::{Evidence, Facing, Prepared, Thinning};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{PointCloud, Scene, Surfels, scan};
use glam::{DQuat, DVec2, DVec3, Vec3};
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

/// The surface of a cloud whose normals and areas are not known.
fn fitted(cloud: &PointCloud, evidence: &Evidence) -> Prepared {
    let mut bare = cloud.clone();
    bare.normals.clear();
    bare.areas.clear();
    Surfels::of_scan(&bare, evidence, &Thinning::default(), &Silent).unwrap()
}

fn facing(facing: Facing) -> Evidence {
    Evidence {
        facing,
        ..Evidence::default()
    }
}

/// Angles in degrees to the true normals, whatever the sign, the share of wrong signs, and the error of
/// the area.
fn measured(cloud: &PointCloud, area: f64, told: Facing) -> Found {
    let Prepared { surfels, .. } = fitted(cloud, &facing(told));
    let truth = |k: usize| cloud.normals[surfels.points[k] as usize].as_dvec3();
    let cosines: Vec<f64> = (0..surfels.len())
        .filter(|&k| surfels.back(k).is_none())
        .map(|k| surfels.normals[k].as_dvec3().dot(truth(k).normalize()))
        .collect();
    let mut angles: Vec<f64> = cosines
        .iter()
        .map(|c| c.abs().min(1.0).acos().to_degrees())
        .collect();
    angles.sort_by(f64::total_cmp);
    let wrong = cosines.iter().filter(|c| **c < 0.0).count();
    let n = angles.len();
    // Of two sides at one place one is enough.
    let areas = (0..surfels.len())
        .filter(|&k| surfels.back(k).is_none_or(|back| k < back))
        .map(|k| f64::from(surfels.areas[k]));
    Found {
        median: angles[n / 2],
        p95: angles[n * 95 / 100],
        wrong: wrong as f64 / n as f64,
        area: areas.sum::<f64>() / area - 1.0,
    }
}

impl Found {
    fn print(&self, what: &str) {
        println!(
            "{what:28}: median {:5.2} p95 {:6.2} degrees, wrong signs {:6.3}%, area {:+.1}%",
            self.median,
            self.p95,
            100.0 * self.wrong,
            100.0 * self.area
        );
    }
}

/// Medians in degrees of noise 0, 0.1 and 0.5 spacings. By theory a plane through k points of noise σ at
/// spacing s tilts by σ/s 2√π / k: a footprint has 4π points, which weights make about half of.
const MEDIANS: [(f64, f64); 3] = [(0.0, 0.5), (0.1, 3.4), (0.5, 7.0)];

#[test]
fn noise_tilts_normals_no_more_than_it_must() {
    let mut failed = Vec::new();
    for Shape {
        name,
        cloud,
        area,
        facing,
    } in shapes()
        .into_iter()
        .filter(|shape| ["sphere", "box"].contains(&shape.name))
    {
        let spacing = (area / cloud.len() as f64).sqrt();
        for (noise, median) in MEDIANS {
            let found = measured(&shaken(&cloud, noise * spacing, 5), area, facing);
            found.print(&format!("{name}, noise {noise}"));
            // Noise of half a spacing leaves single surfels aside, and edges round.
            let [wrong, off] = if noise < 0.5 {
                [0.005, 0.05]
            } else {
                [0.02, 0.12]
            };
            let fits = found.median < median && found.wrong < wrong && found.area.abs() < off;
            if !fits {
                failed.push(format!("{name}, noise {noise}"));
            }
        }
    }
    assert!(failed.is_empty(), "{failed:?}");
}

/// The part of the cloud for which this holds.
fn part(cloud: &PointCloud, keep: impl Fn(usize) -> bool) -> PointCloud {
    let order: Vec<usize> = (0..cloud.len()).filter(|&i| keep(i)).collect();
    permuted(cloud, &order)
}

// points, 7% on the sphere and 10% on the box.
#[test]
fn density_may_jump() {
    for ratio in [10.0, 100.0] {
        let mut rng = random(1);
        let mut keep = |sparse: bool| !sparse || rng.random_range(0.0..ratio) < 1.0;
        let whole = sphere(60_000, 1.0, false, 1);
        let kept: Vec<bool> = whole.positions.iter().map(|p| keep(p.z < 0.3)).collect();
        let ball = part(&whole, |i| kept[i]);
        let whole = cube(100, 1.0, false, 1);
        let kept: Vec<bool> = whole
            .positions
            .iter()
            .map(|p| keep(p.x + p.y < 0.9))
            .collect();
        let cube = part(&whole, |i| kept[i]);
        for (name, cloud, area) in [("sphere", ball, 4.0 * PI), ("box", cube, 6.0)] {
            let found = measured(&cloud, area, Facing::Outward);
            found.print(&format!("{name}, density 1:{ratio}"));
            assert!(found.median < 1.1 && found.p95 < 12.0);
            assert!(
                found.wrong < 0.003 && found.area.abs() < if ratio < 50.0 { 0.06 } else { 0.18 }
            );
        }
    }
}

#[test]
fn holes_and_strays_change_little() {
    let mut rng = random(3);
    let whole = sphere(20_000, 1.0, false, 1);
    let holes: Vec<DVec3> = (0..6).map(|_| direction(&mut rng)).collect();
    let holed = part(&whole, |i| {
        holes.iter().all(|h| h.distance(whole.positions[i]) > 0.3)
    });
    let area = 4.0 * PI * holed.len() as f64 / whole.len() as f64;
    let found = measured(&holed, area, Facing::Outward);
    found.print("sphere with holes");
    // The point that stands for a surfel may be a part of a spacing, 1.4 degrees, aside.
    assert!(found.median < 0.8 && found.wrong == 0.0 && found.area.abs() < 0.02);

    for (name, clean, area) in [
        ("sphere", whole, 4.0 * PI),
        ("box", cube(58, 1.0, false, 1), 6.0),
    ] {
        let n = clean.len();
        let mut cloud = clean.clone();
        for _ in 0..n / 100 {
            let place = DVec3::new(rng.random(), rng.random(), rng.random()) * 3.0 - 1.0;
            cloud.positions.push(place);
            cloud.normals.push(Vec3::Z);
            cloud.reflectance.push(Vec3::splat(0.5));
            cloud.emission.push(Vec3::ZERO);
        }
        let prepared = fitted(&cloud, &facing(Facing::Outward));
        let surfels = &prepared.surfels;
        let stands = |i: usize| {
            let surfel = prepared.surfel_of_point[i].unwrap() as usize;
            surfels.stands_for(surfel, cloud.positions[i])
        };
        let lost = (0..n).filter(|&i| !stands(i)).count() as f64 / n as f64;
        let is_stray = |k: &usize| surfels.points[*k] as usize >= n;
        let strays = (0..surfels.len()).filter(is_stray).count();
        let left = strays as f64 / (n / 100) as f64;
        let sum: f64 = surfels.areas.iter().map(|&a| f64::from(a)).sum();
        let off = |&k: &usize| surfels.normals[k].dot(cloud.normals[surfels.points[k] as usize]);
        let of_surface = (0..surfels.len()).filter(|k| !is_stray(k));
        let wrong = of_surface.filter(|k| off(k) < 0.5).count() as f64 / surfels.len() as f64;
        println!(
            "{name} with 1% strays: {:.1}% of them left, {:.3}% of the surface lost, area {:+.1}%, {:.3}% \
             of the normals off by more than 60 degrees",
            100.0 * left,
            100.0 * lost,
            100.0 * (sum / area - 1.0),
            100.0 * wrong
        );
        assert!(left < 0.15 && lost < 0.002);
        // Those that are left take too much: measured +89% on the sphere, +120% on the box.
        // A point on an edge of the box may be of either face.
        assert!(sum / area < 2.4 && wrong < 0.01);
    }
}

/// Without a word the outside of an object is found, and the inside of a room with boxes in it; told,
/// or seen from a place, normals point there.
#[test]
fn the_lit_side_is_found() {
    let bare = |mut cloud: PointCloud| {
        take_area(&mut cloud);
        cloud
    };
    for (name, cloud) in [
        ("sphere", sphere(4000, 1.0, false, 1)),
        ("torus", torus(6000, 1)),
        ("room with boxes", bare(built_in("cornell", 10_000))),
    ] {
        let wrong = measured(&cloud, 1.0, Facing::Auto).wrong;
        println!("{name}: {:.3}% wrong", 100.0 * wrong);
        assert!(wrong < 0.002, "{name}");
    }
    let inside = sphere(4000, 1.0, true, 1);
    for facing in [Facing::Inward, Facing::Viewpoint(DVec3::new(0.5, 0.2, 0.1))] {
        assert_eq!(measured(&inside, 1.0, facing).wrong, 0.0);
    }
    let lit = Evidence {
        lamps: vec![DVec3::new(-0.3, 0.4, 0.2)],
        ..Evidence::default()
    };
    let Prepared { surfels, .. } = fitted(&inside, &lit);
    let agrees =
        |k: usize| surfels.normals[k].dot(inside.normals[surfels.points[k] as usize]) > 0.9;
    assert!((0..surfels.len()).all(agrees));
    let floor = quad(DVec3::ZERO, DVec3::X, DVec3::Y, 30, 0.8, 1);
    assert_eq!(measured(&floor, 1.0, Facing::Auto).wrong, 0.0);
    let below = Facing::Viewpoint(DVec3::new(0.4, 0.4, -2.0));
    assert_eq!(measured(&floor, 1.0, below).wrong, 1.0);
}

/// The few points that have normals tell which side is lit.
#[test]
fn given_normals_tell_the_side() {
    for inside in [true, false] {
        let whole = sphere(4000, 1.0, inside, 1);
        let mut some = whole.clone();
        let most = some.normals.iter_mut().skip(100);
        most.for_each(|n| *n = Vec3::ZERO);
        let (evidence, thinning) = (Evidence::default(), Thinning::default());
        let Prepared { surfels, .. } =
            Surfels::of_scan(&some, &evidence, &thinning, &Silent).unwrap();
        let agrees =
            |k: usize| surfels.normals[k].dot(whole.normals[surfels.points[k] as usize]) > 0.95;
        assert!((0..surfels.len()).all(agrees));
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let cloud = shaken(&cube(30, 1.0, false, 1), 0.01, 1);
    let found = || {
        let Prepared { surfels, .. } = fitted(&cloud, &Evidence::default());
        (surfels.positions, surfels.normals, surfels.areas)
    };
    let single = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    assert_eq!(found(), single.install(found));
}

/// Lines, points at one place, a single point: no panic, no normal that is none.
#[test]
fn odd_clouds_have_a_surface_or_none() {
    let line = |k: usize| DVec3::X * k as f64;
    for places in [
        vec![],
        vec![DVec3::ONE],
        vec![DVec3::ONE; 50],
        vec![DVec3::ZERO, DVec3::ONE],
        (0..100).map(line).collect(),
        (0..100)
            .map(|k| DVec3::splat(f64::NAN) * k as f64)
            .collect(),
    ] {
        let mut cloud = cloud(places.into_iter().map(|p| (p, DVec3::ZERO)));
        cloud.normals.clear();
        let (evidence, thinning) = (Evidence::default(), Thinning::default());
        if let Ok(found) = Surfels::of_scan(&cloud, &evidence, &thinning, &Silent) {
            assert!(found.surfels.normals.iter().all(|n| n.is_normalized()));
        }
    }
}

/// Against normals that scans bring along: those of the cave come from a mesh, oni's from its makers;
/// the lion's have 8 bits and lie 7 degrees off the planes of their neighbours.
#[test]
fn normals_of_scans_are_found_again() {
    let folder = std::env::var_os("FMMGI_SCANS").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scans"),
        PathBuf::from,
    );
    for (name, facing, median, wrong) in [
        ("cave_banba.ply", Facing::Inward, 12.0, 0.02),
        ("lion_statue_normals.ply", Facing::Outward, 11.0, 0.35),
        ("oni.xyz", Facing::Auto, 20.0, 0.15),
    ] {
        let path = folder.join(name);
        if !path.exists() {
            println!("NOT RUN: {} is not present", path.display());
            continue;
        }
        let cloud = scan::read(&path, &Silent).unwrap();
        let found = measured(&cloud, 1.0, facing);
        found.print(name);
        assert!(found.median < median && found.wrong < wrong);
    }
}

/// Normals that a file has stay as they are, but for those of the wrong side altogether.
#[test]
fn given_normals_are_turned_as_told() {
    let given = torus(2000, 3);
    let outward = given.normals.clone();
    let inward: Vec<Vec3> = outward.iter().map(|n| -*n).collect();
    let turned = |normals: &[Vec3], told: Facing| {
        let mut cloud = PointCloud {
            normals: normals.to_vec(),
            ..given.clone()
        };
        cloud.repairs.clear();
        let thinning = Thinning::default();
        let found = Surfels::of_scan(&cloud, &facing(told), &thinning, &Silent).unwrap();
        (found.surfels.normals, found.repairs.len())
    };
    let close = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).all(|(a, b)| a.dot(*b) > 0.9);
    for (facing, told) in [(Facing::Inward, &inward), (Facing::Outward, &outward)] {
        let [same, other] = [&outward, &inward].map(|normals| turned(normals, facing));
        assert!(close(&same.0, told) && close(&other.0, told));
        assert_eq!(same.1 + other.1, 1);
    }
    for facing in [Facing::Auto, Facing::Viewpoint(DVec3::ZERO)] {
        let (normals, repairs) = turned(&inward, facing);
        assert!(close(&normals, &inward) && repairs == 0);
    }
}

/// The lower three fifths of a pipe that scanners below it see, in a room, with points as far apart as most of its
/// radius.
fn pipe(radius: f64, spacing: f64, noise: f64) -> PointCloud {
    let mut rng = random(7);
    let n = (0.6 * TAU * radius * 3.0 / (spacing * spacing)) as usize;
    let of_pipe = (0..n).map(|_| {
        let angle = PI * (1.5 + rng.random_range(-0.6..0.6));
        let normal = DVec3::new(0.0, angle.cos(), angle.sin());
        let off = noise * rng.random_range(-1.7..1.7);
        let place = DVec3::new(rng.random_range(0.0..3.0), 1.5, 2.4);
        (place + normal * (radius + off), normal)
    });
    let pipe = cloud(of_pipe.collect::<Vec<_>>());
    let room = cube((3.0 / spacing) as usize, 0.7, true, 3);
    joined([pipe, moved(&room, DQuat::IDENTITY, 3.0, DVec3::ZERO)])
}

/// A plane through the same few points would be off by 20 degrees and more.
#[test]
fn pipes_with_points_as_far_apart_as_their_radius_are_round() {
    let radius = 0.07;
    let lamp = Evidence {
        lamps: vec![DVec3::new(1.5, 1.0, 1.0)],
        ..Evidence::default()
    };
    // Measured with noise: 5.3 and 32 degrees.
    for (noise, median, p90) in [(0.0, 0.5, 5.0), (0.003, 7.0, 40.0)] {
        let cloud = pipe(radius, 0.05, noise);
        let surfels = fitted(&cloud, &lamp).surfels;
        let of_pipe = (0.6 * TAU * radius * 3.0 / 0.0025) as u32;
        let on_pipe = |k: &usize| surfels.points[*k] < of_pipe;
        let mut angles: Vec<f64> = (0..surfels.len())
            .filter(on_pipe)
            .map(|k| {
                let truth = cloud.normals[surfels.points[k] as usize];
                f64::from(surfels.normals[k].dot(truth).clamp(-1.0, 1.0).acos()).to_degrees()
            })
            .collect();
        angles.sort_by(f64::total_cmp);
        let n = angles.len();
        println!(
            "noise {noise}: {n} surfels, {:.2} and {:.1} degrees",
            angles[n / 2],
            angles[n * 9 / 10]
        );
        assert!(n > 80, "{n} surfels");
        assert!(angles[n / 2] < median && angles[n * 9 / 10] < p90);
    }
}

/// The inside of an edge of two walls: each surfel lies on one of them, and each point has one of its own wall where
/// it is off the other by more than noise.
#[test]
fn walls_go_on_up_to_their_edge() {
    let k = 60;
    let walls = [
        quad(DVec3::ZERO, DVec3::X, DVec3::Y, k, 0.9, 1),
        quad(DVec3::ZERO, DVec3::Y, DVec3::Z, k, 0.9, 2),
    ];
    let mut cloud = joined(walls);
    let mut rng = random(5);
    let noise = 0.0005;
    for i in 0..cloud.len() {
        let off = noise * rng.random_range(-1.7..1.7);
        cloud.positions[i] += off * cloud.normals[i].as_dvec3();
    }
    let Prepared {
        surfels,
        surfel_of_point,
        ..
    } = fitted(&cloud, &facing(Facing::Viewpoint(DVec3::splat(0.5))));
    let own_wall = |i: usize, k: usize| {
        let cos = surfels.normals[k].dot(cloud.normals[i]).abs();
        f64::from(cos.min(1.0).acos()).to_degrees()
    };
    let (mut near, mut wrong, mut tilted) = (0, 0, 0);
    for i in 0..cloud.len() {
        let place = cloud.positions[i];
        let normal = cloud.normals[i].as_dvec3().abs();
        // How far the other wall is.
        let beyond = if normal.z > 0.5 { place.x } else { place.z };
        let Some(k) = surfel_of_point[i].filter(|_| (5.0 * noise..0.05).contains(&beyond)) else {
            continue;
        };
        near += 1;
        wrong += usize::from(own_wall(i, k as usize) > 45.0);
        tilted += usize::from((8.0..82.0).contains(&own_wall(i, k as usize)));
    }
    println!("{near} points by the edge, {wrong} of the other wall, {tilted} of none");
    assert!(near > 200);
    assert!(
        wrong * 50 < near && tilted * 20 < near,
        "{wrong} {tilted} of {near}"
    );
}
