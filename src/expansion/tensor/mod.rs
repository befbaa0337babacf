//! Cartesian tensor expansions of any order p: of what a facet sends out, and of the light that
//! arrives at it.
//!
//! With the vector charge q = A B n of a source at y = c + s, and the tensor of second rank
//! T(r) = r rᵀ/|r|⁴, the field is F(x) = -(1/π) Σ T(x - y) q. About the centres of two facets, a
//! distance R apart, it is
//!
//! F_i(c' + t) = -(1/π) Σ_β t^β/β! Σ_α (-1)^|α| ∂^(α+β) T_ik(R) Σ_sources q_k s^α/α!,
//!
//! of which an expansion of order p keeps the terms with |α + β| ≤ p. Lengths are in units of the
//! radius of the facet on either side, so that coefficients keep their size whatever the unit of
//! the scan.
//!
//! # Coefficients
//!
//! An expansion is a flat list of 1 + 3 C(p+3, 3) colours: a scalar, then for each multi-index in
//! the order of [`Indices`] the components x, y, z. So the first of them are the expansion of a
//! lower order. Of the moments these are
//!
//! - Σ A B,
//! - M_k^α = Σ A B n_k s^α / (α! scale^|α|),
//!
//! and of a local expansion
//!
//! - irradiance that does not depend on the normal, from sampled links,
//! - L_k^β = scale^|β| ∂^β F_k / β! at the centre, so that F_k = Σ_β L_k^β t^β / scale^|β|.
//!
//! # Work
//!
//! Multiply-adds of colours, by order:
//!
//! | | | 1 | 2 | 3 | 4 | 6 |
//! |---|---|---|---|---|---|---|
//! | coefficients | 1 + 3 C(p+3,3) | 13 | 31 | 61 | 106 | 253 |
//! | bytes in f32 | 16 each | 208 | 496 | 976 | 1696 | 4048 |
//! | P2M, L2P, a surfel | 3 C(p+3,3) | 12 | 30 | 60 | 105 | 252 |
//! | M2M, L2L, a child | 3 C(p+6,6) | 21 | 84 | 252 | 630 | 2772 |
//! | M2L, a link | 9 C(p+6,6) + 6 C(p+3,3) | 87 | 312 | 876 | 2100 | 8820 |
//! | P2L, M2P, a surfel | up to 15 C(p+3,3) | 60 | 150 | 300 | 525 | 1260 |
//! | and derivatives of T | up to 23 C(p+3,3) | 92 | 230 | 460 | 805 | 1932 |
//!
//! The last row comes on top of M2L, P2L and M2P. On one core in f32 with SSE2 that is 28, 10, 4.2,
//! 1.8 and 0.45 million M2L a second, expansions in the cache (AMD EPYC). At order 1 several links are taken side
//! by side, with AVX2 in half of that time.
//!
//! F is also A - ∇Φ with A = Σ q / r² and Φ = Σ q · ∇ log r, up to a factor. That would take
//! 3 C(p+6,6) + C(p+8,6) - 2 C(p+5,3) + 1 multiply-adds a link instead of 9 C(p+6,6), a third less
//! at order 6 and a tenth less at order 2, but an index to look up for most of them; here there is
//! one for nine.

mod derivatives;
mod indices;
mod interact;
mod side_by_side;
mod translate;
mod workspace;
mod written_out;

pub use indices::{Indices, count, position};
pub use side_by_side::Link;
pub use workspace::Workspace;

use std::marker::PhantomData;

use rayon::prelude::*;

use crate::math::{Colour, Real};

/// Number of coefficients of an expansion of this order.
pub const fn coefficients(order: usize) -> usize {
    1 + 3 * count(order)
}

/// The moments or the local expansions of all facets.
#[derive(Clone, Debug)]
pub struct Expansions<T: Real, C = <T as Real>::Rgb> {
    indices: Indices,
    coefficients: Vec<C>,
    real: PhantomData<T>,
}

impl<T: Real, C: Colour<T>> Expansions<T, C> {
    /// Zeros for so many facets.
    pub fn zeros(order: usize, facets: usize) -> Self {
        // Large enough that clearing the memory is work for all threads.
        let zeros = rayon::iter::repeat_n(C::default(), facets * coefficients(order));
        Expansions {
            indices: Indices::new(order),
            coefficients: zeros.collect(),
            real: PhantomData,
        }
    }

    /// The multi-indices of the coefficients.
    pub fn indices(&self) -> &Indices {
        &self.indices
    }

    pub fn order(&self) -> usize {
        self.indices.order()
    }

    /// Coefficients a facet.
    pub fn stride(&self) -> usize {
        coefficients(self.order())
    }

    /// The expansion of facet `f`.
    #[inline(always)]
    pub fn of(&self, f: usize) -> &[C] {
        let stride = self.stride();
        &self.coefficients[f * stride..(f + 1) * stride]
    }

    /// All coefficients, facet by facet.
    pub fn as_slice(&self) -> &[C] {
        &self.coefficients
    }

    /// The multi-indices, and all coefficients to be changed.
    pub fn split_mut(&mut self) -> (&Indices, &mut [C]) {
        (&self.indices, &mut self.coefficients)
    }
}

/// Scalar and vectors of an expansion.
#[inline(always)]
fn parts<C>(expansion: &[C]) -> (&C, &[[C; 3]]) {
    (&expansion[0], expansion[1..].as_chunks().0)
}

#[inline(always)]
fn parts_mut<C>(expansion: &mut [C]) -> (&mut C, &mut [[C; 3]]) {
    let (scalar, vectors) = expansion.split_at_mut(1);
    (&mut scalar[0], vectors.as_chunks_mut().0)
}
