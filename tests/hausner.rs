//! The basis of the report against its identities, direct sums and the Cartesian tensors.

mod clouds;

use std::f64::consts::PI;

use clouds::{direction, random};
use fmmgi_gpu::expansion::hausner::{
    Basis, Function, Local, Multipole, SourceMatrix, e, functions, sack_j, spherical_harmonics,
    wigner_3j,
};
use glam::DVec3;
use num_complex::Complex64;
use rand::{Rng, RngExt};

/// Y_l^m in the direction of `v`; 0 where there is none.
fn y(l: i64, m: i64, v: DVec3) -> Complex64 {
    match m.abs() <= l {
        true => spherical_harmonics(l as usize, v)[(l * l + l + m) as usize],
        false => Complex64::ZERO,
    }
}

/// |v|^n
fn power(v: DVec3, n: i64) -> f64 {
    v.length().powi(n as i32)
}

fn sign(k: i64) -> f64 {
    if k % 2 == 0 { 1.0 } else { -1.0 }
}

/// All functions of one n.
fn of(n: i64) -> impl Iterator<Item = Function> {
    functions(n as usize).filter(move |f| f.n == n)
}

#[test]
fn harmonics_have_the_addition_theorem() {
    let mut rng = random(1);
    for _ in 0..20 {
        let (a, b) = (direction(&mut rng), direction(&mut rng));
        // Legendre polynomials of the angle between.
        let (mut before, mut p) = (0.0, 1.0);
        for l in 0..=16 {
            let sum: Complex64 = (-l..=l).map(|m| y(l, m, a) * y(l, m, b).conj()).sum();
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

/// Σ_j3 (2 j3 + 1) (3j)² = 1. Racah's alternating sum loses digits with j: 4e-15 at 16.
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
            assert!((sum - 1.0).abs() < 1e-13, "{j1} {j2}: {sum}");
        }
    }
}

#[test]
fn sacks_theorem_holds() {
    let (a, b) = (DVec3::new(0.04, -0.03, 0.05), DVec3::new(0.6, 0.5, -0.8));
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
            for f in of(k) {
                for l2 in 0..=l + f.l() {
                    let factor = sack_j(f.l(), f.m, l2, f.j, n, m, l);
                    let radial = power(a, k) * power(b, n - k);
                    sum += y(f.l(), f.m, a) * y(l2, m - f.m, b) * (factor * radial);
                }
            }
        }
        let wanted = y(l, m, a + b) * power(a + b, n);
        let error = (sum - wanted).norm() / wanted.norm();
        assert!(error < 1e-11, "{n} {l} {m}: {error:e}");
    }
}

/// Largest error of an identity over all functions up to order 6, relative to the largest value of
/// the same n.
fn identity_error(
    found: impl Fn(Function) -> Complex64,
    wanted: impl Fn(Function) -> Complex64,
) -> f64 {
    (0..=6)
        .map(|n| {
            let worst = |worst: f64, f| worst.max((found(f) - wanted(f)).norm());
            let largest = |largest: f64, f| largest.max(wanted(f).norm());
            of(n).fold(0.0, worst) / of(n).fold(0.0, largest)
        })
        .fold(0.0, f64::max)
}

/// From j_min to j_max of (C.19), for (k, s) and (n, j).
fn limits(f: Function, n: i64, j: i64) -> std::ops::RangeInclusive<i64> {
    0.max(f.j + j - f.n)..=(j - f.j).min(n - f.n + f.j - j)
}

/// (C.20), with `factor` of e_{n-k}^j' and e_n^j.
fn multipole_identity(factor: impl Fn(f64, f64) -> f64) -> f64 {
    let (r, t) = (DVec3::new(0.5, -0.2, 0.4), DVec3::new(0.3, 0.1, -0.25));
    let sum = |Function { n, j, m }: Function| {
        let mut sum = Complex64::ZERO;
        for f in (0..=n).flat_map(of) {
            for j1 in limits(f, n, j) {
                let (k, l) = (f.n, n - f.n - 2 * j1);
                let coupling = sack_j(f.l(), f.m, n - 2 * j, f.j, k - n - 4, m + f.m, l);
                let number = factor(e(n - k, j1), e(n, j)) * coupling;
                let radial = power(t, k) * power(r, n - k);
                sum += y(f.l(), f.m, t) * y(l, f.m + m, r).conj() * (number * radial);
            }
        }
        sum
    };
    identity_error(sum, |f| y(f.l(), f.m, r - t).conj() * power(r - t, f.n))
}

/// (C.31), with the upper index of the last harmonic as `upper` makes it of m₁' - m₁.
fn local_identity(upper: impl Fn(i64) -> i64) -> f64 {
    let (rest, t) = (DVec3::new(0.4, 0.3, -0.1), DVec3::new(-0.2, 0.35, 0.3));
    let sum = |Function { n: k, j: s, m }: Function| {
        let mut sum = Complex64::ZERO;
        for f in (0..=k).flat_map(of) {
            for j1 in limits(f, k, s) {
                let (k1, l) = (f.n, k - f.n - 2 * j1);
                let coupling = sack_j(f.l(), f.m, k - 2 * s, f.j, k1 - k - 4, f.m - m, l);
                let number = sign(k + m) * e(k - k1, j1) / e(k, s) * coupling;
                let radial = power(rest, k1) * power(t, k - k1);
                let last = y(l, upper(f.m - m), -t).conj();
                sum += y(f.l(), f.m, rest) * last * (number * radial);
            }
        }
        sum
    };
    identity_error(sum, |f| y(f.l(), f.m, t + rest) * power(t + rest, f.n))
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

/// P2L has the local basis of M2L: the moments of a source in the centre have n = 0 alone, so that
/// its M2L is exact in all coefficients.
#[test]
fn sources_and_their_moments_have_one_local_expansion() {
    let basis = Basis::new(8);
    let (flux, normal, place) = (
        DVec3::new(1.0, 0.5, 0.2),
        DVec3::new(0.6, 0.0, 0.8),
        DVec3::ONE,
    );
    let mut m = Multipole::new(&basis, place, 0.1);
    m.p2m(flux, normal, place);
    let mut by_moments = Local::new(&basis, DVec3::NEG_X, 0.5);
    let mut directly = by_moments.clone();
    by_moments.m2l(&m, 8, 1.0);
    directly.p2l(flux, normal, place);
    let apart = difference(&by_moments.coefficients, &directly.coefficients);
    println!("{apart:e}");
    assert!(apart < 1e-12, "{apart:e}");
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
    let errors: Vec<f64> = (0..=10).map(|p| chain_error(&Basis::new(p), 1.0)).collect();
    println!("{errors:?}");
    for (p, pair) in errors.windows(2).enumerate() {
        assert!(pair[1] < pair[0], "order {}: {errors:?}", p + 1);
    }
    assert!(errors[8] < 1e-4 && errors[10] < 1e-5, "{errors:?}");
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
    assert_eq!(local(&high, 1.0)[..low.coefficients()], wanted);
    assert_eq!(
        local(&high, 1.0)[low.coefficients()..],
        vec![SourceMatrix::default(); high.coefficients() - low.coefficients()]
    );
    let half: Vec<_> = wanted.iter().map(|c| c.scaled([0.5; 3])).collect();
    assert!(difference(&local(&low, 0.5), &half) < 1e-15);
}
