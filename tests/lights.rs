//! Direct light against closed forms.

mod clouds;

use std::f64::consts::PI;

use clouds::*;
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::lights::{emitters, point_lights, sky};
use fmmgi_gpu::operator::exact_irradiance;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::smoothing::Smoother;
use fmmgi_gpu::visibility::{CpuVisibility, NothingInTheWay, Occluders, Visibility};
use fmmgi_gpu::{PointCloud, Surfels};
use glam::{DVec3, Vec3};

const TOLERANCE: f64 = 0.03;

fn light(position: DVec3) -> PointLight {
    PointLight {
        position,
        intensity: Vec3::new(1.0, 2.0, 0.5),
    }
}

fn lit(s: &Surfels, lights: &[PointLight], visibility: &dyn Visibility) -> (Vec<DVec3>, usize) {
    let lit = point_lights(s, lights, visibility, &Silent).expect("lit");
    (lit.irradiance, lit.too_close)
}

/// Place of surfel i in the cloud's coordinates.
fn place(s: &Surfels, i: usize) -> DVec3 {
    s.positions[i].as_dvec3() + s.origin
}

fn floor(k: usize) -> PointCloud {
    quad(DVec3::new(-0.5, -0.5, 0.0), DVec3::X, DVec3::Y, k, 0.5, 1)
}

#[test]
fn point_lights_follow_cosine_over_square() {
    for shift in [DVec3::ZERO, DVec3::new(4e5, -6e6, 10.0)] {
        let s = surfels(&moved(&floor(20), glam::DQuat::IDENTITY, 1.0, shift));
        let lamps = [
            light(DVec3::new(0.1, 0.2, 0.7) + shift),
            light(DVec3::new(-3.0, 0.0, 2.0) + shift),
        ];
        let below = light(DVec3::new(0.0, 0.0, -1.0) + shift);
        let (h, too_close) = lit(&s, &[lamps[0], lamps[1], below], &NothingInTheWay);
        assert_eq!(too_close, 0);
        for (i, h) in h.iter().enumerate() {
            let wanted: f64 = lamps
                .iter()
                .map(|l| {
                    let way = l.position - place(&s, i);
                    way.z / way.length().powi(3)
                })
                .sum();
            // Positions and the form are rounded to f32: a few 1e-7, three times for the cube.
            for (c, i) in [1.0, 2.0, 0.5].into_iter().enumerate() {
                assert!(
                    (h[c] - i * wanted).abs() < 3e-6 * i * wanted,
                    "{h} {wanted}"
                );
            }
        }
    }
}

#[test]
fn a_plate_throws_its_shadow() {
    // A plate of a quarter half way up casts a shadow of twice its size.
    let plate = quad(
        DVec3::new(-0.125, -0.125, 0.5),
        DVec3::X * 0.25,
        DVec3::Y * 0.25,
        10,
        0.5,
        2,
    );
    let s = surfels(&joined([floor(40), plate]));
    let occluders = Occluders::build(&s);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let (h, _) = lit(&s, &[light(DVec3::Z)], &visibility);
    let (mut dark, mut bright) = (0, 0);
    for i in (0..s.len()).filter(|&i| place(&s, i).z < 0.1) {
        let out = place(&s, i).abs().max_element();
        // The plate ends half a spacing beyond its last points, give or take: 0.25 +- 0.025 * 2 / 2.
        if out < 0.22 {
            assert_eq!(h[i], DVec3::ZERO, "at {out}");
            dark += 1;
        } else if out > 0.28 {
            assert!(h[i].x > 0.0, "at {out}");
            bright += 1;
        }
    }
    assert!(dark > 200 && bright > 800);
    // The plate is lit from above on its front only.
    assert!(
        (0..s.len())
            .filter(|&i| place(&s, i).z > 0.1)
            .all(|i| h[i].x > 0.0)
    );
}

#[test]
fn a_light_on_a_surfel_stays_finite_and_is_counted() {
    let s = surfels(&floor(20));
    let occluders = Occluders::build(&s);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let spacing = 0.05;
    for height in [0.3, 0.01, 1e-4, 1e-7, 0.0] {
        let at = place(&s, 210) + DVec3::Z * (height * spacing);
        let (h, too_close) = lit(&s, &[light(at)], &visibility);
        // I / r² of the disc with the surfel's area is the most that it gets.
        let most = PI / f64::from(s.areas[210]) * 2.0;
        assert!(
            h.iter()
                .all(|h| h.is_finite() && h.max_element() <= most * 1.0001),
            "{height}"
        );
        if height > 0.0 {
            assert_eq!(too_close, 1, "{height}");
        }
    }
}

