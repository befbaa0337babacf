//! The functions (n, j, m) and their translations.

use glam::DVec3;
use num_complex::Complex64;

use super::harmonics::{sign, spherical_harmonics};
use super::sack::{e, j as sack_j};
use super::source_matrix::SourceMatrix;

/// All (n, j, m) with n ≤ `order`, 2j ≤ n, |m| ≤ n - 2j, in the order of the coefficients: n first,
/// so that an expansion begins with those of lower order.
pub fn functions(order: usize) -> impl Iterator<Item = (usize, usize, i64)> {
    (0..=order).flat_map(|n| {
        (0..=n / 2).flat_map(move |j| {
            let l = (n - 2 * j) as i64;
            (-l..=l).map(move |m| (n, j, m))
        })
    })
}

/// Place of (n, j, m) among the [`functions`].
pub fn index(n: usize, j: usize, m: i64) -> usize {
    let before = count(n) + j * (2 * n + 3 - 2 * j);
    before + ((n - 2 * j) as i64 + m) as usize
}

/// How many functions have an n below `n`.
fn count(n: usize) -> usize {
    n * (n + 1) * (n + 2) / 6
}

/// R_nj^m(r) = |r|^n Y_{n-2j}^m(r) up to `order`.
fn regular(order: usize, r: DVec3) -> Vec<Complex64> {
    radial(order, r, |length, n| length.powi(n))
}

/// S_nj^m(r) = |r|^(-n-4) Y_{n-2j}^m(r) up to `order`.
fn singular(order: usize, r: DVec3) -> Vec<Complex64> {
    radial(order, r, |length, n| length.powi(-n - 4))
}

fn radial(order: usize, r: DVec3, power: impl Fn(f64, i32) -> f64) -> Vec<Complex64> {
    let (harmonics, length) = (spherical_harmonics(order, r), r.length());
    let powers: Vec<f64> = (0..=order as i32).map(|n| power(length, n)).collect();
    functions(order)
        .map(|(n, j, m)| {
            let l = (n - 2 * j) as i64;
            harmonics[(l * l + l + m) as usize] * powers[n]
        })
        .collect()
}

/// The expansions of one order with their translations, whose numbers are found once, here.
///
/// Coefficients c_nj^m of real sources have c^-m = (-1)^m conj c^m: at the place of m ≥ 0 stands the
/// real part of c^m, at that of -m the imaginary part.
pub struct Basis {
    order: usize,
    /// e_n^j of each function.
    e: Vec<f64>,
    m2m: Translation,
    m2l: Translation,
    l2l: Translation,
}

impl Basis {
    /// Expansions up to n = `order`. Correct to 1e-12 up to order 8; from 20 on, Racah's formula
    /// loses all digits.
    pub fn new(order: usize) -> Basis {
        Basis {
            order,
            e: functions(order).map(|(n, j, _)| e(n, j)).collect(),
            m2m: Translation::new(order, m2m_terms),
            m2l: Translation::new(order, m2l_terms),
            l2l: Translation::new(order, l2l_terms),
        }
    }

    pub fn order(&self) -> usize {
        self.order
    }

    /// Number of coefficients, each a [`SourceMatrix`].
    pub fn len(&self) -> usize {
        self.e.len()
    }

    /// An expansion has at least one coefficient.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Coefficients of a unit source at `r`: conj R, for moments.
    pub(super) fn p2m(&self, r: DVec3) -> Vec<f64> {
        self.source(regular(self.order, r))
    }

    /// Coefficients of a unit source at `r`: e conj S, for local expansions.
    pub(super) fn p2l(&self, r: DVec3) -> Vec<f64> {
        let values = self.source(singular(self.order, r));
        values.iter().zip(&self.e).map(|(v, e)| v * e).collect()
    }

    /// What each coefficient of moments counts at `r`: e S.
    pub(super) fn m2p(&self, r: DVec3) -> Vec<f64> {
        let values = self.receiver(singular(self.order, r));
        values.iter().zip(&self.e).map(|(v, e)| v * e).collect()
    }

    /// What each coefficient of a local expansion counts at `r`: R.
    pub(super) fn l2p(&self, r: DVec3) -> Vec<f64> {
        self.receiver(regular(self.order, r))
    }

    fn source(&self, values: Vec<Complex64>) -> Vec<f64> {
        functions(self.order)
            .map(|(n, j, m)| {
                let value = values[index(n, j, m.abs())].conj();
                if m < 0 { value.im } else { value.re }
            })
            .collect()
    }

    /// Both m and -m have a part in the sum: twice the real part of one.
    fn receiver(&self, values: Vec<Complex64>) -> Vec<f64> {
        let factor = |m: i64| if m == 0 { 1.0 } else { 2.0 };
        functions(self.order)
            .zip(self.source(values))
            .map(|((_, _, m), value)| factor(m) * value)
            .collect()
    }

    /// Adds moments about the centre O to those about O' = O + `t` (C.23).
    pub(super) fn m2m(&self, t: DVec3, from: &[SourceMatrix], to: &mut [SourceMatrix]) {
        self.m2m
            .apply(self.order, &regular(self.order, t), t, from, to);
    }

    /// Adds moments about the centre O to the local expansion about O + `t`, both up to `order`
    /// (C.30).
    pub(super) fn m2l(
        &self,
        order: usize,
        t: DVec3,
        from: &[SourceMatrix],
        to: &mut [SourceMatrix],
    ) {
        self.m2l.apply(order, &singular(2 * order, t), t, from, to);
    }

    /// Adds the local expansion about x0 to that about x1 = x0 + `t` (C.34).
    pub(super) fn l2l(&self, t: DVec3, from: &[SourceMatrix], to: &mut [SourceMatrix]) {
        self.l2l
            .apply(self.order, &regular(self.order, -t), t, from, to);
    }
}

