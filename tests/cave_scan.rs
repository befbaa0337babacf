//! A real cave, 43,810 points, with eight point lights along it. Runs where the scan is present:
//! in the folder of FMMGI_SCANS, or in ../shared/scans.

mod common;
mod mesh;

use std::path::PathBuf;
use std::time::Instant;

use fmmgi_gpu::links::{self, Accuracy, Links};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Fields, Fmm, GpuFmm, TransportOperator, exact_irradiance};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders, Segment, Visibility, face};
use fmmgi_gpu::{Backend, Method, Occlusion, Options, Scene, Surfels, illuminate, lights, scan};
use glam::{DVec3, Vec3};
use mesh::Mesh;
use rand::RngExt;

/// The scan's file, or `None` with a word where it is not present.
fn scan_file() -> Option<PathBuf> {
    let folder = std::env::var_os("FMMGI_SCANS").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/scans")),
        PathBuf::from,
    );
    let path = folder.join("cave_banba.ply");
    if !path.exists() {
        println!("NOT RUN: {} is not present", path.display());
        return None;
    }
    Some(path)
}

/// The scan with its lights.
fn cave() -> Option<Scene> {
    let path = scan_file()?;
    let places = [
        [2.18, -2.37, -17.51],
        [0.06, -0.90, -4.50],
        [-1.90, 1.07, 8.52],
        [-2.04, 1.91, 21.52],
        [-4.22, 4.05, 34.57],
        [-7.47, 6.15, 47.49],
        [-12.04, 7.50, 60.52],
        [-7.58, 8.21, 73.50],
    ];
    Some(Scene {
        cloud: scan::read(&path, &Silent).unwrap(),
        lights: places
            .map(|position| PointLight {
                position: position.into(),
                intensity: Vec3::splat(50.0),
            })
            .to_vec(),
        ..Scene::default()
    })
}

fn relative_l2(pairs: impl Iterator<Item = (DVec3, DVec3)>) -> f64 {
    let (error, norm) = pairs.fold((0.0, 0.0), |(e, n), (a, b)| {
        (e + a.distance_squared(b), n + b.length_squared())
    });
    (error / norm).sqrt()
}

/// The light that the links bring, against exact sums over all points with exact visibility, on
/// 300 receivers.
#[test]
fn links_agree_with_exact_sums() {
    let Some(scene) = cave() else { return };
    let options = Options {
        method: Method::Fmm,
        occlusion: Occlusion::Surfels,
        tolerance: None,
        order: None,
        max_bounces: None,
        seed: 0,
    };
    let began = Instant::now();
    let result = illuminate(&scene, &options, Backend::Cpu, &Silent).unwrap();
    let seconds = began.elapsed().as_secs_f64();
    assert!(result.stats.converged);

    let surfels = &result.surfels;
    let occluders = Occluders::build(surfels);
    let exact = CpuVisibility::<f64>::new(&occluders);
    let lamps = lights::point_lights(surfels, &scene.lights, &exact, &Silent).unwrap();
    let map = &result.map;
    let at = |k: usize| surfels.points[k] as usize;
    let reflected: Vec<DVec3> = (0..surfels.len())
        .map(|k| (map.irradiance[at(k)] * scene.cloud.reflectance[at(k)]).as_dvec3())
        .collect();
    let n = surfels.len();
    let receivers: Vec<usize> = (0..300).map(|r| r * n / 300 + n / 600).collect();
    let sums = exact_irradiance(surfels, &exact, &receivers, &reflected).unwrap();
    let total = |&k: &usize| map.irradiance[at(k)].as_dvec3();
    let operator = relative_l2(
        receivers
            .iter()
            .zip(&sums)
            .map(|(k, (sum, _))| (total(k) - lamps.irradiance[*k], *sum)),
    );
    let all = relative_l2(
        receivers
            .iter()
            .zip(&sums)
            .map(|(k, (sum, _))| (total(k), *sum + lamps.irradiance[*k])),
    );
    println!(
        "cave: {seconds:.1} s, {} segments; relative L2 against exact sums on 300 receivers: \
         {operator:.4} of what the links bring, {all:.4} of the total",
        result.stats.segments
    );
    assert!(operator < 0.06 && all < 0.05);
}

/// The same links, applied bounce after bounce, give the same light on the device.
#[test]
fn the_device_gives_the_same_light() {
    let Some(scene) = cave() else { return };
    let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
    let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
    let occluders = Occluders::build(&surfels);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let lamps = lights::point_lights(&surfels, &scene.lights, &visibility, &Silent).unwrap();
    let mean = lamps
        .irradiance
        .iter()
        .map(|h| h.element_sum() / 3.0)
        .sum::<f64>()
        / surfels.len() as f64;
    let facets = octree.facets.len();
    let accuracy = Accuracy {
        order: 1,
        error: (0.05 * mean) as f32,
        radiosity: vec![mean as f32; facets],
        target_factor: vec![1.0; facets],
        seed: 0,
    };
    let links = links::build(&surfels, &octree, &accuracy, &visibility, &Silent).unwrap();
    let gpu = common::gpu();
    let on_cpu = bounces(
        &Fmm::<f32>::new(&surfels, &octree, &links),
        &surfels,
        &lamps.irradiance,
    );
    let device = GpuFmm::new(gpu, &surfels, &octree, &links).unwrap();
    let on_device = bounces(&device, &surfels, &lamps.irradiance);
    let difference = relative_l2(on_device.into_iter().zip(on_cpu));
    println!(
        "cave, {}: device against CPU {difference:.1e}",
        count(&links)
    );
    assert!(difference < 1e-4);
}

