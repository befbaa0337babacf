//! Grey light on grey surfaces is solved as one colour: the same light, to the bit where no norm is in it.

mod cases;
mod common;

use cases::{Case, cases, colours, on_host, relative_l2};
use common::{clutter, gpu, scene};
use fmmgi_gpu::math::Real;
use fmmgi_gpu::operator::Fmm;
use fmmgi_gpu::passes::gpu::Gpu;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{Backend, Illumination, Method, Options, Plan, Scene, Transport, illuminate};
use glam::{DVec3, Vec3, dvec3};

/// Hardly a colour: which links are made does not depend on it.
const TINT: Vec3 = Vec3::new(1.0, 1.0, 0.999_998);

fn options(method: Method) -> Options {
    Options {
        method,
        tolerance: Some(0.05),
        below_model: true,
        ..Options::default()
    }
}

fn lit(scene: &Scene, method: Method) -> Illumination {
    illuminate(scene, &options(method), Backend::Cpu, &Silent).unwrap()
}

fn irradiance(lit: &Illumination) -> Vec<DVec3> {
    lit.map.irradiance.iter().map(|h| h.as_dvec3()).collect()
}

/// A shipped scene whose red is also its green and blue.
fn greyed(name: &str) -> Scene {
    let mut scene = scene(name, 4000);
    let cloud = &mut scene.cloud;
    let colours = cloud.reflectance.iter_mut().chain(&mut cloud.emission);
    let lights = scene.lights.iter_mut().map(|light| &mut light.intensity);
    colours.chain(lights).for_each(|c| *c = Vec3::splat(c.x));
    assert!(scene.is_grey());
    scene
}

/// The same where all light has a tint.
fn tinted(grey: &Scene) -> Scene {
    let mut scene = grey.clone();
    let emission = scene.cloud.emission.iter_mut();
    let lights = scene.lights.iter_mut().map(|light| &mut light.intensity);
    emission.chain(lights).for_each(|c| *c *= TINT);
    scene
}

fn same_bits<T: Real>(case: &Case) {
    let light = colours(case.surfels.len(), 3);
    let operator = Fmm::<T>::new(&case.surfels, &case.octree, &case.links);
    let three = on_host(&operator, &light);
    for channel in 0..3 {
        let grey: Vec<DVec3> = light.iter().map(|c| DVec3::splat(c[channel])).collect();
        let one = on_host(&operator.grey(), &grey);
        let wanted = three.iter().map(|h| DVec3::splat(h[channel]));
        assert!(one.into_iter().eq(wanted), "{}, {channel}", case.name);
    }
}

/// By links of all kinds and orders.
#[test]
fn one_colour_has_the_bits_of_each_of_three() {
    let tangled = (0..=5).map(|order| Case::tangled("tangled", &clutter(2000, 0.05, 7), order, 1));
    for case in cases().into_iter().chain(tangled) {
        same_bits::<f32>(&case);
        same_bits::<f64>(&case);
    }
}

#[test]
fn grey_scenes_get_the_light_that_coloured_ones_get() {
    for name in ["cornell", "organic", "cave", "room"] {
        let grey = greyed(name);
        for method in [Method::Fmm, Method::Gather] {
            let one = lit(&grey, method);
            assert!(one.stats.met(), "{name}");
            let one = irradiance(&one);
            assert!(one.iter().all(|h| h.x == h.y && h.y == h.z), "{name}");
            let three = irradiance(&lit(&tinted(&grey), method));
            let off = relative_l2(&three, &one);
            println!("{name} by {method:?}: {off:.1e}");
            assert!(off < 1e-5, "{name} by {method:?}: {off}");
        }
    }
}

/// What is kept of a scene serves light of either kind.
#[test]
fn a_kept_transport_takes_either() {
    let mut scene = greyed("cornell");
    scene.cloud.emission.fill(Vec3::ZERO);
    for method in [Method::Fmm, Method::Gather] {
        let options = options(method);
        let mut transport = Transport::new(&scene, &options, Backend::Cpu, &Silent).unwrap();
        let mut light = |intensity| {
            scene.lights = vec![PointLight {
                position: dvec3(0.5, 0.9, 0.5),
                intensity,
            }];
            irradiance(&transport.illuminate(&scene, &Silent).unwrap())
        };
        light(Vec3::ONE);
        let [tinted, grey] = [TINT, Vec3::ONE].map(&mut light);
        assert!(tinted.iter().all(|h| h.x > h.z));
        let off = relative_l2(&tinted, &grey);
        println!("{method:?}: {off:.1e}");
        // The solver begins elsewhere each time, and leaves a residual of 5e-4.
        assert!(off < 1e-4, "{method:?}: {off}");
    }
}

#[test]
fn the_plan_says_so() {
    let grey = greyed("cornell");
    let on = |backend: &Backend, scene: &Scene, method| {
        let plan = Plan::new(scene, &options(method), backend).unwrap();
        let choice = plan.choices.iter().find(|c| c.what == "colours").unwrap();
        println!("{method:?}: {}: {}", choice.taken, choice.why);
        choice.taken.clone()
    };
    let colours = |scene: &Scene, method| on(&Backend::Cpu, scene, method);
    assert_eq!(colours(&grey, Method::Fmm), "one");
    assert_eq!(colours(&grey, Method::Gather), "one");
    assert_eq!(colours(&grey, Method::Direct), "three");
    let Gpu { device, queue, .. } = gpu();
    let adapter = "the adapter found";
    let device = Backend::Gpu {
        device,
        queue,
        adapter,
    };
    assert_eq!(on(&device, &grey, Method::Fmm), "three");
    // One colour in the lamps, on the walls or in the sky is enough.
    assert_eq!(colours(&tinted(&grey), Method::Fmm), "three");
    let mut walls = grey.clone();
    walls.cloud.reflectance[17] *= TINT;
    assert_eq!(colours(&walls, Method::Fmm), "three");
    let sky = Scene { sky: TINT, ..grey };
    assert_eq!(colours(&sky, Method::Fmm), "three");
}
