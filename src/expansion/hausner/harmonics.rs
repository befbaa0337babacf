//! Spherical harmonics and what couples three of them.

use std::f64::consts::PI;

use glam::DVec3;
use num_complex::Complex64;

/// Orthonormal Y_l^m, with the Condon-Shortley phase, in the direction of `v` for all l up to
/// `order`; that of (l, m) is number l² + l + m. Where `v` is zero: along z.
pub fn spherical_harmonics(order: usize, v: DVec3) -> Vec<Complex64> {
    let u = v.normalize_or(DVec3::Z);
    let mut y = vec![Complex64::ZERO; (order + 1) * (order + 1)];
    let at = |l: usize, m: usize| l * l + l + m;
    y[0] = Complex64::from((0.25 / PI).sqrt());
    for m in 0..=order {
        if m > 0 {
            let factor = -((2 * m + 1) as f64 / (2 * m) as f64).sqrt();
            y[at(m, m)] = y[at(m - 1, m - 1)] * Complex64::new(u.x, u.y) * factor;
        }
        // Y_l = a_l (z Y_{l-1} - Y_{l-2} / a_{l-1})
        let a = |l: usize| ((4 * l * l - 1) as f64 / (l * l - m * m) as f64).sqrt();
        for l in m + 1..=order {
            let mut sum = y[at(l - 1, m)] * u.z;
            if l > m + 1 {
                sum -= y[at(l - 2, m)] / a(l - 1);
            }
            y[at(l, m)] = sum * a(l);
        }
    }
    for l in 1..=order {
        for m in 1..=l {
            y[l * l + l - m] = y[at(l, m)].conj() * sign(m as i64);
        }
    }
    y
}

/// The Wigner 3j symbol (j1 j2 j3; m1 m2 m3) by Racah's formula, as printed after (C.15); 0 where
/// the selection rules forbid it.
pub fn wigner_3j(j: [i64; 3], m: [i64; 3]) -> f64 {
    let ([j1, j2, j3], [m1, m2, m3]) = (j, m);
    let forbidden = m1 + m2 + m3 != 0
        || j3 > j1 + j2
        || j3 < (j1 - j2).abs()
        || (0..3).any(|k| m[k].abs() > j[k]);
    if forbidden {
        return 0.0;
    }
    let triangle = factorial(j1 + j2 - j3) * factorial(j1 - j2 + j3) * factorial(-j1 + j2 + j3)
        / factorial(j1 + j2 + j3 + 1);
    let projections: f64 = (0..3)
        .map(|k| factorial(j[k] + m[k]) * factorial(j[k] - m[k]))
        .product();
    let first = 0.max(j2 - j3 - m1).max(j1 - j3 + m2);
    let last = (j1 + j2 - j3).min(j1 - m1).min(j2 + m2);
    let sum: f64 = (first..=last)
        .map(|i| {
            let below = [
                i,
                j1 + j2 - j3 - i,
                j1 - m1 - i,
                j2 + m2 - i,
                j3 - j2 + m1 + i,
                j3 - j1 - m2 + i,
            ];
            sign(i + j1 - j2 - m3) / below.into_iter().map(factorial).product::<f64>()
        })
        .sum();
    (triangle * projections).sqrt() * sum
}

/// The integral of conj Y_L^M Y_l1^m1 Y_l2^(M-m1) over the sphere: (LM|l1 m1|l2 m2) of (C.15).
pub(super) fn gaunt(l: i64, m: i64, l1: i64, m1: i64, l2: i64) -> f64 {
    let weight = (2 * l + 1) * (2 * l1 + 1) * (2 * l2 + 1);
    sign(m)
        * (weight as f64 / (4.0 * PI)).sqrt()
        * wigner_3j([l, l1, l2], [-m, m1, m - m1])
        * wigner_3j([l, l1, l2], [0, 0, 0])
}

/// (-1)^k
pub(super) fn sign(k: i64) -> f64 {
    if k % 2 == 0 { 1.0 } else { -1.0 }
}

fn factorial(n: i64) -> f64 {
    (2..=n).map(|k| k as f64).product()
}
