//! Bounds of the expansions' error against true errors.

mod clouds;
mod clusters;

use std::f64::consts::PI;

use clouds::{direction, random};
use clusters::Cluster;
use fmmgi_gpu::expansion::{
    Indices, Workspace, coefficients, expected_error, least_order, remainder,
};
use glam::DVec3;
use rand::{Rng, RngExt};

#[derive(Clone, Copy, Debug)]
enum Shape {
    /// Places anywhere in the ball, normals about an axis.
    Ball,
    /// A square lattice with one normal.
    Flat,
    /// A row of surfels.
    Thin,
    /// Four surfels anywhere on a square.
    Few,
    /// Two clusters at opposite ends.
    Ends,
    /// On the line between both centres, with normals along it.
    Line,
}

/// A facet of this radius about the mean of its places, which is its centre, towards `axis`.
fn facet(rng: &mut impl Rng, shape: Shape, centre: DVec3, axis: DVec3, radius: f64) -> Cluster {
    let mut c = Cluster::ball(rng, DVec3::ZERO, axis, 1.0, 36);
    let t = axis.any_orthonormal_vector();
    let b = axis.cross(t);
    let flat = |c: &mut Cluster, count: usize, place: &mut dyn FnMut(usize) -> DVec3| {
        c.places = (0..count).map(place).collect();
        c.normals = vec![axis; count];
        c.flux.truncate(count);
    };
    let grid = |k: usize, n: usize| k as f64 / (n - 1) as f64 - 0.5;
    let mut random = || rng.random_range(-1.0..1.0);
    match shape {
        Shape::Ball => {}
        Shape::Flat => flat(&mut c, 36, &mut |k| t * grid(k / 6, 6) + b * grid(k % 6, 6)),
        Shape::Thin => flat(&mut c, 36, &mut |k| t * grid(k, 36)),
        Shape::Few => flat(&mut c, 4, &mut |_| t * random() + b * random()),
        Shape::Ends => c.places.iter_mut().enumerate().for_each(|(k, p)| {
            *p = *p * 0.1 + t * if k % 2 == 0 { 1.0 } else { -1.0 };
        }),
        Shape::Line => flat(&mut c, 3, &mut |k| axis * grid(k, 3)),
    }
    let middle = c.places.iter().sum::<DVec3>() / c.places.len() as f64;
    let reach = c
        .places
        .iter()
        .map(|p| p.distance(middle))
        .fold(0.0, f64::max);
    for p in &mut c.places {
        *p = centre + (*p - middle) * (radius / reach);
    }
    c.centre = centre;
    c
}

/// Errors of an M2L at the places of the target, and the light there.
fn errors(order: usize, source: &Cluster, target: &Cluster, radii: [f64; 2]) -> Vec<[f64; 2]> {
    let indices = Indices::new(order);
    let mut w = Workspace::<f64>::new(&indices);
    let moments = source.moments(&mut w, order, source.centre, radii[0]);
    let mut local = vec![DVec3::ZERO; coefficients(order)];
    let way = target.centre - source.centre;
    w.m2l(order, &moments, way, radii, 1.0, &mut local);
    let places = target.places.iter().zip(&target.normals);
    places
        .map(|(x, n)| {
            let wanted = source.light(*x, *n);
            let found = w.l2p(&local, *n, (*x - target.centre) / radii[1]);
            [(found - wanted).length(), wanted.length()]
        })
        .collect()
}

fn power(c: &Cluster) -> f64 {
    c.flux.iter().map(|f| f.length()).sum()
}