const SKY: Vec3 = Vec3::new(1.0, 2.0, 3.0);

fn sky_of(s: &Surfels, tolerance: f64) -> Vec<DVec3> {
    let occluders = Occluders::build(s);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    sky(s, SKY, tolerance, 1, &visibility, None, &Silent).expect("sky")
}

fn smooth_sky_of(s: &Surfels, tolerance: f64) -> Vec<DVec3> {
    let occluders = Occluders::build(s);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let smoother = Some(&Smoother::new(s, &visibility, &Silent).expect("smoother"));
    sky(s, SKY, tolerance, 1, &visibility, smoother, &Silent).expect("sky")
}

#[test]
fn an_open_plane_gets_the_sky_it_was_given() {
    for turn in [glam::DQuat::IDENTITY, rotation(1)] {
        let s = surfels(&moved(&floor(20), turn, 3.0, DVec3::ZERO));
        for h in sky_of(&s, TOLERANCE) {
            assert_eq!(h, DVec3::new(1.0, 2.0, 3.0));
        }
    }
}

/// However few the points: cells reach farther out than they do.
#[test]
fn no_sky_gets_into_a_closed_box() {
    for k in [3, 5, 20] {
        let s = surfels(&cube(k, 0.5, true, 1));
        let h = sky_of(&s, TOLERANCE);
        let mean = h.iter().map(|h| h.x).sum::<f64>() / h.len() as f64;
        let leaking = h.iter().filter(|h| h.x > 0.0).count();
        println!("{leaking} of {} points see sky, mean {mean}", h.len());
        // Measured at 20: none in 290,000 directions.
        assert!(mean < 1e-4);
    }
}

/// A floor of 5 k² points and a wall of height 1 on it, ten times as long as high.
fn floor_and_wall(k: usize) -> Surfels {
    let strip = joined((0..20).map(|k| {
        let corner = DVec3::new(0.0, k as f64 - 10.0, 0.0);
        quad(corner, DVec3::Y, DVec3::Z, 20, 0.5, k)
    }));
    let ground = joined((0..5).map(|part| {
        let corner = DVec3::new(0.2 * part as f64, -0.1, 0.0);
        quad(corner, DVec3::X * 0.2, DVec3::Y * 0.2, k, 0.5, part)
    }));
    surfels(&joined([ground, strip]))
}

/// An endless wall of height 1 at distance d takes from a floor the form factor (1 - d / √(d² + 1)) / 2
/// (Howell B-4 for an endless strip).
fn over_the_wall(s: &Surfels, i: usize) -> f64 {
    let d = place(s, i).x;
    1.0 - 0.5 * (1.0 - d / (d * d + 1.0).sqrt())
}

/// What directions get wrong is smoothed, so that fewer of them do: a third as many, at this tolerance.
#[test]
fn a_smooth_sky_is_no_worse() {
    let floor = 5 * 20 * 20;
    let s = floor_and_wall(20);
    let [rough, smooth] = [sky_of(&s, TOLERANCE), smooth_sky_of(&s, TOLERANCE)].map(|h| {
        let off = |i: usize| h[i].x - over_the_wall(&s, i);
        let mean =
            |of: &dyn Fn(f64) -> f64| (0..floor).map(|i| of(off(i))).sum::<f64>() / floor as f64;
        (mean(&|off| off * off).sqrt(), mean(&|off| off))
    });
    println!("rms and bias {rough:?}, smoothed {smooth:?}");
    assert!(smooth.0 < rough.0 && smooth.1.abs() < rough.1.abs());
}

#[test]
fn a_wall_takes_its_part_of_the_sky() {
    let floor = 5 * 4 * 4;
    let s = floor_and_wall(4);
    let h = sky_of(&s, 0.003);
    let (mut square, mut bias) = (0.0, 0.0);
    for (i, h) in h.iter().enumerate().take(floor) {
        let d = place(&s, i).x;
        let wanted = over_the_wall(&s, i);
        square += (h.x - wanted).powi(2);
        bias += h.x - wanted;
        // 64² stratified directions: K^(-3/4) = 0.002, some points three times that; and half a
        // spacing of the wall's edge, 0.01.
        assert!((h.x - wanted).abs() < 0.02, "{d}: {} {wanted}", h.x);
    }
    println!(
        "rms {} bias {}",
        (square / floor as f64).sqrt(),
        bias / floor as f64
    );
    assert!((bias / floor as f64).abs() < 0.005);
}

