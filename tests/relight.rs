//! One transport for many lights: as accurate as if each were the first, and hardly any work where
//! the links suffice.

mod common;
mod relit;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use common::gpu;
use fmmgi_gpu::links::{self, Accuracy, Kept, Links, SLACK};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Fmm, TransportOperator};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{
    Backend, Error, Illumination, Method, Occlusion, Options, Progress, Scene, Surfels, Transport,
    illuminate,
};
use glam::{DVec3, Vec3};
use relit::{errors, lamp, move_lamp};

const TOLERANCE: f64 = 0.03;
const POINTS: usize = 5000;
const RECEIVERS: usize = 200;

const CEILING: [f64; 3] = [0.5, 0.9, 0.5];
const CORNER: [f64; 3] = [0.15, 0.2, 0.1];
const ROOMS: [[f64; 3]; 2] = [[2.0, 2.0, 1.5], [6.0, 2.0, 1.5]];

fn options() -> Options {
    Options {
        method: Method::Fmm,
        tolerance: Some(TOLERANCE),
        ..Options::default()
    }
}

fn transport(scene: &Scene) -> Transport {
    Transport::new(scene, &options(), Backend::Cpu, &Silent).unwrap()
}

fn light(transport: &mut Transport, scene: &Scene) -> Illumination {
    let lit = transport.illuminate(scene, &Silent).unwrap();
    assert!(lit.stats.converged);
    lit
}

fn everywhere(_: DVec3) -> bool {
    true
}

fn difference(a: &Illumination, b: &Illumination) -> f64 {
    let pairs = || a.map.irradiance.iter().zip(&b.map.irradiance);
    let off: f32 = pairs().map(|(a, b)| a.distance_squared(*b)).sum();
    let all: f32 = pairs().map(|(_, b)| b.length_squared()).sum();
    f64::from(off / all).sqrt()
}

#[test]
fn the_tolerance_holds_for_a_lamp_that_moves_to_a_dark_corner() {
    let mut scene = lamp("cornell", POINTS, CEILING);
    let mut kept = transport(&scene);
    // Measured: 0.022, 0.018, 0.021.
    for place in [CEILING, CORNER, CEILING] {
        move_lamp(&mut scene, place);
        let lit = light(&mut kept, &scene);
        let found = errors(&scene, &lit, RECEIVERS, everywhere);
        println!("{place:?}: {found:?}, {} segments", lit.stats.segments);
        assert!(found.indirect < TOLERANCE, "{place:?}: {found:?}");
    }
}

#[test]
fn the_tolerance_holds_in_each_of_two_rooms_wherever_the_lamp_hangs() {
    let mut scene = lamp("two_rooms", POINTS, ROOMS[0]);
    let mut kept = transport(&scene);
    for (room, place) in ROOMS.into_iter().enumerate() {
        move_lamp(&mut scene, place);
        let lit = light(&mut kept, &scene);
        let all = errors(&scene, &lit, RECEIVERS, everywhere);
        let here = errors(&scene, &lit, RECEIVERS, |p| (p.x > 4.025) == (room == 1));
        println!(
            "{room}: {all:?}, here {here:?}, {} segments",
            lit.stats.segments
        );
        assert!(
            all.indirect < TOLERANCE && here.indirect < TOLERANCE,
            "{all:?} {here:?}"
        );
    }
}

#[test]
fn what_was_left_out_for_a_weak_light_is_found_for_a_strong_one() {
    let scene = lamp("two_rooms", POINTS, ROOMS[0]);
    let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
    let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
    let occluders = Occluders::build(&surfels);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let ones = vec![DVec3::ONE; surfels.len()];
    let accuracy = |error| Accuracy::new(&octree, &ones, None, error, 1, 1);
    let received = |links: &Links| {
        let operator = Fmm::<f64>::new(&surfels, &octree, links);
        operator.apply(&ones).unwrap()
    };
    let mut kept = Kept::none(&octree, &surfels);
    for error in [1.0, 0.2, 0.01] {
        let accuracy = accuracy(error);
        kept.refine(&surfels, &octree, &accuracy, SLACK, &visibility, &Silent)
            .unwrap();
    }
    let fresh = links::build(&surfels, &octree, &accuracy(0.01), &visibility, &Silent).unwrap();
    let [kept, fresh] = [&kept.links, &fresh].map(received);
    let sum = |light: &[DVec3]| light.iter().map(|h| h.x).sum::<f64>();
    let off: f64 = kept
        .iter()
        .zip(&fresh)
        .map(|(a, b)| (a.x - b.x).powi(2))
        .sum();
    let off = (off / fresh.iter().map(|b| b.x * b.x).sum::<f64>()).sqrt();
    let lost = 1.0 - sum(&kept) / sum(&fresh);
    println!("off by {off:.4}, lost {lost:.5}");
    assert!(lost.abs() < 3e-3 && off < 0.02, "{lost} {off}");
}

