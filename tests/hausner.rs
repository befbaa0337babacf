//! The basis of the report against its identities, direct sums and the Cartesian tensors.

mod clouds;

use std::f64::consts::PI;

use clouds::{direction, random};
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::expansion::hausner::{
    Basis, Local, Multipole, SourceMatrix, e, functions, j, spherical_harmonics, wigner_3j,
};
use fmmgi_gpu::links::{Entry, Links, Rows};
use fmmgi_gpu::octree::{Facet, Octree};
use fmmgi_gpu::operator::{Hausner, TransportOperator};
use glam::DVec3;
use num_complex::Complex64;
use rand::{Rng, RngExt};

/// Y_l^m in the direction of `v`; 0 where there is none.
fn y(l: usize, m: i64, v: DVec3) -> Complex64 {
    match m.unsigned_abs() as usize <= l {
        true => spherical_harmonics(l, v)[((l * l + l) as i64 + m) as usize],
        false => Complex64::ZERO,
    }
}

fn sign(k: i64) -> f64 {
    if k % 2 == 0 { 1.0 } else { -1.0 }
}

/// (l, m) with |m| ≤ l, for l = k - 2s.
fn harmonics_of(k: usize) -> impl Iterator<Item = (usize, usize, i64)> {
    functions(k).filter(move |f| f.0 == k)
}

#[test]
fn harmonics_have_the_addition_theorem() {
    let mut rng = random(1);
    for _ in 0..20 {
        let (a, b) = (direction(&mut rng), direction(&mut rng));
        // Legendre polynomials of the angle between.
        let (mut before, mut p) = (0.0, 1.0);
        for l in 0..=16 {
            let sum: Complex64 = (-(l as i64)..=l as i64)
                .map(|m| y(l, m, a) * y(l, m, b).conj())
                .sum();
            let wanted = (2 * l + 1) as f64 / (4.0 * PI) * p;
            assert!((sum - wanted).norm() < 1e-13, "{l}: {sum}, not {wanted}");
            let next = ((2 * l + 1) as f64 * a.dot(b) * p - l as f64 * before) / (l + 1) as f64;
            (before, p) = (p, next);
        }
    }
    let v = DVec3::new(0.6, 0.0, 0.8);
    let one = -(3.0 / (8.0 * PI)).sqrt() * 0.6;
    assert!((y(1, 1, v).re - one).abs() < 1e-15, "Condon-Shortley phase");
}

/// Σ_j3 (2 j3 + 1) (3j)² = 1. Racah's alternating sum loses digits with j: 3e-13 at 16.
#[test]
fn wigner_3j_symbols_are_complete() {
    for (j1, j2) in [(0, 3), (1, 1), (2, 5), (6, 6), (8, 16), (16, 16)] {
        for (m1, m2) in [(0, 0), (j1, -j2), (j1 / 2, j2 / 3), (-j1, j2 / 2)] {
            let sum: f64 = (0..=j1 + j2)
                .map(|j3| {
                    let w = wigner_3j([j1, j2, j3], [m1, m2, -m1 - m2]);
                    (2 * j3 + 1) as f64 * w * w
                })
                .sum();
            println!("{j1} {j2} {m1} {m2} {:e}", sum - 1.0);
            assert!((sum - 1.0).abs() < 1e-10, "{j1} {j2}: {sum}");
        }
    }
}

#[test]
fn sacks_theorem_holds() {
    let (a, b) = (DVec3::new(0.04, -0.03, 0.05), DVec3::new(0.6, 0.5, -0.8));
    let r = a + b;
    for (n, l, m) in [
        (-4, 0, 0),
        (-5, 1, 1),
        (-6, 2, -1),
        (-6, 0, 0),
        (-7, 3, 2),
        (2, 2, 1),
    ] {
        let mut sum = Complex64::ZERO;
        for k in 0..=11 {
            for (_, s, m1) in harmonics_of(k) {
                let l1 = k - 2 * s;
                for l2 in 0..=l + l1 {
                    let factor = j([l1 as i64, m1], l2 as i64, s as i64, n, [m, l as i64]);
                    sum += y(l1, m1, a)
                        * y(l2, m - m1, b)
                        * (factor
                            * a.length().powi(k as i32)
                            * b.length().powi(n as i32 - k as i32));
                }
            }
        }
        let wanted = y(l, m, r) * r.length().powi(n as i32);
        let error = (sum - wanted).norm() / wanted.norm();
        assert!(error < 1e-11, "{n} {l} {m}: {error:e}");
    }
}

