//! A real cave, 43,810 points, with eight point lights along it. Runs where the scan is present:
//! in the folder of FMMGI_SCANS, or in ../shared/scans.

mod common;

use std::path::PathBuf;
use std::time::Instant;

use fmmgi_gpu::links::{self, Accuracy, Links};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Fields, Fmm, GpuFmm, TransportOperator, exact_irradiance};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{Backend, Method, Occlusion, Options, Scene, Surfels, illuminate, lights, scan};
use glam::{DVec3, Vec3};

/// The scan with its lights, or `None` with a word where it is not present.
fn cave() -> Option<Scene> {
    let folder = std::env::var_os("FMMGI_SCANS").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/scans")),
        PathBuf::from,
    );
    let path = folder.join("cave_banba.ply");
    if !path.exists() {
        println!("NOT RUN: {} is not present", path.display());
        return None;
    }
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
        rays: None,
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
