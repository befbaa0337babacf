//! The operator against form factors in closed form, by exact sums and by links.

mod closed_forms;

use std::f64::consts::{PI, TAU};

use closed_forms::{disc_to_disc, element_to_disc, element_to_sphere, sphere_to_disc};
use fmmgi_gpu::links::{self, Accuracy, Links};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Direct, Fmm, TransportOperator};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{PointCloud, Surfels};
use glam::{DVec3, Vec3};

/// Adds points of equal areas that are `total` together.
fn add(cloud: &mut PointCloud, total: f64, points: Vec<(DVec3, DVec3)>) {
    let area = (total / points.len() as f64) as f32;
    for (place, normal) in points {
        cloud.positions.push(place);
        cloud.normals.push(normal.as_vec3());
        cloud.areas.push(area);
        cloud.reflectance.push(Vec3::ZERO);
        cloud.emission.push(Vec3::ZERO);
    }
}

/// The k-th of n points along a spiral that fills a disc or, in z, a sphere evenly.
fn spiral(k: usize, n: usize) -> (f64, f64) {
    let golden = PI * (5f64.sqrt() - 1.0);
    ((k as f64 + 0.5) / n as f64, golden * k as f64)
}

/// A sphere about the origin, seen from outside (1) or inside (-1).
fn sphere(cloud: &mut PointCloud, radius: f64, side: f64, n: usize) {
    let points = (0..n).map(|k| {
        let (part, angle) = spiral(k, n);
        let z = 1.0 - 2.0 * part;
        let r = (1.0 - z * z).sqrt();
        let out = DVec3::new(r * angle.cos(), r * angle.sin(), z);
        (out * radius, out * side)
    });
    add(cloud, 4.0 * PI * radius * radius, points.collect());
}

/// A disc about the z axis, seen from above (1) or below (-1).
fn disc(cloud: &mut PointCloud, height: f64, radius: f64, side: f64, n: usize) {
    let points = (0..n).map(|k| {
        let (part, angle) = spiral(k, n);
        let r = radius * part.sqrt();
        let place = DVec3::new(r * angle.cos(), r * angle.sin(), height);
        (place, DVec3::Z * side)
    });
    add(cloud, PI * radius * radius, points.collect());
}

/// A point of the cloud that gets light.
struct Lit {
    place: DVec3,
    irradiance: f64,
}

/// A cloud with both operators.
struct Case {
    surfels: Surfels,
    places: Vec<DVec3>,
    direct: Direct,
    octree: Octree,
    links: Links,
}

impl Case {
    /// Links may be off by 0.002 each if all points have radiosity 1.
    fn new(cloud: &PointCloud) -> Case {
        let prepared = Surfels::prepare(cloud, &Silent).unwrap();
        let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
        let occluders = Occluders::build(&surfels);
        let exact = CpuVisibility::<f64>::new(&occluders);
        let ones = vec![DVec3::ONE; surfels.len()];
        let accuracy = Accuracy::new(&octree, &ones, None, 0.002, 1, 1);
        let links = links::build(&surfels, &octree, &accuracy, &exact, &Silent).unwrap();
        let points = surfels.points.iter();
        Case {
            places: points.map(|&i| cloud.positions[i as usize]).collect(),
            direct: Direct::new(&surfels, &exact, &Silent).unwrap(),
            surfels,
            octree,
            links,
        }
    }

    /// What the points get, by exact sums and by links, if some of them have radiosity 1.
    fn lit(&self, shines: impl Fn(DVec3) -> bool) -> [Vec<Lit>; 2] {
        let shining = self.places.iter().map(|&p| f64::from(shines(p)));
        let radiosity: Vec<DVec3> = shining.map(DVec3::splat).collect();
        let fmm = Fmm::<f64>::new(&self.surfels, &self.octree, &self.links);
        let results = [self.direct.apply(&radiosity), fmm.apply(&radiosity)];
        results.map(|irradiance| {
            let points = irradiance.unwrap().into_iter().enumerate();
            let point = points.map(|(i, h)| Lit {
                place: self.places[i],
                irradiance: h.x,
            });
            point.collect()
        })
    }
}

/// Relative L2 error and bias over the points that `truth` has a value for.
fn off(points: &[Lit], truth: impl Fn(&Lit) -> Option<f64>) -> (f64, f64) {
    let pairs = || {
        points
            .iter()
            .filter_map(|p| Some((p.irradiance, truth(p)?)))
    };
    let square: f64 = pairs().map(|(_, t)| t * t).sum();
    let error: f64 = pairs().map(|(h, t)| (h - t).powi(2)).sum();
    let sums = pairs().fold((0.0, 0.0), |s, (h, t)| (s.0 + h, s.1 + t));
    ((error / square).sqrt(), sums.0 / sums.1 - 1.0)
}

/// Holds exact sums and links to bounds of (relative L2, bias), over the points that `truth` has a
/// value for.
fn hold(
    what: &str,
    points: &[Vec<Lit>; 2],
    truth: impl Fn(&Lit) -> Option<f64>,
    bounds: [(f64, f64); 2],
) {
    for ((points, name), bound) in points.iter().zip(["direct", "fmm"]).zip(bounds) {
        let (l2, bias) = off(points, &truth);
        println!("{what}, {name}: relative L2 {l2:.5}, bias {bias:+.5}");
        assert!(l2 < bound.0 && bias.abs() < bound.1, "{what}, {name}");
    }
}

/// The same where the truth is a mean over the points: only their bias counts.
fn hold_mean(
    what: &str,
    points: &[Vec<Lit>; 2],
    truth: impl Fn(&Lit) -> Option<f64>,
    bounds: [f64; 2],
) {
    hold(
        what,
        points,
        truth,
        bounds.map(|bias| (f64::INFINITY, bias)),
    );
}

