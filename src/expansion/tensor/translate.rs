//! Passes that only move polynomials: P2M, M2M, L2L, L2P. All but P2M are exact.

use super::indices::Indices;
use super::{Workspace, parts, parts_mut};
use crate::math::{Colour, Real, Vector};

impl<T: Real, C: Colour<T>> Workspace<'_, T, C> {
    /// P2M: adds a surfel with `flux` = A B and unit `normal` at `place` = s / scale.
    pub fn p2m(&mut self, flux: C, normal: T::Vec3, place: T::Vec3, moments: &mut [C]) {
        self.expand(self.indices.order(), place);
        let charge = normal.to_array().map(|n| flux * n);
        let (scalar, vectors) = parts_mut(moments);
        *scalar += flux;
        for (m, &s) in vectors.iter_mut().zip(&self.monomials) {
            for k in 0..3 {
                m[k] += charge[k] * s;
            }
        }
    }

    /// M2M: adds a child's moments to its parent's. The child's scale is `ratio` times the
    /// parent's, its centre at `place` in units of the parent's scale.
    pub fn m2m(&mut self, child: &[C], ratio: T, place: T::Vec3, parent: &mut [C]) {
        let order = self.indices.order();
        self.expand(order, place);
        let ((power, child), (scalar, parent)) = (parts(child), parts_mut(parent));
        *scalar += *power;
        let mut factor = T::ONE;
        for degree in 0..=order {
            for a in Indices::of_degree(degree) {
                let m = child[a].map(|m| m * factor);
                for (&sum, &s) in self.indices.sums(a).iter().zip(&self.monomials) {
                    let into = &mut parent[usize::from(sum)];
                    for k in 0..3 {
                        into[k] += m[k] * s;
                    }
                }
            }
            factor = factor * ratio;
        }
    }

    /// L2L: adds a parent's local expansion to its child's, with `ratio` and `place` as in
    /// [`Self::m2m`].
    pub fn l2l(&mut self, parent: &[C], ratio: T, place: T::Vec3, child: &mut [C]) {
        let order = self.indices.order();
        self.expand(order, place);
        let ((constant, parent), (scalar, child)) = (parts(parent), parts_mut(child));
        *scalar += *constant;
        for ((scaled, l), &f) in self.scaled.iter_mut().zip(parent).zip(&self.factorials) {
            *scaled = l.map(|l| l * f);
        }
        let mut factor = T::ONE;
        for degree in 0..=order {
            for b in Indices::of_degree(degree) {
                let mut sum = [C::default(); 3];
                for (&above, &s) in self.indices.sums(b).iter().zip(&self.monomials) {
                    let l = &self.scaled[usize::from(above)];
                    for k in 0..3 {
                        sum[k] += l[k] * s;
                    }
                }
                let factor = factor * self.inverse_factorials[b];
                for k in 0..3 {
                    child[b][k] += sum[k] * factor;
                }
            }
            factor = factor * ratio;
        }
    }

    /// L2P: irradiance of a surfel with unit `normal` at `place` = t / scale.
    pub fn l2p(&mut self, local: &[C], normal: T::Vec3, place: T::Vec3) -> C {
        self.expand(self.indices.order(), place);
        let (&constant, vectors) = parts(local);
        let weights = self.monomials.iter().zip(&self.factorials);
        let mut field = [C::default(); 3];
        for (l, (&s, &f)) in vectors.iter().zip(weights) {
            let power = s * f;
            for k in 0..3 {
                field[k] += l[k] * power;
            }
        }
        let n = normal.to_array();
        constant + field[0] * n[0] + field[1] * n[1] + field[2] * n[2]
    }
}