/// Largest error of an identity over all functions (n, j, m) up to order 6, relative to the largest
/// value of the same n.
fn identity_error(
    found: impl Fn(usize, usize, i64) -> Complex64,
    wanted: impl Fn(usize, usize, i64) -> Complex64,
) -> f64 {
    (0..=6)
        .map(|n| {
            let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
            for (n, j, m) in harmonics_of(n) {
                let value = wanted(n, j, m);
                worst = worst.max((found(n, j, m) - value).norm());
                largest = largest.max(value.norm());
            }
            worst / largest
        })
        .fold(0.0, f64::max)
}

/// From j_min to j_max of (C.19).
fn limits(k: usize, s: usize, n: usize, j: usize) -> std::ops::Range<usize> {
    let low = (s + j).saturating_sub(k);
    let high = (j + 1)
        .saturating_sub(s)
        .min((n + s + 1).saturating_sub(k + j));
    low..high
}

/// (C.20), with `factor` of e_{n-k}^j' and e_n^j.
fn multipole_identity(factor: impl Fn(f64, f64) -> f64) -> f64 {
    let (r, t) = (DVec3::new(0.5, -0.2, 0.4), DVec3::new(0.3, 0.1, -0.25));
    let moved = r - t;
    let sum = |n: usize, j0: usize, m: i64| {
        let mut sum = Complex64::ZERO;
        for k in 0..=n {
            for (_, s, m1) in harmonics_of(k) {
                for j1 in limits(k, s, n, j0) {
                    let (l1, l2, l) = (k - 2 * s, n - 2 * j0, n - k - 2 * j1);
                    let coupling = j(
                        [l1 as i64, m1],
                        l2 as i64,
                        s as i64,
                        k as i64 - n as i64 - 4,
                        [m + m1, l as i64],
                    );
                    let radial = t.length().powi(k as i32) * r.length().powi((n - k) as i32);
                    sum += y(l1, m1, t)
                        * y(l, m1 + m, r).conj()
                        * (factor(e(n - k, j1), e(n, j0)) * coupling * radial);
                }
            }
        }
        sum
    };
    identity_error(sum, |n, j0, m| {
        y(n - 2 * j0, m, moved).conj() * moved.length().powi(n as i32)
    })
}

/// (C.31), with the upper index of the last harmonic as `upper` makes it of m₁' - m₁.
fn local_identity(upper: impl Fn(i64) -> i64) -> f64 {
    let (rest, t) = (DVec3::new(0.4, 0.3, -0.1), DVec3::new(-0.2, 0.35, 0.3));
    let (whole, back) = (t + rest, -t);
    let sum = |k: usize, s: usize, m: i64| {
        let mut sum = Complex64::ZERO;
        for k1 in 0..=k {
            for (_, s1, m1) in harmonics_of(k1) {
                for j1 in limits(k1, s1, k, s) {
                    let (l1, l2, l) = (k1 - 2 * s1, k - 2 * s, k - k1 - 2 * j1);
                    let coupling = j(
                        [l1 as i64, m1],
                        l2 as i64,
                        s1 as i64,
                        k1 as i64 - k as i64 - 4,
                        [m1 - m, l as i64],
                    );
                    let radial = rest.length().powi(k1 as i32) * t.length().powi((k - k1) as i32);
                    sum += y(l1, m1, rest)
                        * y(l, upper(m1 - m), back).conj()
                        * (sign(k as i64 + m) * e(k - k1, j1) / e(k, s) * coupling * radial);
                }
            }
        }
        sum
    };
    identity_error(sum, |k, s, m| {
        y(k - 2 * s, m, whole) * whole.length().powi(k as i32)
    })
}

/// The finite sums (C.20) and (C.31) are exact as corrected, and not as printed.
#[test]
fn finite_identities_need_their_corrections() {
    let corrected = [multipole_identity(|a, b| a / b), local_identity(|m| m)];
    let printed = [multipole_identity(|_, _| 1.0), local_identity(|m| -m)];
    println!("corrected {corrected:?}, printed {printed:?}");
    assert!(corrected.iter().all(|&e| e < 1e-12), "{corrected:?}");
    assert!(printed.iter().all(|&e| e > 0.05), "{printed:?}");
}

/// A surfel: flux, normal, position.
type Surfel = (DVec3, DVec3, DVec3);

/// `n` surfels within `radius` of `centre`, of any direction.
fn ball(rng: &mut impl Rng, centre: DVec3, radius: f64, n: usize) -> Vec<Surfel> {
    (0..n)
        .map(|_| {
            let place = direction(rng) * (radius * rng.random::<f64>().cbrt());
            let mut flux = || rng.random_range(0.2..1.0) * radius * radius;
            let flux = DVec3::new(flux(), flux(), flux());
            (flux, direction(rng), centre + place)
        })
        .collect()
}