/// Inside a sphere every place gets the same, whatever part shines: F = A / (4 π r²).
#[test]
fn sphere_cavity() {
    let mut cloud = PointCloud::default();
    sphere(&mut cloud, 1.0, -1.0, 4000);
    let case = Case::new(&cloud);
    for (part, low) in [("a cap", 0.6), ("a half", 0.0), ("the whole", -1.0)] {
        let points = case.lit(|p| p.z > low);
        let what = format!("sphere cavity, {part} shines");
        let truth = 0.5 * (1.0 - low);
        // Measured: up to (0.0011, 5e-4) and (0.0075, 4e-4).
        hold(
            &what,
            &points,
            |_| Some(truth),
            [(0.002, 0.001), (0.015, 0.002)],
        );
    }
}

#[test]
fn coaxial_discs() {
    let (r1, r2, h) = (1.0, 0.6, 0.5);
    let mut cloud = PointCloud::default();
    disc(&mut cloud, 0.0, r1, 1.0, 2500);
    disc(&mut cloud, h, r2, -1.0, 1500);
    let points = Case::new(&cloud).lit(|p| p.z > 0.1);
    let lower = |p: &Lit| p.place.z < 0.1;
    let element = |p: &Lit| lower(p).then(|| element_to_disc(p.place.length(), h, r2));
    let mean = |p: &Lit| lower(p).then(|| disc_to_disc(r1, r2, h));
    // Measured: (4e-4, 5e-6) and (0.0106, 1e-5).
    hold(
        "element to disc",
        &points,
        element,
        [(0.001, 1e-4), (0.02, 0.002)],
    );
    hold_mean("disc to disc", &points, mean, [1e-4, 0.002]);
}

#[test]
fn sphere_over_a_disc() {
    let (h, r) = (1.3, 2.0);
    let mut cloud = PointCloud::default();
    sphere(&mut cloud, 1.0, 1.0, 2000);
    disc(&mut cloud, -h, r, 1.0, 2000);
    let case = Case::new(&cloud);
    let on_disc = |p: DVec3| p.z < -1.1;
    let of_disc = |p: &Lit| on_disc(p.place);
    let element =
        |p: &Lit| of_disc(p).then(|| element_to_sphere(p.place.truncate().length(), h, 1.0));
    let mean = |p: &Lit| (!of_disc(p)).then(|| sphere_to_disc(r, h));
    // Measured: (3e-4, 5e-6) and (0.0086, 4e-4).
    hold(
        "element to sphere",
        &case.lit(|p| !on_disc(p)),
        element,
        [(0.001, 1e-4), (0.02, 0.003)],
    );
    hold_mean("sphere to disc", &case.lit(on_disc), mean, [1e-4, 0.003]);
}

/// The inner sphere (1) sees the outer one (2) only; that sees the inner one and, past it, itself:
/// F₁₂ = 1, F₂₁ = (r₁/r₂)², F₂₂ = 1 - (r₁/r₂)².
#[test]
fn concentric_spheres() {
    let ratio: f64 = 0.5;
    let mut cloud = PointCloud::default();
    sphere(&mut cloud, ratio, 1.0, 1500);
    sphere(&mut cloud, 1.0, -1.0, 3000);
    let case = Case::new(&cloud);
    let is_inner = |p: DVec3| p.length() < 0.75;
    let inner = |p: &Lit| is_inner(p.place).then_some(1.0);
    let outer = |f: f64| move |p: &Lit| (!is_inner(p.place)).then_some(f);
    let of_outer = case.lit(|p| !is_inner(p));
    let of_inner = case.lit(is_inner);
    let (f21, f22) = (ratio * ratio, 1.0 - ratio * ratio);
    // Measured: (1e-4, 5e-6) and (0.0067, 2e-4); with the inner sphere in the way (0.0029, 0.0027)
    // and (0.0082, 0.0026).
    hold(
        "inner to outer sphere",
        &of_outer,
        inner,
        [(0.001, 1e-4), (0.02, 0.003)],
    );
    hold(
        "outer to inner sphere",
        &of_inner,
        outer(f21),
        [(0.001, 1e-4), (0.02, 0.003)],
    );
    // Cells stand out from a convex surface: the inner sphere takes a little too much away.
    hold(
        "outer sphere to itself",
        &of_outer,
        outer(f22),
        [(0.005, 0.005), (0.02, 0.006)],
    );
}

/// What every closed form must keep: F₁₂ A₁ = F₂₁ A₂, and integrals over the surface.
#[test]
fn the_forms_agree_with_each_other() {
    let (r1, r2, h) = (1.3, 0.4, 0.7);
    let there = disc_to_disc(r1, r2, h) * r1 * r1;
    let back = disc_to_disc(r2, r1, h) * r2 * r2;
    assert!((there / back - 1.0).abs() < 1e-12);
    let n = 100_000;
    let rings = (0..n).map(|k| (k as f64 + 0.5) / n as f64);
    let over = |f: &dyn Fn(f64) -> f64, r: f64| -> f64 {
        rings
            .clone()
            .map(|x| f(r * x) * TAU * r * x * r / n as f64)
            .sum()
    };
    let discs = over(&|a| element_to_disc(a, h, r2), r1);
    assert!((discs / (disc_to_disc(r1, r2, h) * PI * r1 * r1) - 1.0).abs() < 1e-8);
    let sphere = over(&|a| element_to_sphere(a, h, 0.5), r1);
    assert!((sphere / (sphere_to_disc(r1, h) * 4.0 * PI * 0.25) - 1.0).abs() < 1e-8);
}
