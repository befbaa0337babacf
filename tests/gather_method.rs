//! The method gather from scene to map: its tolerance, what it says of its error, backends, refusals.

mod clouds;
mod common;

use clouds::{cube, joined, quad};
use common::{gpu, scene};
use fmmgi_gpu::compare::compare;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{Backend, Error, Illumination, Method, Occlusion, Options, Scene, illuminate};
use glam::{DVec3, Vec3};

fn solve(scene: &Scene, options: &Options) -> Illumination {
    let options = Options {
        method: Method::Gather,
        ..options.clone()
    };
    illuminate(scene, &options, Backend::Cpu, &Silent).unwrap()
}

/// The irradiance by exact sums.
fn exactly(scene: &Scene) -> Vec<Vec3> {
    let options = Options {
        method: Method::Direct,
        ..Options::default()
    };
    let lit = illuminate(scene, &options, Backend::Cpu, &Silent);
    lit.unwrap().map.irradiance
}

/// The sphere that emits 1 and reflects 1/2: the radiosity is 2 everywhere.
#[test]
fn furnace() {
    let scene = scene("furnace", 3000);
    let options = Options {
        rays: Some(64),
        ..Options::default()
    };
    let lit = solve(&scene, &options);
    let off = lit.map.radiosity.iter().map(|b| (b.x / 2.0 - 1.0).abs());
    let off = off.fold(0.0, f32::max);
    let row_sum = lit.stats.row_sum.unwrap();
    println!("furnace: radiosity off by {off:e} at most, row sum {row_sum:?}");
    assert!(lit.stats.converged && off < 2e-3);
    // On average no more light than there is; close pairs and rays do not fit at every point.
    assert!(row_sum.max < 1.02 && (row_sum.mean - 1.0).abs() < 1e-6);
}

/// Where nothing is reflected no ray is cast, and the sampled lights are verified all the same.
#[test]
fn lights_alone_are_verified() {
    for (name, max_bounces) in [("plates_parallel", None), ("cornell", Some(0))] {
        let options = Options {
            max_bounces,
            ..Options::default()
        };
        let stats = solve(&scene(name, 2000), &options).stats;
        assert_eq!((stats.method, stats.rays), (Method::Gather, None));
        assert!(stats.error.is_some_and(|error| error.met));
    }
}

/// In a sphere every place gets the same light from every other: with a cap of the part f of its
/// surface that emits 1, and the reflectance ρ, the irradiance is f / (1 - ρ) everywhere.
#[test]
fn integrating_sphere() {
    let mut scene = scene("furnace", 4000);
    let centre = scene.cloud.positions.iter().sum::<DVec3>() / scene.cloud.len() as f64;
    let radius = scene.cloud.positions[0].distance(centre);
    let height = scene
        .cloud
        .positions
        .iter()
        .map(|p| (p.z - centre.z) / radius);
    scene.cloud.emission = height
        .map(|z| if z > 0.5 { Vec3::ONE } else { Vec3::ZERO })
        .collect();
    scene.cloud.reflectance.fill(Vec3::splat(0.8));
    let truth = 0.25 / (1.0 - 0.8);
    for rays in [64, 1024] {
        let options = Options {
            tolerance: Some(1e-3),
            rays: Some(rays),
            ..Options::default()
        };
        let lit = solve(&scene, &options);
        let found = lit.map.irradiance;
        let truth = vec![Vec3::splat(truth as f32); found.len()];
        let off = compare(&found, &truth).unwrap();
        let (error, bias) = (off.rel_l2, off.bias);
        println!("sphere, {rays} rays: error {error:.5}, bias {bias:+.5}");
        // Every ray meets the same light: what is left are the areas of the cells.
        assert!(error < 2e-3 && bias.abs() < 1e-3);
    }
}

/// Tolerances are met, with more rays for smaller ones, and what is said of the error is true: exact
/// sums over the points find it within its bounds.
#[test]
fn rays_follow_the_tolerance() {
    let scene = scene("organic", 6000);
    let truth = exactly(&scene);
    let mut last = 0;
    for tolerance in [0.2, 0.1, 0.05] {
        let options = Options {
            tolerance: Some(tolerance),
            below_model: true,
            ..Options::default()
        };
        let found = solve(&scene, &options);
        let rays = found.stats.rays.unwrap();
        let said = found.stats.error.unwrap();
        let error = compare(&found.map.irradiance, &truth).unwrap().rel_l2;
        println!("tolerance {tolerance}: {rays} rays, error {error:.4}, said {said}");
        assert!(found.stats.converged && said.met && error <= tolerance);
        assert!(error <= said.total.rel_l2.high && rays >= last);
        last = rays;
    }
    assert!(last > 16);
}

