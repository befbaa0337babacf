use super::indices::{Indices, count, position};
use crate::math::{Real, Vector};

/// What the passes of one thread need on the way: tables in its reals and room for what comes
/// between. Its methods are the passes for one surfel, facet or link each.
#[derive(Clone, Debug)]
pub struct Workspace<'a, T: Real> {
    pub(super) indices: &'a Indices,
    /// γ!
    pub(super) factorials: Vec<T>,
    /// How the monomial of γ comes from one of lower degree: which, times which component, over γ of
    /// that component.
    steps: Vec<(usize, usize, T)>,
    /// Slots of γ - e_i and of γ - 2 e_i.
    lower: Vec<([u16; 3], [u16; 3])>,
    /// s^γ / γ!
    pub(super) monomials: Vec<T>,
    /// Vectors of an expansion, scaled anew.
    pub(super) scaled: Vec<[T::Rgb; 3]>,
    /// Of the Taylor series about a place u, its coefficients for 1/r⁴ and r/r⁴, all lanes alike.
    /// Slot 0 holds zeros, for indices with a negative entry; γ is in slot `index + 1`.
    inverse: Vec<T::Rgb>,
    vector: Vec<[T::Rgb; 3]>,
    /// Derivatives ∂^γ of r rᵀ/r⁴: xx, xy, xz, yy, yz, zz, all lanes alike.
    pub(super) tensor: Vec<[T::Rgb; 6]>,
}

impl<'a, T: Real> Workspace<'a, T> {
    pub fn new(indices: &'a Indices) -> Self {
        let all = indices.exponents();
        let slot = |g: &[u8; 3], i: usize, by: u8| match g[i].checked_sub(by) {
            Some(e) => {
                let mut lower = *g;
                lower[i] = e;
                position(lower) as u16 + 1
            }
            None => 0,
        };
        let factorial = |g: &[u8; 3]| -> f64 {
            let of = |&e: &u8| (1..=e).map(f64::from).product::<f64>();
            g.iter().map(of).product()
        };
        let step = |g: &[u8; 3]| {
            let axis = (0..3).find(|&i| g[i] > 0).unwrap_or(0);
            let from = usize::from(slot(g, axis, 1)).saturating_sub(1);
            (from, axis, T::from_f64(1.0 / f64::from(g[axis].max(1))))
        };
        let lower = |g: &[u8; 3]| {
            [1, 2]
                .map(|by| std::array::from_fn(|i| slot(g, i, by)))
                .into()
        };
        let zero = T::Rgb::default();
        Workspace {
            indices,
            factorials: all.iter().map(|g| T::from_f64(factorial(g))).collect(),
            steps: all.iter().map(step).collect(),
            lower: all.iter().map(lower).collect(),
            monomials: vec![T::ONE; all.len()],
            scaled: vec![[zero; 3]; all.len()],
            inverse: vec![zero; all.len() + 1],
            vector: vec![[zero; 3]; all.len() + 1],
            tensor: vec![[zero; 6]; all.len()],
        }
    }

    /// Monomials s^γ / γ!.
    pub(super) fn expand(&mut self, order: usize, s: T::Vec3) {
        let s = s.to_array();
        for g in 1..count(order) {
            let (from, axis, inverse) = self.steps[g];
            self.monomials[g] = self.monomials[from] * s[axis] * inverse;
        }
    }

    /// Derivatives of r rᵀ/r⁴ at the unit vector `u` up to an order.
    ///
    /// With r = u + h, the Taylor series in h of Q = 1/r⁴ follows from Euler's operator: r² = 1 +
    /// 2 u·h + h² and (h·∇) Q = -4 (u·h + h²) Q / r² give for its coefficients
    ///
    /// n c_γ = -2 (n+1) Σ_i u_i c_(γ-e_i) - (n+2) Σ_i c_(γ-2e_i), n = |γ|,
    ///
    /// the recurrence of Gegenbauer polynomials, which is stable on the unit sphere. Then r Q and
    /// r rᵀ Q come by multiplication with u + h, which shifts indices.
    pub(super) fn derive(&mut self, order: usize, u: T::Vec3) {
        let u = u.to_array().map(T::Rgb::splat);
        let dot = |a: [T::Rgb; 3], b: [T::Rgb; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        for degree in 0..=order {
            let n = degree.max(1) as f64;
            let first = T::from_f64(-2.0 * (n + 1.0) / n);
            let second = T::from_f64(-(n + 2.0) / n);
            for g in Indices::of_degree(degree) {
                let (lower, lowest) = self.lower[g];
                let lower = lower.map(usize::from);
                let q = lower.map(|l| self.inverse[l]);
                let c = if degree == 0 {
                    T::Rgb::splat(T::ONE)
                } else {
                    let [a, b, c] = lowest.map(|l| self.inverse[usize::from(l)]);
                    dot(u, q) * first + (a + b + c) * second
                };
                let v: [T::Rgb; 3] = std::array::from_fn(|k| u[k] * c + q[k]);
                self.inverse[g + 1] = c;
                self.vector[g + 1] = v;
                let [x, y, z] = lower.map(|l| self.vector[l]);
                let factorial = T::Rgb::splat(self.factorials[g]);
                self.tensor[g] = [
                    (u[0] * v[0] + x[0]) * factorial,
                    (u[0] * v[1] + x[1]) * factorial,
                    (u[0] * v[2] + x[2]) * factorial,
                    (u[1] * v[1] + y[1]) * factorial,
                    (u[1] * v[2] + y[2]) * factorial,
                    (u[2] * v[2] + z[2]) * factorial,
                ];
            }
        }
    }
}
