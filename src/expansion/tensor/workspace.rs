use super::derivatives::{Term, lower};
use super::indices::{Indices, count, factorial};
use super::written_out;
use crate::math::{Colour, Real, Vector};

/// What the passes of one thread need on the way: tables in its reals and room for what comes
/// between. Its methods are the passes for one surfel, facet or link each.
#[derive(Clone, Debug)]
pub struct Workspace<'a, T: Real, C = <T as Real>::Rgb> {
    pub(super) indices: &'a Indices,
    /// γ! and 1/γ!
    pub(super) factorials: Vec<T>,
    pub(super) inverse_factorials: Vec<T>,
    /// How the monomial of γ comes from one of lower degree: which, times which component, over γ
    /// of that component.
    steps: Vec<(usize, usize, T)>,
    terms: Vec<Term>,
    /// s^γ / γ!
    pub(super) monomials: Vec<T>,
    /// A number for each multi-index.
    pub(super) weights: Vec<T>,
    /// Vectors of an expansion, scaled anew.
    pub(super) scaled: Vec<[C; 3]>,
    /// Room for [`Term::derive`].
    inverse: Vec<C>,
    vector: Vec<[C; 3]>,
    /// Derivatives ∂^γ of r rᵀ/r⁴: xx, xy, xz, yy, yz, zz, all lanes alike.
    pub(super) tensor: Vec<[C; 6]>,
}

impl<'a, T: Real, C: Colour<T>> Workspace<'a, T, C> {
    pub fn new(indices: &'a Indices) -> Self {
        let all = indices.exponents();
        let step = |g: &[u8; 3]| {
            let axis = (0..3).find(|&i| g[i] > 0).unwrap_or(0);
            let inverse = T::from_f64(1.0 / f64::from(g[axis].max(1)));
            (lower(*g, axis, 1).unwrap_or(0), axis, inverse)
        };
        let reals = |f: fn(f64) -> f64| all.iter().map(|&g| T::from_f64(f(factorial(g)))).collect();
        let zero = C::default();
        Workspace {
            indices,
            factorials: reals(|f| f),
            inverse_factorials: reals(|f| 1.0 / f),
            steps: all.iter().map(step).collect(),
            terms: all.iter().map(|&g| Term::new(g)).collect(),
            monomials: vec![T::ONE; all.len()],
            weights: vec![T::ONE; all.len()],
            scaled: vec![[zero; 3]; all.len()],
            inverse: vec![zero; all.len()],
            vector: vec![[zero; 3]; all.len()],
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
    #[inline(always)]
    pub(super) fn derive(&mut self, order: usize, u: T::Vec3) {
        let u = u.to_array().map(C::splat);
        match order {
            0 => written_out::derive_0::<T, C>(u, &mut self.tensor),
            1 => written_out::derive_1::<T, C>(u, &mut self.tensor),
            2 => written_out::derive_2::<T, C>(u, &mut self.tensor),
            3 => written_out::derive_3::<T, C>(u, &mut self.tensor),
            _ => {
                let (inverse, vector) = (&mut self.inverse, &mut self.vector);
                for (i, term) in self.terms[..count(order)].iter().enumerate() {
                    term.derive::<T, C>(i, u, inverse, vector, &mut self.tensor);
                }
            }
        }
    }
}