/// Irradiance without clamp: the truth.
fn exact(sources: &[Surfel], normal: DVec3, x: DVec3) -> DVec3 {
    let light = |&(flux, n, y): &Surfel| {
        let r = y - x;
        let r2 = r.length_squared();
        flux * (-normal.dot(r) * n.dot(r) / (PI * r2 * r2))
    };
    sources.iter().map(light).sum()
}

fn multipole<'a>(basis: &'a Basis, sources: &[Surfel], centre: DVec3, scale: f64) -> Multipole<'a> {
    let mut m = Multipole::new(basis, centre, scale);
    for &(flux, normal, y) in sources {
        m.p2m(flux, normal, y);
    }
    m
}

/// Relative L2 error of irradiances at receivers.
fn light_error(
    sources: &[Surfel],
    receivers: &[Surfel],
    found: impl Fn(DVec3, DVec3) -> DVec3,
) -> f64 {
    let (mut wrong, mut all) = (0.0, 0.0);
    for &(_, n, x) in receivers {
        let wanted = exact(sources, n, x);
        wrong += (found(n, x) - wanted).length_squared();
        all += wanted.length_squared();
    }
    f64::sqrt(wrong / all)
}

/// Largest difference of coefficients, relative to the largest coefficient.
fn difference(a: &[SourceMatrix], b: &[SourceMatrix]) -> f64 {
    let numbers = |c: &[SourceMatrix]| -> Vec<f64> {
        c.iter()
            .flat_map(|c| c.0.into_iter().flatten().flat_map(|v| v.to_array()))
            .collect()
    };
    let (a, b) = (numbers(a), numbers(b));
    let largest = b.iter().fold(0.0, |l, x| x.abs().max(l));
    let apart = a.iter().zip(&b).fold(0.0, |l, (x, y)| (x - y).abs().max(l));
    apart / largest
}

/// One interaction at an opening (sum of the radii over the distance): errors of P2M-M2P (C.7), of
/// P2L-L2P (C.11) and of P2M-M2L-L2P (C.30).
fn interactions(basis: &Basis, opening: f64) -> [f64; 3] {
    let mut rng = random(2);
    let x0 = DVec3::new(1.0, -2.0, 2.0) / 3.0;
    let [near, far] = [opening, 0.5 * opening].map(|radius| {
        let sources = ball(&mut rng, DVec3::ZERO, radius, 30);
        (sources, ball(&mut rng, x0, radius, 30), radius)
    });
    let (sources, _, radius) = &near;
    let receivers: Vec<Surfel> = (0..30)
        .map(|_| (DVec3::ONE, direction(&mut rng), direction(&mut rng)))
        .collect();
    let m = multipole(basis, sources, DVec3::ZERO, *radius);
    let m2p = light_error(sources, &receivers, |n, x| m.m2p(n, x));

    // The same the other way round: sources on a sphere around the receivers.
    let mut l = Local::new(basis, DVec3::ZERO, *radius);
    for &(flux, n, y) in &receivers {
        l.p2l(flux, n, y);
    }
    let p2l = light_error(&receivers, sources, |n, x| l.l2p(n, x));

    let (sources, receivers, radius) = &far;
    let m = multipole(basis, sources, DVec3::ZERO, *radius);
    let mut l = Local::new(basis, x0, *radius);
    l.m2l(&m, basis.order(), 1.0);
    let m2l = light_error(sources, receivers, |n, x| l.l2p(n, x));
    [m2p, p2l, m2l]
}

/// The terms of order n are at most C_n^(2)(1) = (n+1)(n+2)(n+3)/6 times opening^n / |x|^4: from
/// order 2 to order 8 the rest falls by 11^(1/6) = 1.5 times the opening an order, or faster where
/// directions differ. Measured: 0.5 to 1.3 times.
#[test]
fn interactions_converge_at_the_rate_of_the_opening() {
    for opening in [0.4, 0.2] {
        let errors: Vec<_> = (0..=8)
            .map(|p| interactions(&Basis::new(p), opening))
            .collect();
        println!("{opening}: {errors:?}");
        for way in 0..3 {
            let rate = (errors[8][way] / errors[2][way]).powf(1.0 / 6.0);
            assert!(
                (0.4 * opening..1.5 * opening).contains(&rate),
                "{way}, {opening}: {rate}"
            );
        }
    }
    let found = interactions(&Basis::new(8), 0.02);
    println!("{found:?}");
    assert!(found.iter().all(|&e| e < 1e-10), "{found:?}");
}

