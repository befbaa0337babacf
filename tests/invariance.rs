//! What must not matter: the order of the points, where the scan lies, how it is turned, its unit,
//! that of light, and running the program twice.

use std::path::Path;

use fmmgi_gpu::compare::compare;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::{Backend, Method, Occlusion, Options, Scene, illuminate};
use glam::{DMat3, DVec3, Vec3};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64Mcg;

/// A furnished room whose areas and cells come from the points alone.
fn scene(points: usize) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/organic.toml");
    let options = SceneOptions {
        points: Some(points),
        seed: 3,
        ..SceneOptions::default()
    };
    let mut scene = Scene::load(&path, &options, &Silent).unwrap();
    scene.cloud.areas.clear();
    scene.lights.push(PointLight {
        position: DVec3::new(0.2, 0.8, 0.3),
        intensity: Vec3::new(0.3, 0.5, 0.4),
    });
    scene
}

fn irradiance(scene: &Scene, method: Method) -> Vec<Vec3> {
    solve(scene, method, Occlusion::Surfels)
}

fn solve(scene: &Scene, method: Method, occlusion: Occlusion) -> Vec<Vec3> {
    let options = Options {
        method,
        occlusion,
        seed: 1,
        // Their number must not hang on rounding.
        rays: (method == Method::Gather).then_some(128),
        ..Options::default()
    };
    let result = illuminate(scene, &options, Backend::Cpu, &Silent).unwrap();
    result.map.irradiance
}

/// The scene with its places changed by `p -> scale * (turn * p) + shift`.
fn moved(scene: &Scene, turn: DMat3, scale: f64, shift: DVec3) -> Scene {
    let mut moved = scene.clone();
    let place = |p: DVec3| turn * p * scale + shift;
    for p in &mut moved.cloud.positions {
        *p = place(*p);
    }
    for n in &mut moved.cloud.normals {
        *n = (turn * n.as_dvec3()).as_vec3();
    }
    for light in &mut moved.lights {
        light.position = place(light.position);
        light.intensity *= (scale * scale) as f32;
    }
    moved
}

/// Relative L2 difference that each change makes, for a method.
fn differences(method: Method, occlusion: Occlusion, points: usize) -> Vec<(&'static str, f64)> {
    let irradiance = |scene: &Scene, method| solve(scene, method, occlusion);
    let scene = scene(points);
    let still = irradiance(&scene, method);
    let against = |other: &[Vec3]| compare(other, &still).unwrap().rel_l2;
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
    let change =
        |turn, scale, shift| against(&irradiance(&moved(&scene, turn, scale, shift), method));
    let id = DMat3::IDENTITY;

    let mut order: Vec<usize> = (0..scene.cloud.len()).collect();
    order.shuffle(&mut Pcg64Mcg::seed_from_u64(9));
    let mut shuffled = scene.clone();
    let cloud = &mut shuffled.cloud;
    cloud.positions = order.iter().map(|&i| scene.cloud.positions[i]).collect();
    cloud.normals = order.iter().map(|&i| scene.cloud.normals[i]).collect();
    cloud.reflectance = order.iter().map(|&i| scene.cloud.reflectance[i]).collect();
    cloud.emission = order.iter().map(|&i| scene.cloud.emission[i]).collect();
    let mut back = vec![Vec3::ZERO; order.len()];
    for (&i, h) in order.iter().zip(irradiance(&shuffled, method)) {
        back[i] = h;
    }
    let found = vec![
        ("order", against(&back)),
        (
            "translation",
            change(id, 1.0, DVec3::new(244_398.864, 6_010_935.736, 18.145)),
        ),
        ("rotation", change(turn, 1.0, DVec3::ZERO)),
        ("scale 1e-4", change(id, 1e-4, DVec3::ZERO)),
        ("scale 1e5", change(id, 1e5, DVec3::ZERO)),
    ];
    for (what, difference) in &found {
        println!("{method:?}, {occlusion:?}: {what}: {difference:.1e}");
    }
    found
}