/// The floor under a square patch of light, at height 1.
fn patch_over_floor(size: f64, k: usize, emission: Vec3) -> PointCloud {
    let corner = DVec3::new(-0.5 * size, -0.5 * size, 1.0);
    let mut patch = quad(corner, DVec3::Y * size, DVec3::X * size, k, 0.0, 3);
    patch.emission.fill(emission);
    joined([floor(20), patch])
}

/// Form factor from a place under a rectangle parallel to it to that rectangle (Howell B-3, by
/// corners with signs).
fn parallel(x: DVec3, half: f64, height: f64) -> f64 {
    let corner = |a: f64, b: f64| {
        let (x, y) = (a / height, b / height);
        let (p, q) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        (x / p * (y / p).atan() + y / q * (x / q).atan()) / (2.0 * PI)
    };
    let (r, l, t, b) = (half - x.x, half + x.x, half - x.y, half + x.y);
    corner(r, t) + corner(l, t) + corner(r, b) + corner(l, b)
}

#[test]
fn patches_of_light_have_their_closed_form() {
    for (size, k) in [(0.1, 1), (0.1, 4), (0.4, 10), (0.8, 30)] {
        let mut cloud = patch_over_floor(size, k, Vec3::new(1.0, 0.5, 0.0));
        let patch = size * size / (k * k) as f64;
        cloud.areas = vec![0.0025; 400];
        cloud.areas.resize(cloud.len(), patch as f32);
        let s = surfels(&cloud);
        let occluders = Occluders::build(&s);
        let visibility = CpuVisibility::<f32>::new(&occluders);
        let h = emitters(&s, TOLERANCE, 1, &visibility, &Silent).expect("lit");
        let mut worst = 0.0_f64;
        for (i, h) in h.iter().enumerate().take(400) {
            let wanted = parallel(place(&s, i) * DVec3::new(1.0, 1.0, 0.0), 0.5 * size, 1.0);
            worst = worst.max((h.x / wanted - 1.0).abs());
            assert!((h.y - 0.5 * h.x).abs() < 1e-9 && h.z == 0.0);
        }
        println!("{size} {k}: {worst}");
        // Far pairs are points: (size / k)² / 6 of the distance's square, and clusters 0.7 * 0.0045;
        // jittered points in equal areas shift the light by a part of their spacing.
        assert!(worst < 0.02, "{size} {k}: {worst}");
    }
}

fn rel(found: &[DVec3], wanted: &[DVec3]) -> f64 {
    let square = |v: f64, w: &DVec3| v + w.length_squared();
    let off: Vec<DVec3> = found.iter().zip(wanted).map(|(a, b)| *a - *b).collect();
    (off.iter().fold(0.0, square) / wanted.iter().fold(0.0, square)).sqrt()
}

/// A closed room with a bright ceiling: many emitters, near and far, unoccluded and not.
#[test]
fn many_emitters_are_as_good_as_the_sum_of_each() {
    let mut cloud = cube(20, 0.5, true, 1);
    for (e, p) in cloud.emission.iter_mut().zip(&cloud.positions) {
        if p.z == 1.0 {
            *e = Vec3::new(1.0, p.x as f32, 0.2);
        }
    }
    let column = joined([
        quad(
            DVec3::new(0.4, 0.4, 0.0),
            DVec3::Z * 0.6,
            DVec3::Y * 0.2,
            10,
            0.5,
            2,
        ),
        quad(
            DVec3::new(0.4, 0.4, 0.0),
            DVec3::X * 0.2,
            DVec3::Z * 0.6,
            10,
            0.5,
            3,
        ),
    ]);
    let s = surfels(&joined([cloud, column]));
    let all: Vec<usize> = (0..s.len()).collect();
    let emission: Vec<DVec3> = s.emission.iter().map(|e| e.as_dvec3()).collect();
    let wanted = |v: &dyn Visibility| -> Vec<DVec3> {
        let rows = exact_irradiance(&s, v, &all, &emission).expect("exact");
        rows.into_iter().map(|(h, _)| h).collect()
    };
    // Nothing in the way: clusters of opening 0.067 are wrong by at most 0.7 opening² = 0.3%.
    let open = emitters(&s, TOLERANCE, 1, &NothingInTheWay, &Silent).expect("lit");
    let off = rel(&open, &wanted(&NothingInTheWay));
    println!("open: {off}");
    assert!(off < 0.002, "{off}");
    let occluders = Occluders::build(&s);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let shaded = emitters(&s, TOLERANCE, 1, &visibility, &Silent).expect("lit");
    let off = rel(&shaded, &wanted(&visibility));
    println!("shaded: {off}");
    assert!(off < TOLERANCE, "{off}");
}