/// M2M and L2L are exact: moments about another centre are those of the surfels themselves, a local
/// expansion about another centre is the same function.
#[test]
fn translations_to_parents_and_children_are_exact() {
    let mut rng = random(3);
    let basis = Basis::new(8);
    let (o, o1) = (DVec3::new(0.1, 0.2, -0.3), DVec3::new(-0.2, 0.4, 0.1));
    let sources = ball(&mut rng, o, 0.4, 20);
    let mut parent = Multipole::new(&basis, o1, 1.0);
    parent.m2m(&multipole(&basis, &sources, o, 0.3));
    let whole = multipole(&basis, &sources, o1, 1.0);
    let moments = difference(&parent.coefficients, &whole.coefficients);

    let far = ball(&mut rng, DVec3::new(4.0, 0.0, 3.0), 1.0, 10);
    let mut above = Local::new(&basis, o, 1.0);
    far.iter().for_each(|&(f, n, y)| above.p2l(f, n, y));
    let mut below = Local::new(&basis, o1, 0.25);
    below.l2l(&above);
    let places = ball(&mut rng, o1, 0.25, 20);
    let (mut apart, mut largest) = (0.0_f64, 0.0_f64);
    for &(_, n, x) in &places {
        apart = apart.max((below.l2p(n, x) - above.l2p(n, x)).length());
        largest = largest.max(above.l2p(n, x).length());
    }
    println!("{moments:e} {:e}", apart / largest);
    assert!(moments < 1e-12, "{moments:e}");
    assert!(apart < 1e-12 * largest, "{:e}", apart / largest);
}

/// P2M, M2M, M2L, L2L, L2P between two pairs of clusters, at an opening of 0.5 of the parents.
fn chain_error(basis: &Basis, unit: f64) -> f64 {
    let mut rng = random(4);
    let x0 = DVec3::new(2.0, -1.0, 2.0) / 3.0;
    let children = [0.12, -0.12].map(|d| DVec3::new(d, 0.5 * d, -d));
    let radius = 0.07;
    let mut parent = Multipole::new(basis, DVec3::ZERO, 0.25 * unit);
    let mut sources = Vec::new();
    for centre in children {
        let some = ball(&mut rng, centre * unit, radius * unit, 15);
        parent.m2m(&multipole(basis, &some, centre * unit, radius * unit));
        sources.extend(some);
    }
    let mut above = Local::new(basis, x0 * unit, 0.25 * unit);
    above.m2l(&parent, basis.order(), 1.0);
    let (mut wrong, mut all) = (0.0, 0.0);
    for centre in children.map(|c| (x0 + c) * unit) {
        let mut below = Local::new(basis, centre, radius * unit);
        below.l2l(&above);
        for (_, n, x) in ball(&mut rng, centre, radius * unit, 15) {
            let wanted = exact(&sources, n, x);
            wrong += (below.l2p(n, x) - wanted).length_squared();
            all += wanted.length_squared();
        }
    }
    f64::sqrt(wrong / all)
}

#[test]
fn the_chain_converges_at_every_scale() {
    let errors: Vec<f64> = (0..=8).map(|p| chain_error(&Basis::new(p), 1.0)).collect();
    println!("{errors:?}");
    for (p, pair) in errors.windows(2).enumerate() {
        assert!(pair[1] < pair[0], "order {}: {errors:?}", p + 1);
    }
    assert!(errors[8] < 1e-4, "{errors:?}");
    let basis = Basis::new(6);
    for unit in [1e-5, 1e5] {
        let found = chain_error(&basis, unit);
        assert!((found / errors[6] - 1.0).abs() < 1e-6, "{unit}: {found}");
    }
}

#[test]
fn lower_orders_are_the_beginning_of_higher_ones() {
    let mut rng = random(5);
    let x0 = DVec3::new(0.3, 1.0, -0.4);
    let sources = ball(&mut rng, DVec3::ZERO, 0.3, 5);
    let local = |basis: &Basis, fraction: f64| {
        let mut l = Local::new(basis, x0, 0.2);
        let m = multipole(basis, &sources, DVec3::ZERO, 0.3);
        l.m2l(&m, 3, fraction);
        l.coefficients
    };
    let (low, high) = (Basis::new(3), Basis::new(5));
    let wanted = local(&low, 1.0);
    assert_eq!(local(&high, 1.0)[..low.len()], wanted);
    assert_eq!(
        local(&high, 1.0)[low.len()..],
        vec![SourceMatrix::default(); high.len() - low.len()]
    );
    let half: Vec<_> = wanted.iter().map(|c| c.scaled([0.5; 3])).collect();
    assert!(difference(&local(&low, 0.5), &half) < 1e-15);
}