/// A lamp next to a wall makes a spot there that few rays meet. What it reflects is sampled apart where
/// there are enough rays, here from 128 on: those leave a third of the noise of half as many, and not the
/// usual 2^-0.8.
#[test]
fn bright_spots_are_no_noise() {
    let mut scene = scene("cornell", 4000);
    scene.cloud.emission.fill(Vec3::ZERO);
    scene.lights = vec![PointLight {
        position: DVec3::new(0.06, 0.5, 0.5),
        intensity: Vec3::ONE,
    }];
    let truth = exactly(&scene);
    let error = |rays| {
        let options = Options {
            rays: Some(rays),
            ..Options::default()
        };
        let found = solve(&scene, &options);
        let off = compare(&found.map.irradiance, &truth).unwrap();
        let said = found.stats.error.unwrap().reflected.unwrap().rel_l2;
        println!(
            "{rays} rays: off by {:.4}, bias {:+.4}, reflected light {said:?}",
            off.rel_l2, off.bias
        );
        assert!(off.bias.abs() < 0.002);
        said.value
    };
    let (few, many) = (error(64), error(128));
    assert!(many < 0.45 * few, "{many} {few}");
}

/// Under a sky a block over a floor reflects a little to it, which needs no better light than the sky has: both
/// together are within the tolerance, and said to be.
#[test]
fn reflected_light_counts_with_the_sky() {
    let floor = quad(
        DVec3::new(-1.0, -1.0, -0.05),
        3.0 * DVec3::X,
        3.0 * DVec3::Y,
        50,
        0.5,
        7,
    );
    let mut scene = Scene {
        cloud: joined([floor, cube(20, 0.5, false, 1)]),
        sky: Vec3::ONE,
        ..Scene::default()
    };
    scene.cloud.reflectance = vec![Vec3::splat(0.5); scene.cloud.len()];
    let options = Options {
        seed: 3,
        ..Options::default()
    };
    let few = solve(&scene, &options);
    let fine = Options {
        method: Method::Direct,
        tolerance: Some(0.003),
        ..Options::default()
    };
    let truth = illuminate(&scene, &fine, Backend::Cpu, &Silent)
        .unwrap()
        .map;
    let off = compare(&few.map.irradiance, &truth.irradiance).unwrap();
    let said = few.stats.error.unwrap();
    println!(
        "off by {:.4}, bias {:+.4}; said {said}; {said:?}",
        off.rel_l2, off.bias
    );
    assert!(said.met && few.stats.rays == Some(16));
    // The bound is one of 95%: it holds with 15 of 16 seeds.
    assert!(off.rel_l2 <= said.ambient.high && off.bias.abs() < 0.003);
    // Reflected light alone is not.
    assert!(said.reflected.unwrap().rel_l2.low > said.tolerance);
    // All light that there is comes from all around.
    assert!((said.total.rel_l2.value / said.ambient.value - 1.0).abs() < 1e-6);
}

/// An object whose normals point inward sees the sky through its holes alone, and is told what to do.
#[test]
fn a_sky_seen_from_inside_is_told() {
    for inside in [true, false] {
        let mut scene = Scene {
            cloud: cube(10, 0.5, inside, 1),
            sky: Vec3::ONE,
            ..Scene::default()
        };
        // A hole.
        scene.cloud.positions[44] += 0.3 * DVec3::Z;
        let options = Options {
            rays: Some(16),
            ..Options::default()
        };
        let repairs = solve(&scene, &options).stats.repairs;
        let told = |words: &String| words.contains("--normals outward");
        assert_eq!(repairs.iter().any(told), inside, "{repairs:?}");
    }
}

