//! Links without tests of visibility, where nothing seems to be in the way: chosen where that is cheaper,
//! verified with tests, and given up where something is in the way after all.

mod common;
mod relit;

use std::path::Path;

use common::{gpu, scene};
use fmmgi_gpu::links::open;
use fmmgi_gpu::octree::LEAF_SIZE;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{Backend, Error, Illumination, Method, Occlusion, Options, Plan, Scene, Transport};
use glam::{Vec3, dvec3};
use relit::errors;

const TOLERANCE: f64 = 0.02;

fn options() -> Options {
    Options {
        tolerance: Some(TOLERANCE),
        below_model: true,
        ..Options::default()
    }
}

fn plan(scene: &Scene, options: &Options) -> Plan {
    Plan::new(scene, options, &Backend::Cpu).unwrap()
}

/// A plan for links without tests, for a scene that may need some.
fn untested(scene: &Scene, instead: Option<Method>) -> Plan {
    Plan {
        method: Method::Fmm,
        visibility: Occlusion::None,
        order: Some(open::order(TOLERANCE)),
        leaf_size: LEAF_SIZE,
        rays: None,
        spots_apart: false,
        instead,
        ..plan(scene, &options())
    }
}

fn transport(scene: &Scene, plan: Plan) -> Transport {
    Transport::planned(scene, &options(), Backend::Cpu, plan, &Silent).unwrap()
}

fn met(lit: &Illumination) -> bool {
    lit.stats.error.as_ref().is_some_and(|error| error.met)
}

#[test]
fn chosen_where_nothing_seems_to_be_in_the_way() {
    for name in ["room", "plates_parallel", "plates_perpendicular"] {
        let plan = plan(&scene(name, 10_000), &options());
        println!("{name}:\n{plan}");
        let taken = (plan.method, plan.visibility, plan.instead);
        let wanted = (Method::Fmm, Occlusion::None, Some(Method::Fmm));
        assert_eq!(taken, wanted, "{name}");
    }
    for name in ["cornell", "two_rooms", "organic", "cave"] {
        let plan = plan(&scene(name, 10_000), &options());
        assert_eq!(plan.visibility, Occlusion::Surfels, "{name}");
    }
    // Who asks for links has them tested; what is not reflected of a sky is tested in any case.
    let room = scene("room", 10_000);
    let by_links = Options {
        method: Method::Fmm,
        ..options()
    };
    assert_eq!(plan(&room, &by_links).visibility, Occlusion::Surfels);
    let sky = Scene {
        sky: Vec3::ONE,
        ..room
    };
    assert_eq!(plan(&sky, &options()).visibility, Occlusion::Surfels);
}

/// The light of an empty room is that of exact sums with tests. Only lamps are tested.
#[test]
fn an_empty_room_keeps_its_tolerance() {
    let mut room = scene("room", 10_000);
    let mut transport = transport(&room, plan(&room, &options()));
    let mut check = |room: &Scene| {
        let lit = transport.illuminate(room, &Silent).unwrap();
        let found = errors(room, &lit, 300, |_| true);
        println!("{found:?}, {} segments", lit.stats.segments);
        assert!(met(&lit) && found.total < TOLERANCE && found.indirect < TOLERANCE);
        assert_eq!(lit.stats.method, Method::Fmm);
        let (surfels, lamps) = (lit.stats.surfels, room.lights.len());
        assert!(lit.stats.segments <= (surfels * lamps) as u64);
    };
    check(&room);
    room.lights = vec![PointLight {
        position: dvec3(1.0, 1.0, 1.0),
        intensity: Vec3::ONE,
    }];
    check(&room);
    let kept = transport.save(Path::new("nowhere"));
    assert!(matches!(kept, Err(Error::Usage(_))), "{kept:?}");
}

/// Two blocks that were overlooked: the verification sees them.
#[test]
fn something_in_the_way_is_found_out() {
    let cornell = scene("cornell", 3000);
    let lit = transport(&cornell, untested(&cornell, None))
        .illuminate(&cornell, &Silent)
        .unwrap();
    let found = errors(&cornell, &lit, 300, |_| true);
    println!("without tests {found:?}, {:?}", lit.stats.error);
    assert!(!met(&lit) && found.total > 2.0 * TOLERANCE);

    let mut transport = transport(&cornell, untested(&cornell, Some(Method::Fmm)));
    for _ in 0..2 {
        let lit = transport.illuminate(&cornell, &Silent).unwrap();
        let found = errors(&cornell, &lit, 300, |_| true);
        println!("with tests instead {found:?}");
        assert!(met(&lit) && found.total < TOLERANCE);
        assert_eq!(lit.stats.method, Method::Fmm);
    }
    // Links with tests can be kept.
    let folder = tempfile::tempdir().unwrap();
    transport.save(&folder.path().join("operator")).unwrap();
}

#[test]
fn a_device_goes_without_tests_too() {
    let room = scene("room", 10_000);
    let [on_cpu, on_device] = [true, false].map(|on_cpu| {
        let gpu = gpu();
        let backend = match on_cpu {
            true => Backend::Cpu,
            false => Backend::Gpu {
                device: &gpu.device,
                queue: &gpu.queue,
                adapter: "tested",
            },
        };
        let lit = fmmgi_gpu::illuminate(&room, &options(), backend, &Silent).unwrap();
        let plan = lit.stats.plan.as_ref().unwrap();
        assert_eq!(plan.visibility, Occlusion::None);
        assert!(met(&lit) && lit.stats.segments == 0);
        lit.map.irradiance
    });
    let square = |h: Vec3| f64::from(h.length_squared());
    let off: f64 = (on_cpu.iter().zip(&on_device))
        .map(|(a, b)| square(*a - *b))
        .sum();
    let off = (off / on_cpu.iter().map(|h| square(*h)).sum::<f64>()).sqrt();
    println!("on a device off by {off:e}");
    assert!(off < 1e-5);
}