/// No error at any place exceeds the bound, and where sources and receiver lie on one line it is
/// reached: nothing smaller would do.
#[test]
fn the_bound_holds_and_is_sharp() {
    let mut rng = random(1);
    use Shape::{Ball, Ends, Few, Flat, Line, Thin};
    for shape in [Ball, Flat, Thin, Few, Ends, Line] {
        for order in [0, 1, 2, 3, 6, 9] {
            let mut closest = 0.0_f64;
            for round in 0..60 {
                let opening = [0.15, 0.4, 0.7][round % 3];
                let part = rng.random_range(0.1..0.9);
                let radii = [opening * part, opening * (1.0 - part)];
                let u = direction(&mut rng);
                let [a, b] = match shape {
                    Line => [u, -u],
                    _ => [(); 2].map(|_| direction(&mut rng)),
                };
                let mut source = facet(&mut rng, shape, DVec3::ZERO, a, radii[0]);
                if let Line = shape {
                    // All light from one place, at the end towards the target.
                    source.flux[..2].fill(DVec3::ZERO);
                }
                let target = facet(&mut rng, shape, u, b, radii[1]);
                let bound = power(&source) / PI * remainder(order, opening);
                for [error, light] in errors(order, &source, &target, radii) {
                    let rounding = 1e-14 * light.max(power(&source));
                    assert!(
                        error <= bound + rounding,
                        "{shape:?} {order}: {error} {bound}"
                    );
                    closest = closest.max((error - rounding) / bound);
                }
            }
            println!("{shape:?}, order {order}: up to {closest:.3} of the bound");
            // Measured: 0.04 (thin, order 9) to 0.6 (balls, order 0).
            let least = if let Line = shape { 0.999 } else { 0.02 };
            assert!(closest > least, "{shape:?} {order}: {closest}");
        }
    }
}

/// Root mean square over pairs that face each other, as a part of the light, against what is
/// expected: for surfaces of many surfels and of few, for sizes that differ. Measured: 0.7 to 1.8
/// times and 0.8 to 3.8 times.
#[test]
fn errors_are_those_expected() {
    let mut rng = random(2);
    for (shape, least, most) in [(Shape::Flat, 0.5, 2.2), (Shape::Few, 0.6, 4.5)] {
        for order in 0..=6 {
            for opening in [0.2, 0.5] {
                for part in [0.5, 0.67, 0.98] {
                    let radii = [opening * (1.0 - part), opening * part];
                    let (mut wrong, mut all) = (0.0, 0.0);
                    for _ in 0..150 {
                        let u = direction(&mut rng);
                        let mut towards = |v: DVec3| loop {
                            let d = direction(&mut rng);
                            if d.dot(v) > 0.1 {
                                return d;
                            }
                        };
                        let (a, b) = (towards(u), towards(-u));
                        let source = facet(&mut rng, shape, DVec3::ZERO, a, radii[0]);
                        let target = facet(&mut rng, shape, u, b, radii[1]);
                        let weight = (target.places.len() as f64).sqrt() * power(&source);
                        for [error, light] in errors(order, &source, &target, radii) {
                            wrong += (error / weight).powi(2);
                            all += (light / weight).powi(2);
                        }
                    }
                    let found = f64::sqrt(wrong / all);
                    let ratio = found / expected_error(order, radii[0], radii[1]);
                    println!("{shape:?} {order} {opening} {part}: {found:.1e} {ratio:.2}");
                    assert!((least..most).contains(&ratio), "{shape:?} {order}: {ratio}");
                }
            }
        }
    }
}

#[test]
fn the_least_order_keeps_what_is_allowed() {
    // Σ (m + 1) θ^m, summed.
    for order in 0..=12 {
        for opening in [0.0, 0.1, 0.5, 0.9] {
            let degrees = order + 1..order + 2000;
            let sum: f64 = degrees
                .map(|m| (m + 1) as f64 * f64::powi(opening, m as i32))
                .sum();
            let found = remainder(order, opening);
            assert!(
                (found - sum).abs() <= 1e-10 * sum,
                "{order} {opening}: {found} {sum}"
            );
        }
    }
    assert_eq!(remainder(3, 1.0), f64::INFINITY);
    for opening in [0.1, 0.3, 0.6] {
        for allowed in [1e-1, 1e-3, 1e-5] {
            let error = |p| remainder(p, opening);
            match least_order(6, allowed, error) {
                Some(p) => {
                    assert!(error(p) <= allowed);
                    assert!(p == 0 || error(p - 1) > allowed);
                }
                None => assert!(error(6) > allowed),
            }
        }
    }
    assert_eq!(least_order(6, 1e-9, |p| remainder(p, 0.5)), None);
    assert_eq!(least_order(6, 1e-9, |p| remainder(p, 0.0)), Some(0));
}