/// (n, j, m)
type Function = (usize, usize, i64);

/// One addend of a translation: coefficient `row` of the result gets `weight` times function number
/// `function` of the way times coefficient `column`.
struct Term {
    row: u32,
    column: u32,
    function: u32,
    weight: f64,
}

/// A translation of coefficients: a matrix whose entries are sums of functions of the way.
struct Translation {
    /// Rows with m ≥ 0 only, lower orders first.
    terms: Vec<Term>,
    /// How many terms have rows and columns up to each order.
    counts: Vec<usize>,
}

impl Translation {
    /// `terms` lists function numbers and weights for a row and a column.
    fn new(order: usize, terms: impl Fn(Function, Function) -> Vec<(usize, f64)>) -> Translation {
        let mut all = Vec::new();
        let mut counts = Vec::new();
        let at = |(n, j, m): Function| index(n, j, m);
        for highest in 0..=order {
            for row in functions(highest).filter(|&(_, _, m)| m >= 0) {
                for column in functions(highest).filter(|c| row.0.max(c.0) == highest) {
                    let some = terms(row, column).into_iter().filter(|&(_, w)| w != 0.0);
                    all.extend(some.map(|(function, weight)| Term {
                        row: at(row) as u32,
                        column: at(column) as u32,
                        function: function as u32,
                        weight,
                    }));
                }
            }
            counts.push(all.len());
        }
        Translation { terms: all, counts }
    }

    /// Adds the translated coefficients to those about a centre moved by `t`, all up to `order`.
    fn apply(
        &self,
        order: usize,
        functions_of_way: &[Complex64],
        t: DVec3,
        from: &[SourceMatrix],
        to: &mut [SourceMatrix],
    ) {
        let len = count(order + 1);
        let mut matrix = vec![Complex64::ZERO; len * len];
        for term in &self.terms[..self.counts[order]] {
            matrix[term.row as usize * len + term.column as usize] +=
                functions_of_way[term.function as usize] * term.weight;
        }
        let from: Vec<SourceMatrix> = from[..len].iter().map(|c| c.moved(t)).collect();
        let halves = || functions(order).filter(|&(_, _, m)| m >= 0);
        let places = |(n, j, m): Function| [index(n, j, m), index(n, j, -m)];
        for (row, [re, im]) in halves().map(|f| (f, places(f))) {
            for (column, [from_re, from_im]) in halves().map(|f| (f, places(f))) {
                // a c + b conj c for the coefficient c: those of m and -m.
                let mut a = matrix[re * len + from_re];
                let mut b = Complex64::ZERO;
                if column.2 > 0 {
                    b = matrix[re * len + from_im] * sign(column.2);
                }
                if a == Complex64::ZERO && b == Complex64::ZERO {
                    continue;
                }
                (a, b) = (a + b, a - b);
                to[re].add(&from[from_re], a.re);
                if column.2 > 0 {
                    to[re].add(&from[from_im], -b.im);
                }
                if row.2 > 0 {
                    to[im].add(&from[from_re], a.im);
                    if column.2 > 0 {
                        to[im].add(&from[from_im], b.re);
                    }
                }
            }
        }
    }
}

/// (C.23), with the regular functions of OO'. Row (n, j, m), column (n-k, j', m+m1).
fn m2m_terms((n, j, m): Function, (n1, j1, m_sum): Function) -> Vec<(usize, f64)> {
    let Some(k) = n.checked_sub(n1) else {
        return Vec::new();
    };
    let m1 = m_sum - m;
    let ratio = e(n1, j1) / e(n, j);
    let l = |n: usize, j: usize| (n - 2 * j) as i64;
    (0..=k / 2)
        .filter(|&s| m1.abs() <= l(k, s))
        .map(|s| {
            let (k1, from) = (l(k, s), [m_sum, l(n1, j1)]);
            let coupling = sack_j([k1, m1], l(n, j), s as i64, -(n1 as i64) - 4, from);
            (index(k, s, m1), ratio * coupling)
        })
        .collect()
}

/// (C.30), with the singular functions of Ox0. Row (k, s, m1), column (n, j, m).
fn m2l_terms((k, s, m1): Function, (n, j, m): Function) -> Vec<(usize, f64)> {
    let (l1, l) = (k - 2 * s, n - 2 * j);
    (l1.abs_diff(l)..=l1 + l)
        .step_by(2)
        .filter(|&l2| (m - m1).unsigned_abs() as usize <= l2)
        .map(|l2| {
            let from = [m, l as i64];
            let coupling = sack_j([l1 as i64, m1], l2 as i64, s as i64, -(n as i64) - 4, from);
            (index(n + k, (n + k - l2) / 2, m - m1), e(n, j) * coupling)
        })
        .collect()
}

/// (C.34), with the regular functions of x1x0. Row (k', s', m1'), column (k, s, m1).
fn l2l_terms((k1, s1, m1): Function, (k, s, m): Function) -> Vec<(usize, f64)> {
    let Some(rest) = k.checked_sub(k1) else {
        return Vec::new();
    };
    let l = |n: usize, j: usize| (n - 2 * j) as i64;
    (0..=rest / 2)
        .filter(|&j| (m1 - m).abs() <= l(rest, j))
        .map(|j| {
            let from = [m1 - m, l(rest, j)];
            let order = -(rest as i64) - 4;
            let coupling = sack_j([l(k1, s1), m1], l(k, s), s1 as i64, order, from);
            // conj Y^(m1'-m1) = (-1)^(m1'-m1) Y^(m1-m1')
            let signs = sign(k as i64 + m) * sign(m1 - m);
            (
                index(rest, j, m - m1),
                signs * coupling * e(rest, j) / e(k, s),
            )
        })
        .collect()
}
