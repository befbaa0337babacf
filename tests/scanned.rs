//! A room as a scanner sees it, lit, against the path-traced room: points from two stations, as dense as 1 / r², with
//! noise, mixed pixels and strays; no normals.

mod tracer;

use fmmgi_gpu::illuminate::surface_error;
use fmmgi_gpu::points::Scanner;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{Backend, Options, PointCloud, Scene, illuminate};
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tracer::{Bounces, Receiver, Room};

/// A closed room with a block on the floor, a board at a wall, as thick as the points there are apart, and a ball.
const ROOM: &str = r#"
[[shape]]
box = { centre = [2, 1.5, 1.25], size = [4, 3, 2.5], inward = true }
reflectance = 0.55
[[shape]]
box = { centre = [1.2, 0.9, 0.4], size = [0.7, 0.6, 0.8] }
reflectance = 0.55
[[shape]]
box = { centre = [2.6, 2.75, 1.2], size = [1.2, 0.5, 0.06] }
reflectance = 0.55
[[shape]]
sphere = { centre = [3.2, 1.0, 0.5], radius = 0.4 }
reflectance = 0.55
[[light]]
position = [2.2, 1.6, 2.0]
intensity = [10, 9, 8]
"#;
const LAMP: [f64; 3] = [2.2, 1.6, 2.0];
const STATIONS: [DVec3; 2] = [DVec3::new(0.5, 2.4, 1.5), DVec3::new(3.5, 0.5, 1.0)];
/// Rays of a station around, and from the zenith to 60 degrees below the horizon.
const AROUND: usize = 320;
const DOWN: usize = 134;

/// A scan, and of each point the normal of the surface that it was measured on; none of strays and mixed pixels.
struct Scan {
    cloud: PointCloud,
    normals: Vec<Option<DVec3>>,
}

/// With noise of so much along the rays, and whether there are points on no surface.
fn scan(room: &Room, noise: f64, dirty: bool, known: bool) -> Scan {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let mut scan = Scan {
        cloud: PointCloud::default(),
        normals: Vec::new(),
    };
    for from in STATIONS {
        let begin = scan.normals.len();
        let mut last: Option<f64> = None;
        for k in 0..AROUND * DOWN {
            let (column, row) = (k / DOWN, k % DOWN);
            let around = std::f64::consts::TAU * (column as f64 + 0.5) / AROUND as f64;
            let down = (150.0 * (row as f64 + 0.5) / DOWN as f64).to_radians();
            let way = DVec3::new(
                down.sin() * around.cos(),
                down.sin() * around.sin(),
                down.cos(),
            );
            let Some((far, normal)) = room.meets(from, way) else {
                continue;
            };
            // Twelve numbers make a normal one, nearly.
            let sum: f64 = (0..12).map(|_| random.random::<f64>()).sum();
            let mut range = far + noise * (sum - 6.0);
            let mut normal = Some(normal);
            // A beam on an edge returns what lies between; a stray is anywhere.
            let jump = last.filter(|last| (last - far).abs() > 0.2);
            if let (true, Some(before)) = (dirty, jump) {
                if random.random::<f64>() < 0.5 {
                    range = far + (before - far) * random.random::<f64>();
                    normal = None;
                }
            } else if dirty && random.random::<f64>() < 1e-3 {
                range = far * random.random_range(0.2..1.0);
                normal = None;
            }
            last = Some(far);
            scan.cloud.positions.push(from + range * way);
            scan.cloud.reflectance.push(Vec3::splat(0.55));
            scan.cloud.emission.push(Vec3::ZERO);
            scan.normals.push(normal);
        }
        if known {
            scan.cloud.scanners.push(Scanner {
                position: from,
                points: begin..scan.normals.len(),
            });
        }
    }
    scan
}

/// Relative L2 of all light and median of the points' errors, at points on a surface, the share of those that are
/// lit on the wrong side, and the bound of the first that is told.
fn errors(room: &Room, scan: Scan) -> [f64; 4] {
    let Scan { cloud, normals } = scan;
    let scene = Scene {
        cloud,
        lights: vec![PointLight {
            position: DVec3::from(LAMP),
            intensity: Vec3::new(10.0, 9.0, 8.0),
        }],
        ..Scene::default()
    };
    let options = Options::default();
    let lit = illuminate(&scene, &options, Backend::Cpu, &Silent).unwrap();
    let told = surface_error(&scene, &options, Backend::Cpu, &lit, &Silent).unwrap();
    let map = lit.map;
    let step = normals.len() / 400;
    let chosen: Vec<(usize, DVec3)> = (0..normals.len())
        .step_by(step)
        .filter_map(|i| Some((i, normals[i]?)))
        .collect();
    // The truth is that of the surface behind the point.
    let receivers: Vec<Receiver> = (chosen.iter())
        .map(|&(i, normal)| Receiver {
            place: room.beside(scene.cloud.positions[i], normal),
            normal,
        })
        .collect();
    let truth = room.irradiance(&receivers, Bounces::All, 4096);
    let (mut square, mut whole) = (0.0, 0.0);
    let mut each = Vec::new();
    for (&(i, _), truth) in chosen.iter().zip(truth) {
        let miss = map.irradiance[i].as_dvec3() - truth.irradiance;
        square += miss.length_squared();
        whole += truth.irradiance.length_squared();
        each.push(miss.length() / truth.irradiance.length());
    }
    each.sort_by(f64::total_cmp);
    let facing =
        (0..normals.len()).filter_map(|i| Some(map.normals[i].as_dvec3().dot(normals[i]?)));
    let (wrong, all) = facing.fold((0.0, 0.0), |(wrong, all), cos| {
        (wrong + f64::from(u8::from(cos < 0.0)), all + 1.0)
    });
    let bound = told.unwrap().bound;
    [
        (square / whole).sqrt(),
        each[each.len() / 2],
        wrong / all,
        bound,
    ]
}

#[test]
fn a_scanned_room_is_lit_as_the_room() {
    let room = Room::read(ROOM);
    for (name, noise, dirty, known, most) in [
        ("exact", 0.0, false, false, [0.06, 0.03, 0.01]),
        ("2 mm of noise", 0.002, false, false, [0.12, 0.04, 0.02]),
        (
            "mixed pixels and strays",
            0.002,
            true,
            false,
            [0.15, 0.05, 0.03],
        ),
        ("with stations", 0.002, true, true, [0.15, 0.05, 0.02]),
    ] {
        let [all, median, wrong, bound] = errors(&room, scan(&room, noise, dirty, known));
        println!(
            "{name:24}: {:.1}% in all (told: up to {:.1}), median {:.1}%, {:.2}% on the wrong side",
            100.0 * all,
            100.0 * bound,
            100.0 * median,
            100.0 * wrong
        );
        assert!(
            all < most[0] && median < most[1] && wrong < most[2],
            "{name}"
        );
        // As far off as is told. Halves of few points are worse than a half: four times as much is told of exact ones.
        assert!(all < bound && bound < 5.0 * all, "{name}: {all} of {bound}");
    }
}
