//! What all expansions of one order share.

use glam::DVec3;
use num_complex::Complex64;

use super::function::{functions, regular, singular};
use super::sack::e;
use super::source_matrix::SourceMatrix;
use super::translation::{Translation, l2l_terms, m2l_terms, m2m_terms};

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
    /// Expansions up to n = `order`. They converge to order 16 at least; from 27 on the
    /// factorials of [`wigner_3j`](super::wigner_3j) leave the range of f64.
    pub fn new(order: usize) -> Basis {
        Basis {
            order,
            e: functions(order).map(|f| e(f.n, f.j)).collect(),
            m2m: Translation::new(order, m2m_terms),
            m2l: Translation::new(order, m2l_terms),
            l2l: Translation::new(order, l2l_terms),
        }
    }

    pub fn order(&self) -> usize {
        self.order
    }

    /// Number of coefficients of an expansion, C(order + 3, 3), each a [`SourceMatrix`].
    pub fn coefficients(&self) -> usize {
        self.e.len()
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

    /// conj values, with real and imaginary parts where they belong.
    fn source(&self, values: Vec<Complex64>) -> Vec<f64> {
        functions(self.order)
            .map(|f| match f.m {
                0.. => values[f.index()].re,
                _ => -values[f.mirrored().index()].im,
            })
            .collect()
    }

    /// Both m and -m have a part in the sum: twice the real part of one.
    fn receiver(&self, values: Vec<Complex64>) -> Vec<f64> {
        let factor = |m: i64| if m == 0 { 1.0 } else { 2.0 };
        functions(self.order)
            .zip(self.source(values))
            .map(|(f, value)| factor(f.m) * value)
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