fn count(links: &Links) -> String {
    let counts = links.counts().map(|(kind, n)| format!("{n} {kind}"));
    counts.join(", ")
}

/// Irradiance after five bounces.
fn bounces<O: TransportOperator>(operator: &O, surfels: &Surfels, lamps: &[DVec3]) -> Vec<DVec3> {
    let fields = operator.fields();
    let reflectance: Vec<DVec3> = surfels.reflectance.iter().map(|r| r.as_dvec3()).collect();
    let reflectance = fields.upload(&reflectance).unwrap();
    let lamps = fields.upload(lamps).unwrap();
    let mut irradiance = fields.copy(&lamps).unwrap();
    for _ in 0..5 {
        fields.multiply(&reflectance, &mut irradiance).unwrap();
        irradiance = operator.apply(&irradiance).unwrap();
        fields.axpy(1.0, &lamps, &mut irradiance).unwrap();
    }
    fields.download(&irradiance).unwrap()
}

/// Who sees whom, between points and from lamps, against the scan's own mesh. Segments against the
/// mesh start and end on its vertices, lifted by `LIFT`.
#[test]
fn cells_see_what_the_mesh_sees() {
    let (Some(path), Some(scene)) = (scan_file(), cave()) else {
        return;
    };
    let mesh = Mesh::read(&path);
    let surfels = Surfels::prepare(&scene.cloud, &Silent).unwrap().surfels;
    let spacing = (mesh.area() / surfels.len() as f64).sqrt();
    let area: f64 = surfels.areas.iter().map(|&a| f64::from(a)).sum();
    println!(
        "mesh {:.0} m2, cells {area:.0} m2, spacing {spacing:.3} m, scale {}",
        mesh.area(),
        surfels.occluder_scale
    );
    let occluders = Occluders::build(&surfels);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let n = surfels.len();
    let mut rng = common::random(1);
    let pairs: Vec<(usize, usize)> =
        std::iter::repeat_with(|| (rng.random_range(0..n), rng.random_range(0..n)))
            .filter(|&(i, j)| face(&surfels, i, j))
            .take(200_000)
            .collect();
    let segments: Vec<Segment> = pairs.iter().map(|&(i, j)| surfels.segment(i, j)).collect();
    let seen = visibility.visible(&segments).unwrap();
    let lamps: Vec<Vec<f64>> = scene
        .lights
        .iter()
        .map(|l| {
            lights::point_lights(&surfels, std::slice::from_ref(l), &visibility, &Silent)
                .unwrap()
                .irradiance
                .iter()
                .map(|h| h.x)
                .collect()
        })
        .collect();
    for lift in [0.0, 0.02, 0.05, 0.1, 0.2] {
        let above = |i: usize| {
            surfels.positions[i].as_dvec3()
                + surfels.origin
                + surfels.normals[i].as_dvec3() * (lift * spacing)
        };
        let (mut visible, mut occluded, mut hidden, mut leaked) = (0, 0, 0, 0);
        for (&(i, j), &seen) in pairs.iter().zip(&seen) {
            if mesh.blocks(above(i), above(j)) {
                hidden += 1;
                leaked += i32::from(seen);
            } else {
                visible += 1;
                occluded += i32::from(!seen);
            }
        }
        let (mut e, mut t, mut a, mut b) = (0.0, 0.0, 0.0, 0.0);
        let (mut lv, mut lo, mut lh, mut ll) = (0, 0, 0, 0);
        for (lamp, found) in scene.lights.iter().zip(&lamps) {
            for i in 0..n {
                let way = lamp.position - surfels.positions[i].as_dvec3() - surfels.origin;
                let cos = way.dot(surfels.normals[i].as_dvec3());
                if cos <= 0.0 {
                    continue;
                }
                let blocked = mesh.blocks(above(i), lamp.position);
                let truth = if blocked {
                    0.0
                } else {
                    50.0 * cos / way.length().powi(3)
                };
                let seen = found[i] > 0.0;
                if blocked {
                    lh += 1;
                    ll += i32::from(seen)
                } else {
                    lv += 1;
                    lo += i32::from(!seen)
                }
                e += (found[i] - truth).powi(2);
                t += truth * truth;
                a += found[i];
                b += truth;
            }
        }
        let share = |a: i32, b: i32| f64::from(a) / f64::from(b);
        println!(
            "lift {lift}: {visible} visible, {hidden} hidden; false occlusion {:.4}, leak {:.4}; lamps: false occlusion {:.4}, leak {:.4}, rel L2 {:.4}, bias {:+.4}",
            share(occluded, visible),
            share(leaked, hidden),
            share(lo, lv),
            share(ll, lh),
            (e / t).sqrt(),
            a / b - 1.0
        );
    }
}
