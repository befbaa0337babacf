//! How far a solution is from exact sums over its own radiosity.
#![allow(dead_code)]

use fmmgi_gpu::operator::exact_irradiance;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{Illumination, Scene, lights};
use glam::{DVec3, Vec3, dvec3};

/// Relative L2 errors of the irradiance at some receivers.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    /// Of all light.
    pub total: f64,
    /// Of what does not come straight from point lights.
    pub indirect: f64,
}

/// Errors against exact sums with the cells in the way, of `count` surfels; or of those at `wanted`
/// places alone.
pub fn errors(
    scene: &Scene,
    lit: &Illumination,
    count: usize,
    wanted: impl Fn(DVec3) -> bool,
) -> Errors {
    let surfels = &lit.surfels;
    let occluders = Occluders::build(surfels);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let straight = lights::point_lights(surfels, &scene.lights, &visibility, &Silent)
        .unwrap()
        .irradiance;
    let place = |i: &usize| surfels.positions[*i].as_dvec3() + surfels.origin;
    let all: Vec<usize> = (0..surfels.len()).filter(|i| wanted(place(i))).collect();
    let count = count.min(all.len());
    let receivers: Vec<usize> = (0..count).map(|k| all[k * all.len() / count]).collect();
    let point = |i: usize| surfels.points[i] as usize;
    let radiosity: Vec<DVec3> = (0..surfels.len())
        .map(|i| lit.map.radiosity[point(i)].as_dvec3())
        .collect();
    let exact = exact_irradiance(surfels, &visibility, &receivers, &radiosity).unwrap();
    let [mut off, mut total, mut indirect] = [0.0; 3];
    for (&i, (exact, _)) in receivers.iter().zip(exact) {
        let found = lit.map.irradiance[point(i)].as_dvec3() - straight[i];
        off += found.distance_squared(exact);
        total += (exact + straight[i]).length_squared();
        indirect += exact.length_squared();
    }
    Errors {
        total: (off / total).sqrt(),
        indirect: (off / indirect).sqrt(),
    }
}

/// A shipped scene of which nothing shines but a point lamp.
pub fn lamp(name: &str, points: usize, place: [f64; 3]) -> Scene {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
        ..SceneOptions::default()
    };
    let mut scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    scene.cloud.emission.fill(Vec3::ZERO);
    move_lamp(&mut scene, place);
    scene
}

/// The only lamp, put elsewhere.
pub fn move_lamp(scene: &mut Scene, [x, y, z]: [f64; 3]) {
    scene.lights = vec![PointLight {
        position: dvec3(x, y, z),
        intensity: Vec3::new(1.0, 0.9, 0.8),
    }];
}