#[test]
fn the_tolerance_holds_for_emission_that_moves_and_for_other_colours() {
    let mut scene = lamp("cornell", POINTS, CEILING);
    scene.lights.clear();
    let shine = |scene: &mut Scene, place: DVec3| {
        let cloud = &mut scene.cloud;
        for (p, e) in cloud.positions.iter().zip(&mut cloud.emission) {
            *e = if p.distance(place) < 0.15 {
                Vec3::splat(10.0)
            } else {
                Vec3::ZERO
            };
        }
    };
    let mut kept: Option<Transport> = None;
    for (place, reflectance) in [
        (DVec3::new(0.5, 1.0, 0.5), 0.7),
        (DVec3::new(0.0, 0.2, 0.1), 0.7),
        (DVec3::new(0.0, 0.2, 0.1), 0.3),
    ] {
        shine(&mut scene, place);
        scene.cloud.reflectance.fill(Vec3::splat(reflectance));
        let kept = kept.get_or_insert_with(|| transport(&scene));
        let lit = light(kept, &scene);
        let found = errors(&scene, &lit, RECEIVERS, everywhere);
        println!("{place}: {found:?}, {} segments", lit.stats.segments);
        assert!(found.total < TOLERANCE, "{place}: {found:?}");
    }
}

#[test]
fn the_same_light_again_and_a_brighter_one_test_no_segment_but_those_to_the_lamp() {
    let mut scene = lamp("cornell", POINTS, CEILING);
    let mut kept = transport(&scene);
    let first = light(&mut kept, &scene);
    let again = light(&mut kept, &scene);
    scene.lights[0].intensity *= 8.0;
    let brighter = light(&mut kept, &scene);
    // What faces the lamp: 3,400 of 4,857 surfels; a few links are known to be too rough only now.
    // (Measured: 0.052.)
    for lit in [&again, &brighter] {
        let share = lit.stats.segments as f64 / first.stats.segments as f64;
        println!(
            "{} of {} segments",
            lit.stats.segments, first.stats.segments
        );
        assert!(share < 0.1, "{share}");
    }
    assert!(difference(&again, &first) < 2e-3);
    let mut eighth = brighter.clone();
    eighth.map.irradiance.iter_mut().for_each(|h| *h /= 8.0);
    assert!(difference(&eighth, &again) < 2e-3);
}

#[test]
fn what_was_dark_first_is_as_if_it_came_first() {
    let mut scene = lamp("cornell", 2000, CEILING);
    let fresh = illuminate(&scene, &options(), Backend::Cpu, &Silent).unwrap();
    let lamps = std::mem::take(&mut scene.lights);
    let mut kept = transport(&scene);
    let dark = light(&mut kept, &scene);
    assert!(dark.map.irradiance.iter().all(|h| *h == Vec3::ZERO));
    scene.lights = lamps;
    assert_eq!(
        light(&mut kept, &scene).map.irradiance,
        fresh.map.irradiance
    );
}

#[test]
fn the_bits_do_not_depend_on_the_number_of_threads() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut scene = lamp("two_rooms", 2000, ROOMS[0]);
            let mut kept = transport(&scene);
            light(&mut kept, &scene);
            move_lamp(&mut scene, ROOMS[1]);
            light(&mut kept, &scene).map.irradiance
        })
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn a_relight_that_is_stopped_leaves_a_transport_that_can_go_on() {
    /// Says stop at a moment, once.
    struct Stop(AtomicU64);
    impl Progress for Stop {
        fn cancelled(&self) -> bool {
            self.0.fetch_sub(1, Ordering::Relaxed) == 0
        }
    }
    let mut scene = lamp("two_rooms", POINTS, ROOMS[0]);
    let mut interrupted = 0;
    for moment in [3, 6, 9, 12] {
        move_lamp(&mut scene, ROOMS[0]);
        let mut kept = transport(&scene);
        light(&mut kept, &scene);
        move_lamp(&mut scene, ROOMS[1]);
        let stopped = kept.illuminate(&scene, &Stop(moment.into()));
        interrupted += u32::from(matches!(stopped, Err(Error::Interrupted)));
        let found = errors(&scene, &light(&mut kept, &scene), RECEIVERS, everywhere);
        assert!(found.indirect < TOLERANCE, "{moment}: {found:?}");
    }
    assert!(interrupted >= 3, "{interrupted}");
}