#[test]
fn threads_change_nothing_and_seeds_do() {
    let scene = scene("cornell", 2000);
    let options = |seed| Options {
        rays: Some(32),
        seed,
        ..Options::default()
    };
    let on = |threads, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        pool.install(|| solve(&scene, &options(seed)).map.irradiance)
    };
    let one = on(1, 1);
    assert_eq!(one, on(3, 1));
    assert_ne!(one, on(3, 2));
}

/// Measured: 6e-9.
#[test]
fn a_device_finds_the_same_light() {
    let scene = scene("cornell", 3000);
    let options = Options {
        method: Method::Gather,
        rays: Some(256),
        ..Options::default()
    };
    let gpu = gpu();
    let backend = Backend::Gpu {
        device: &gpu.device,
        queue: &gpu.queue,
        adapter: "test",
    };
    let device = illuminate(&scene, &options, backend, &Silent).unwrap();
    let host = illuminate(&scene, &options, Backend::Cpu, &Silent).unwrap();
    let off = compare(&device.map.irradiance, &host.map.irradiance)
        .unwrap()
        .rel_l2;
    println!("device: {off:e}");
    assert!(off < 1e-5);
    assert_eq!(device.stats.links, host.stats.links);
}

#[test]
fn what_cannot_be_is_refused() {
    let scene = scene("furnace", 500);
    let gather = |options: Options| {
        let options = Options {
            method: Method::Gather,
            ..options
        };
        illuminate(&scene, &options, Backend::Cpu, &Silent).map(|_| ())
    };
    let open = Options {
        occlusion: Occlusion::None,
        ..Options::default()
    };
    assert!(matches!(gather(open), Err(Error::Usage(_))));
    for rays in [0, 1, 100_000] {
        let rays = Options {
            rays: Some(rays),
            ..Options::default()
        };
        assert!(matches!(gather(rays), Err(Error::Usage(_))));
    }
    let check = |free| fmmgi_gpu::memory::check_rays(1000, 100, free);
    assert!(matches!(check(Some(3_000_000)), Err(Error::TooLarge(_))));
    assert!(check(Some(4_000_000)).is_ok() && check(None).is_ok());
}

/// A closed cube in which next to nothing is lost, lit by two black surfels.
fn bright_cube(reflectance: f32) -> Scene {
    let mut cloud = cube(9, 0.0, true, 1);
    cloud.reflectance.fill(Vec3::splat(reflectance));
    for i in [40, 283] {
        cloud.reflectance[i] = Vec3::ZERO;
        cloud.emission[i] = Vec3::splat(10.0);
    }
    Scene {
        cloud,
        ..Scene::default()
    }
}

/// Where light is reflected hundreds of times, what the cells that rays meet are larger or smaller than
/// the areas of their points is the error: what is said of it holds against exact sums.
#[test]
fn the_error_of_bright_rooms_is_known() {
    let scene = bright_cube(0.995);
    let truth = exactly(&scene);
    for seed in 0..4 {
        let options = Options {
            rays: Some(128),
            seed,
            tolerance: Some(0.01),
            ..Options::default()
        };
        let found = solve(&scene, &options);
        let error = compare(&found.map.irradiance, &truth).unwrap().rel_l2;
        let said = found.stats.error.unwrap();
        let bounds = said.total.rel_l2;
        println!("seed {seed}: error {error:.4}, said {bounds:?}");
        assert!(!said.met && error > 0.8 * bounds.low && error < 1.2 * bounds.high);
    }
}

/// No light is lost: what is said must still be light. (Measured: 0.23; with what rounding leaves of an
/// amount that nothing determines, 19,000.)
#[test]
fn a_white_room_has_no_solution() {
    let mut cloud = cube(12, 0.0, true, 1);
    cloud.reflectance.fill(Vec3::ONE);
    cloud.emission[3] = Vec3::ONE;
    let scene = Scene {
        cloud,
        ..Scene::default()
    };
    let options = Options {
        rays: Some(64),
        ..Options::default()
    };
    let lit = solve(&scene, &options);
    let most = lit.map.irradiance.iter().map(|h| h.max_element());
    let most = most.fold(0.0, f32::max);
    println!(
        "white room: at most {most}, residual {}",
        lit.stats.residual
    );
    assert!((lit.stats.row_sum.unwrap().mean - 1.0).abs() < 1e-6);
    assert!(!lit.stats.converged && most < 1.0);
}