/// Positions are kept as f32 relative to the middle of the cloud: 6e-8 of its size, which a near
/// form factor can magnify tenfold; and it may decide a segment that touches the edge of a cell.
/// Measured are 2e-7 where it does not, and 1e-5 to 4e-5 where it does (three clouds).
#[test]
fn exact_sums_change_by_rounding() {
    for (what, difference) in differences(Method::Direct, Occlusion::Surfels, 3000) {
        assert!(difference < 1e-4, "{what}: {difference:.1e}");
    }
}

#[test]
fn links_change_within_the_tolerance() {
    for (what, difference) in differences(Method::Fmm, Occlusion::Surfels, 6000) {
        assert!(difference < 0.03, "{what}: {difference:.1e}");
    }
}

/// Two results of a tolerance of 0.03 differ by √2 as much, if their errors are noise.
const NOISE: f64 = 0.043;

/// In another unit and at another place all rays are the same, but for rounding: a ray that meets
/// another surfel for it is one of 128. In other octrees surfels have other rays.
#[test]
fn rays_change_by_rounding_or_within_the_tolerance() {
    for (what, difference) in differences(Method::Gather, Occlusion::Surfels, 3000) {
        let bound = match what {
            "order" | "rotation" => NOISE,
            _ => 1e-3,
        };
        assert!(difference < bound, "{what}: {difference:.1e}");
    }
}

/// With nothing in the way no segment decides: only a rotation makes other facets and links, and rounding other
/// orders of some. (Measured: 1.0e-5.)
#[test]
fn expansions_do_not_feel_unit_and_place() {
    for (what, difference) in differences(Method::Fmm, Occlusion::None, 20_000) {
        let bound = if what == "rotation" { 0.03 } else { 3e-5 };
        assert!(difference < bound, "{what}: {difference:.1e}");
    }
}

/// A scan in map coordinates with one point at zero, as converters leave it.
#[test]
fn a_stray_far_away_changes_nothing() {
    let clean = moved(
        &scene(3000),
        DMat3::IDENTITY,
        1.0,
        DVec3::new(244_398.8, 6_010_935.7, 18.1),
    );
    let mut stray = clean.clone();
    stray.cloud.positions.push(DVec3::ZERO);
    stray.cloud.normals.push(Vec3::Y);
    stray.cloud.reflectance.push(Vec3::ONE);
    stray.cloud.emission.push(Vec3::ZERO);
    let methods = [
        (Method::Direct, 1e-5),
        (Method::Fmm, 0.03),
        (Method::Gather, NOISE),
    ];
    for (method, bound) in methods {
        let without = irradiance(&clean, method);
        let with = irradiance(&stray, method);
        let difference = compare(&with[..without.len()], &without).unwrap().rel_l2;
        println!("{method:?}: stray: {difference:.1e}");
        assert!(difference < bound);
    }
}

/// Light of a candle or of the sun, in any unit. By powers of two not even rounding changes: what is
/// measured is 0, while squares of these lights leave the range of f32.
#[test]
fn the_unit_of_light_does_not_matter() {
    let scene = scene(3000);
    let expected = irradiance(&scene, Method::Fmm);
    for unit in [-80, 40].map(|power| 2f32.powi(power)) {
        let mut lit = scene.clone();
        lit.lights.iter_mut().for_each(|l| l.intensity *= unit);
        lit.cloud.emission.iter_mut().for_each(|e| *e *= unit);
        lit.sky *= unit;
        let found: Vec<Vec3> = irradiance(&lit, Method::Fmm)
            .iter()
            .map(|h| *h / unit)
            .collect();
        let difference = compare(&found, &expected).unwrap().rel_l2;
        println!("light in units of {unit:e}: {difference:.1e}");
        assert!(difference < 1e-6, "{unit:e}: {difference:e}");
    }
}

#[test]
fn same_input_same_bits() {
    let scene = scene(4000);
    for method in [Method::Direct, Method::Fmm, Method::Gather] {
        let first = irradiance(&scene, method);
        let single = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .unwrap();
        assert_eq!(first, irradiance(&scene, method));
        assert_eq!(first, single.install(|| irradiance(&scene, method)));
    }
}