/// An emitter next to its receiver is a cell, as everywhere in the operator.
/// Sums of light that are 10¹⁵ times as bright must not swallow the dim ones.
#[test]
fn dim_emitters_shine_beside_bright_ones() {
    let patch = |corner: DVec3, emission: f32| {
        let mut patch = quad(corner, DVec3::Y * 0.1, DVec3::X * 0.1, 10, 0.0, 3);
        patch.emission.fill(Vec3::splat(emission));
        patch
    };
    let dim = patch_over_floor(0.1, 10, Vec3::ONE);
    // Behind the floor, and on either side of the dim ones in any order.
    let bright = [-0.5, 0.5].map(|x| patch(DVec3::new(x, 0.0, -1.0), 1e15));
    let both = joined([bright[0].clone(), dim.clone(), bright[1].clone()]);
    let of = |cloud: &PointCloud| {
        let s = surfels(cloud);
        let h = emitters(&s, TOLERANCE, 1, &NothingInTheWay, &Silent).expect("lit");
        let floor: Vec<DVec3> = (0..s.len())
            .filter(|&i| place(&s, i).z == 0.0)
            .map(|i| h[i])
            .collect();
        assert_eq!(floor.len(), 400);
        floor
    };
    let off = rel(&of(&both), &of(&dim));
    println!("dim beside bright: {off:.1e}");
    assert!(off < 1e-3);
}

#[test]
fn near_emitters_are_cells() {
    let mut cloud = cube(8, 0.5, true, 1);
    cloud.emission[3] = Vec3::ONE;
    let s = surfels(&cloud);
    let surface = Surface::<f64>::new(&s);
    let h = emitters(&s, TOLERANCE, 1, &NothingInTheWay, &Silent).expect("lit");
    for (i, h) in h.iter().enumerate() {
        let wanted = surface.form_factor(i, 3);
        assert!(
            (h.x - wanted).abs() < 1e-3 * wanted + 1e-12,
            "{i}: {} {wanted}",
            h.x
        );
    }
}

/// A strong blue light of many emitters, and a weak red one, of which half the floor sees nothing.
#[test]
fn each_colour_has_its_own_shadow() {
    let mut blue = quad(DVec3::new(-0.5, -0.5, 1.0), DVec3::Y, DVec3::X, 16, 0.5, 2);
    blue.emission.fill(Vec3::new(0.0, 0.0, 10.0));
    let mut red = quad(
        DVec3::new(-0.9, -0.2, 0.2),
        DVec3::Y * 0.4,
        DVec3::Z * 0.2,
        4,
        0.5,
        3,
    );
    red.emission.fill(Vec3::new(0.5, 0.0, 0.0));
    let wall = quad(
        DVec3::new(0.0, -0.5, 0.0),
        DVec3::Y,
        DVec3::Z * 0.6,
        20,
        0.5,
        4,
    );
    let s = surfels(&joined([floor(20), blue, red, wall]));
    let occluders = Occluders::build(&s);
    let visibility = CpuVisibility::<f32>::new(&occluders);
    let h = emitters(&s, TOLERANCE, 1, &visibility, &Silent).expect("lit");
    let emission: Vec<DVec3> = s.emission.iter().map(|e| e.as_dvec3()).collect();
    let floor: Vec<usize> = (0..400).collect();
    let exact = exact_irradiance(&s, &visibility, &floor, &emission).expect("exact");
    // Measured: red .001, blue .067: half of the 64 segments go to either colour.
    for (c, name, most) in [(0, "red", 0.02), (2, "blue", 0.1)] {
        let of = |h: &DVec3| DVec3::X * h[c];
        let found: Vec<DVec3> = h[..400].iter().map(of).collect();
        let wanted: Vec<DVec3> = exact.iter().map(|(h, _)| of(h)).collect();
        let off = rel(&found, &wanted);
        let sum = |v: &[DVec3]| v.iter().map(|v| v.x).sum::<f64>();
        let bias = sum(&found) / sum(&wanted) - 1.0;
        println!("{name}: {off}, bias {bias}");
        assert!(off < most && bias.abs() < 0.02, "{name}: {off} {bias}");
        // Behind the wall there is no red.
        for i in (0..400).filter(|&i| c == 0 && wanted[i].x == 0.0) {
            assert!(found[i].x < 1e-3, "{}", found[i].x);
        }
    }
}
