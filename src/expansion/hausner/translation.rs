//! Translations of coefficients from one centre to another.

use glam::DVec3;
use num_complex::Complex64;

use super::function::{Function, count, functions};
use super::harmonics::sign;
use super::sack::{e, sack_j};
use super::source_matrix::SourceMatrix;

/// A translation: a matrix whose entries are sums of functions of the way.
pub(super) struct Translation {
    /// Rows with m ≥ 0 only; those of a lower order come first.
    terms: Vec<Term>,
    /// How many terms have rows and columns up to each order.
    counts: Vec<usize>,
}

/// One addend: coefficient `row` of the result gets `weight` times function `function` of the way
/// times coefficient `column`. All three are indices.
struct Term {
    row: u32,
    column: u32,
    function: u32,
    weight: f64,
}

impl Translation {
    /// `terms` lists functions of the way and weights for a row and a column.
    pub fn new(
        order: usize,
        terms: impl Fn(Function, Function) -> Vec<(Function, f64)>,
    ) -> Translation {
        let mut all = Vec::new();
        let mut counts = Vec::new();
        for highest in 0..=order {
            for row in functions(highest).filter(|f| f.m >= 0) {
                for column in functions(highest) {
                    if row.n.max(column.n) < highest as i64 {
                        continue;
                    }
                    let some = terms(row, column).into_iter();
                    all.extend(some.filter(|t| t.1 != 0.0).map(|(function, weight)| Term {
                        row: row.index() as u32,
                        column: column.index() as u32,
                        function: function.index() as u32,
                        weight,
                    }));
                }
            }
            counts.push(all.len());
        }
        Translation { terms: all, counts }
    }

    /// Adds coefficients `from` about one centre to those about the centre moved by `t`, both up to
    /// `order`; `way` has the values of the functions of the way.
    pub fn apply(
        &self,
        order: usize,
        way: &[Complex64],
        t: DVec3,
        from: &[SourceMatrix],
        to: &mut [SourceMatrix],
    ) {
        let len = count(order + 1);
        let mut matrix = vec![Complex64::ZERO; len * len];
        for term in &self.terms[..self.counts[order]] {
            matrix[term.row as usize * len + term.column as usize] +=
                way[term.function as usize] * term.weight;
        }
        let from: Vec<SourceMatrix> = from[..len].iter().map(|c| c.moved(t)).collect();
        let halves = || functions(order).filter(|f| f.m >= 0);
        for row in halves() {
            let (re, im) = (row.index(), row.mirrored().index());
            for column in halves() {
                // The row gets a c + b conj c, with the coefficients c of m and ±conj c of -m.
                let (from_re, from_im) = (column.index(), column.mirrored().index());
                let a = matrix[re * len + from_re];
                let b = match column.m {
                    0 => Complex64::ZERO,
                    m => matrix[re * len + from_im] * sign(m),
                };
                if a == Complex64::ZERO && b == Complex64::ZERO {
                    continue;
                }
                to[re].add(&from[from_re], (a + b).re);
                if column.m > 0 {
                    to[re].add(&from[from_im], (b - a).im);
                }
                if row.m > 0 {
                    to[im].add(&from[from_re], (a + b).im);
                    if column.m > 0 {
                        to[im].add(&from[from_im], (a - b).re);
                    }
                }
            }
        }
    }
}

/// (C.23): regular functions (k, s, m1) of OO'. Row (n, j, m), column (n-k, j', m+m1).
pub(super) fn m2m_terms(row: Function, column: Function) -> Vec<(Function, f64)> {
    let (k, m1) = (row.n - column.n, column.m - row.m);
    let ratio = e(column.n, column.j) / e(row.n, row.j);
    Function::all(k, m1)
        .map(|way| {
            let j = sack_j(
                way.l(),
                m1,
                row.l(),
                way.j,
                -column.n - 4,
                column.m,
                column.l(),
            );
            (way, ratio * j)
        })
        .collect()
}

/// (C.30): singular functions of Ox0 with n + k and l2. Row (k, s, m1), column (n, j, m).
pub(super) fn m2l_terms(row: Function, column: Function) -> Vec<(Function, f64)> {
    let strength = e(column.n, column.j);
    Function::all(row.n + column.n, column.m - row.m)
        .map(|way| {
            let j = sack_j(
                row.l(),
                row.m,
                way.l(),
                row.j,
                -column.n - 4,
                column.m,
                column.l(),
            );
            (way, strength * j)
        })
        .collect()
}

/// (C.34): conjugate regular functions (k-k', j', m1'-m1) of x1x0. Row (k', s', m1'), column
/// (k, s, m1).
pub(super) fn l2l_terms(row: Function, column: Function) -> Vec<(Function, f64)> {
    let (rest, m) = (column.n - row.n, row.m - column.m);
    let sign = sign(column.n + column.m) * sign(m); // conj Y^m = (-1)^m Y^-m
    Function::all(rest, m)
        .map(|way| {
            let j = sack_j(row.l(), row.m, column.l(), row.j, -rest - 4, m, way.l());
            let ratio = e(rest, way.j) / e(column.n, column.j);
            (way.mirrored(), sign * ratio * j)
        })
        .collect()
}
