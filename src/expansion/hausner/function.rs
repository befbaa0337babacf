//! The functions of the expansions.

use glam::DVec3;
use num_complex::Complex64;

use super::harmonics::spherical_harmonics;

/// A function (n, j, m): 0 ≤ 2j ≤ n, |m| ≤ n - 2j. The report names those of local expansions
/// (k, s, m1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Function {
    pub n: i64,
    pub j: i64,
    pub m: i64,
}

impl Function {
    /// Degree of its spherical harmonic.
    pub fn l(self) -> i64 {
        self.n - 2 * self.j
    }

    /// That of -m.
    pub fn mirrored(self) -> Function {
        Function { m: -self.m, ..self }
    }

    /// Place among the [`functions`].
    pub fn index(self) -> usize {
        count(self.n as usize)
            + (self.j * (2 * self.n + 3 - 2 * self.j) + self.l() + self.m) as usize
    }

    /// All j of one n and m; none if n is negative or |m| exceeds it.
    pub fn all(n: i64, m: i64) -> impl Iterator<Item = Function> {
        let last = (n - m.abs()).div_euclid(2);
        (0..=last).map(move |j| Function { n, j, m })
    }
}

/// All functions with n up to `order`, in the order of the coefficients: by n, so that an expansion
/// begins with that of a lower order.
pub fn functions(order: usize) -> impl Iterator<Item = Function> {
    (0..=order as i64).flat_map(|n| {
        (0..=n / 2).flat_map(move |j| {
            let l = n - 2 * j;
            (-l..=l).map(move |m| Function { n, j, m })
        })
    })
}

/// How many functions have an n below this one.
pub(super) fn count(n: usize) -> usize {
    n * (n + 1) * (n + 2) / 6
}

/// R_nj^m(r) = |r|^n Y_{n-2j}^m(r) up to `order`.
pub fn regular(order: usize, r: DVec3) -> Vec<Complex64> {
    values(order, r, |length, n| length.powi(n))
}

/// S_nj^m(r) = |r|^(-n-4) Y_{n-2j}^m(r) up to `order`.
pub fn singular(order: usize, r: DVec3) -> Vec<Complex64> {
    values(order, r, |length, n| length.powi(-n - 4))
}

fn values(order: usize, r: DVec3, power: impl Fn(f64, i32) -> f64) -> Vec<Complex64> {
    let (harmonics, length) = (spherical_harmonics(order, r), r.length());
    let powers: Vec<f64> = (0..=order as i32).map(|n| power(length, n)).collect();
    functions(order)
        .map(|f| harmonics[(f.l() * f.l() + f.l() + f.m) as usize] * powers[f.n as usize])
        .collect()
}