#[test]
fn a_device_lights_as_the_cpu_does() {
    let mut scene = lamp("cornell", 3000, CEILING);
    let gpu = gpu();
    let backend = Backend::Gpu {
        device: &gpu.device,
        queue: &gpu.queue,
        adapter: "of the test",
    };
    let mut there = Transport::new(&scene, &options(), backend, &Silent).unwrap();
    let mut here = transport(&scene);
    for place in [CEILING, [0.55, 0.9, 0.5], CORNER] {
        move_lamp(&mut scene, place);
        let [there, here] = [&mut there, &mut here].map(|t| light(t, &scene));
        let difference = difference(&there, &here);
        println!("{place:?}: {difference:.1e}");
        // Rounding decides about single links.
        assert!(difference < 3e-3, "{place:?}: {difference}");
    }
}

#[test]
fn without_occlusion_and_by_other_methods_each_light_is_as_if_it_came_first() {
    let cases = [
        (Method::Fmm, Occlusion::None),
        (Method::Direct, Occlusion::Surfels),
    ];
    for (method, occlusion) in cases {
        let options = Options {
            method,
            occlusion,
            ..options()
        };
        let mut scene = lamp("cornell", 1500, CEILING);
        let mut kept = Transport::new(&scene, &options, Backend::Cpu, &Silent).unwrap();
        for place in [CEILING, CORNER] {
            move_lamp(&mut scene, place);
            let lit = light(&mut kept, &scene);
            let fresh = illuminate(&scene, &options, Backend::Cpu, &Silent).unwrap();
            let difference = difference(&lit, &fresh);
            println!("{method:?}, {occlusion:?}: {difference:.1e}");
            // Without occlusion the second solution starts from that by the links of the first light.
            assert!(difference < 1e-2, "{method:?}: {difference}");
        }
    }
}

/// What rays met serves any light; they are cast where there are too few of them.
#[test]
fn rays_are_kept_for_other_lights() {
    /// Whether rays were cast.
    #[derive(Default)]
    struct Cast(AtomicBool);
    impl Progress for Cast {
        fn stage(&self, name: &str, _: u64) {
            self.0.fetch_or(name == "rays", Ordering::Relaxed);
        }
    }
    let options = Options {
        method: Method::Gather,
        ..options()
    };
    let mut scene = lamp("cornell", POINTS, CEILING);
    let mut kept = Transport::new(&scene, &options, Backend::Cpu, &Silent).unwrap();
    let mut lit = |place| {
        move_lamp(&mut scene, place);
        let cast = Cast::default();
        let lit = kept.illuminate(&scene, &cast).unwrap();
        let found = errors(&scene, &lit, RECEIVERS, everywhere);
        let rays = lit.stats.rays.unwrap();
        println!("{place:?}: {found:?}, {rays} rays");
        assert!(lit.stats.met() && found.indirect < TOLERANCE, "{found:?}");
        (lit, rays, cast.0.into_inner())
    };
    let (first, few, cast) = lit(CEILING);
    assert!(cast);
    let fresh = illuminate(
        &lamp("cornell", POINTS, CEILING),
        &options,
        Backend::Cpu,
        &Silent,
    );
    assert_eq!(first.map.irradiance, fresh.unwrap().map.irradiance);
    let (again, same, cast) = lit(CEILING);
    assert!(same == few && !cast);
    assert!(difference(&again, &first) < 0.01);
    let (_, many, _) = lit(CORNER);
    let (_, still, cast) = lit(CEILING);
    assert!(many >= few && still == many && !cast);
}

#[test]
fn another_cloud_and_light_that_cannot_be_are_refused() {
    let scene = lamp("cornell", 1500, CEILING);
    let mut kept = transport(&scene);
    let refused = |kept: &mut Transport, change: &dyn Fn(&mut Scene)| {
        let mut scene = scene.clone();
        change(&mut scene);
        match kept.illuminate(&scene, &Silent) {
            Err(Error::Invalid(why)) => why,
            other => panic!("{other:?}"),
        }
    };
    let cloud = "not the cloud";
    assert!(refused(&mut kept, &|s| s.cloud.positions[7].x += 1e-6).contains(cloud));
    assert!(refused(&mut kept, &|s| s.cloud.normals[7] = Vec3::ONE).contains(cloud));
    assert!(refused(&mut kept, &|s| s.cloud.areas[7] *= 2.0).contains(cloud));
    assert!(
        refused(&mut kept, &|s| s.cloud =
            lamp("cornell", 1400, CEILING).cloud)
        .contains(cloud)
    );
    assert!(refused(&mut kept, &|s| s.cloud.emission[7].x = f32::NAN).contains("emission"));
    assert!(refused(&mut kept, &|s| s.cloud.reflectance.truncate(9)).contains("reflectances"));
    assert!(refused(&mut kept, &|s| s.lights[0].intensity.x = -1.0).contains("light 0"));
    light(&mut kept, &scene);
}
