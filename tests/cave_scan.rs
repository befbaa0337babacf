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
use fmmgi_gpu::visibility::{BySegment, CpuVisibility, Occluders, PointVisibility, face};
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
        rays: None,
        below_model: false,
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

/// Height above the mesh, in spacings, at which segments against it start and end.
const LIFT: f64 = 0.05;

/// How often the cells are wrong about segments that the mesh leaves open, and about those it blocks.
#[derive(Default)]
struct Judged {
    visible: u32,
    falsely_occluded: u32,
    hidden: u32,
    leaked: u32,
}

impl Judged {
    fn count(&mut self, blocked: bool, seen: bool) {
        if blocked {
            self.hidden += 1;
            self.leaked += u32::from(seen);
        } else {
            self.visible += 1;
            self.falsely_occluded += u32::from(!seen);
        }
    }

    /// False occlusion and leak, as shares of what is visible and what is hidden.
    fn shares(&self) -> [f64; 2] {
        [
            f64::from(self.falsely_occluded) / f64::from(self.visible),
            f64::from(self.leaked) / f64::from(self.hidden),
        ]
    }
}

// Who sees whom, between points and from lamps, against the scan's own mesh. Measured: 1.3% false
// occlusion and 1.9% leak between points, 1.1% and 1.4% from lamps, whose light is off by 2.7%. With
// lifts of 0.02 and 0.1: 1.2% and 2.6%, 1.7% and 1.1%; light 2.8%.
#[test]
fn cells_see_what_the_mesh_sees() {
    let (Some(path), Some(scene)) = (scan_file(), cave()) else {
        return;
    };
    let mesh = Mesh::read(&path);
    let surfels = Surfels::prepare(&scene.cloud, &Silent).unwrap().surfels;
    let occluders = Occluders::build(&surfels);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let n = surfels.len();
    let lift = LIFT * (mesh.area() / n as f64).sqrt();
    let at = |i: usize| surfels.positions[i].as_dvec3() + surfels.origin;
    let normal = |i: usize| surfels.normals[i].as_dvec3();
    let above = |i: usize| at(i) + normal(i) * lift;

    let mut rng = common::random(1);
    let pairs: Vec<[u32; 2]> = std::iter::repeat_with(|| [(); 2].map(|()| rng.random_range(0..n)))
        .filter(|&[i, j]| face(&surfels, i, j))
        .take(100_000)
        .map(|pair| pair.map(|i| i as u32))
        .collect();
    let tested = BySegment {
        surfels: &surfels,
        visibility: &visibility,
    };
    let mut between = Judged::default();
    for (&[i, j], seen) in pairs.iter().zip(tested.visible(&pairs).unwrap()) {
        between.count(mesh.blocks(above(i as usize), above(j as usize)), seen);
    }

    let mut from_lamps = Judged::default();
    let mut light = Vec::new();
    for lamp in &scene.lights {
        let lamps = std::slice::from_ref(lamp);
        let found = lights::point_lights(&surfels, lamps, &visibility, &Silent).unwrap();
        for (i, &found) in found.irradiance.iter().enumerate() {
            let way = lamp.position - at(i);
            let height = normal(i).dot(way);
            if height <= 0.0 {
                continue;
            }
            let blocked = mesh.blocks(above(i), lamp.position);
            from_lamps.count(blocked, found != DVec3::ZERO);
            let open = lamp.intensity.as_dvec3() * (height / way.length().powi(3));
            light.push((found, if blocked { DVec3::ZERO } else { open }));
        }
    }
    let light = relative_l2(light.into_iter());
    for (name, judged) in [("points", &between), ("lamps", &from_lamps)] {
        let [occluded, leaked] = judged.shares();
        println!("cave, {name}: false occlusion {occluded:.4}, leak {leaked:.4}");
        assert!(occluded <= 0.02 && leaked <= 0.06);
    }
    println!("cave, light of the lamps: relative L2 {light:.4}");
    assert!(light <= 0.03);
}