/// Links between all facets: split until their spheres, together, are `opening` of their distance.
/// Separated pairs go by M2L, M2P or P2L in turn, pairs of leaves by P2P or surfel by surfel.
fn all_links(octree: &Octree, surface: &Surface<f64>, order: usize, opening: f32) -> Links {
    let facets = &octree.facets;
    let mut kinds: [Vec<Entry>; 5] = Default::default();
    let mut pairs = vec![(0, 0)];
    while let Some((t, s)) = pairs.pop() {
        let (target, source): (&Facet, &Facet) = (&facets[t], &facets[s]);
        let radii = target.radius + source.radius;
        let entry = |target: usize, source: usize, weight: f64| Entry {
            target: target as u32,
            source: source as u32,
            weight: weight as f32,
        };
        if radii < opening * target.centre.distance(source.centre) {
            kinds[(t + s) % 3].push(entry(t, s, 1.0));
        } else if target.is_leaf() && source.is_leaf() {
            if (t + s) % 2 == 0 {
                kinds[3].push(entry(t, s, 1.0));
            } else {
                let all = target
                    .surfels()
                    .flat_map(|i| source.surfels().map(move |j| (i, j)));
                kinds[4].extend(all.map(|(i, j)| entry(i, j, surface.point_form_factor(i, j))));
            }
        } else if source.is_leaf() || (!target.is_leaf() && target.radius > source.radius) {
            pairs.extend(target.children().map(|c| (c as usize, s)));
        } else {
            pairs.extend(source.children().map(|c| (t, c as usize)));
        }
    }
    assert!(kinds.iter().all(|k| k.len() > 100));
    let [m2l, m2p, p2l, p2p, near] = kinds;
    let n = facets.len();
    let mut links = Links::none(n, surface.len());
    links.m2l = vec![Rows::none(n); order];
    links.m2l.push(Rows::new(n, m2l));
    links.m2p = Rows::new(n, m2p);
    links.p2l = Rows::new(n, p2l);
    links.p2p = Rows::new(n, p2p);
    links.near = Rows::new(surface.len(), near);
    links
}

/// In a convex room all surfels face each other: the clamp changes nothing, and the operator is the
/// sum over all pairs.
#[test]
fn the_operator_converges_to_the_sum_over_all_pairs() {
    let shape = DVec3::new(1.0, 0.6, 1.4);
    let mut room = clouds::sphere(1500, 0.5, true, 6);
    for (p, n) in room.positions.iter_mut().zip(&mut room.normals) {
        *n = (n.as_dvec3() / shape).normalize().as_vec3();
        *p *= shape;
    }
    let (octree, surfels) = Octree::build(&clouds::surfels(&room), 12);
    let surface = Surface::<f64>::new(&surfels);
    let mut rng = random(7);
    let radiosity: Vec<DVec3> = (0..surfels.len())
        .map(|_| DVec3::new(rng.random(), rng.random(), 1.0))
        .collect();
    let wanted: Vec<DVec3> = (0..surfels.len())
        .map(|i| {
            let pair = |(j, &b): (usize, &DVec3)| b * surface.point_form_factor(i, j);
            radiosity.iter().enumerate().map(pair).sum()
        })
        .collect();
    let errors = [0, 2, 4, 6].map(|order| {
        let links = all_links(&octree, &surface, order, 0.5);
        let operator = Hausner::new(&surfels, &octree, &links, order);
        let found = operator.apply(&radiosity).expect("applied");
        let wrong: f64 = found
            .iter()
            .zip(&wanted)
            .map(|(a, b)| (*a - *b).length_squared())
            .sum();
        let all: f64 = wanted.iter().map(|b| b.length_squared()).sum();
        (wrong / all).sqrt()
    });
    println!("{errors:?}");
    // A sampled link from root to root: its weight times the power of all.
    let mut links = Links::none(octree.facets.len(), surfels.len());
    links.sampled = Rows::new(
        octree.facets.len(),
        vec![Entry {
            target: 0,
            source: 0,
            weight: 0.5,
        }],
    );
    let found = Hausner::new(&surfels, &octree, &links, 0)
        .apply(&radiosity)
        .expect("applied");
    let power: DVec3 = radiosity
        .iter()
        .zip(&surface.areas)
        .map(|(b, a)| *b * *a)
        .sum();
    assert!(
        found
            .iter()
            .all(|h| (*h - 0.5 * power).length() < 1e-12 * power.length())
    );
}
