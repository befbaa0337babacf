//! Derivatives of T(r) = r rᵀ/r⁴.

use super::indices::{degree, factorial, position};
use crate::math::{Numbers, Real};

/// How the derivatives of one multi-index γ come from those of lower ones.
///
/// With r = u + h about a unit vector u, the Taylor series in h of Q = 1/r⁴ follows from Euler's
/// operator: r² = 1 + 2 u·h + h² and (h·∇) Q = -4 (u·h + h²) Q / r² give for its coefficients
///
/// n c_γ = -2 (n+1) Σ_i u_i c_(γ-e_i) - (n+2) Σ_i c_(γ-2e_i), n = |γ|,
///
/// a recurrence of Gegenbauer polynomials, which is stable on the unit sphere. Then r Q and r rᵀ Q
/// come by multiplication with u + h, which shifts indices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Term {
    /// Where γ - e_i and γ - 2 e_i are.
    lower: [Option<usize>; 3],
    lowest: [Option<usize>; 3],
    /// -2 (n+1)/n and -(n+2)/n
    first: f64,
    second: f64,
    factorial: f64,
}

impl Term {
    pub const fn new(g: [u8; 3]) -> Term {
        let n = degree(g) as f64;
        Term {
            lower: [lower(g, 0, 1), lower(g, 1, 1), lower(g, 2, 1)],
            lowest: [lower(g, 0, 2), lower(g, 1, 2), lower(g, 2, 2)],
            first: -2.0 * (n + 1.0) / n,
            second: -(n + 2.0) / n,
            factorial: factorial(g),
        }
    }

    /// Fills in index `i` of the Taylor coefficients of 1/r⁴ and r/r⁴ and of the derivatives of
    /// r rᵀ/r⁴ (xx, xy, xz, yy, yz, zz). Either numbers, or
    /// vectors of which all lanes hold the same, so that they can be multiplied with colours.
    #[inline(always)]
    pub fn derive<T: Real, C: Numbers<T>>(
        &self,
        i: usize,
        u: [C; 3],
        inverse: &mut [C],
        vector: &mut [[C; 3]],
        tensor: &mut [[C; 6]],
    ) {
        let mut c = C::splat(T::ONE);
        if i > 0 {
            let [mut first, mut second] = [C::default(); 2];
            for k in 0..3 {
                if let Some(l) = self.lower[k] {
                    first += u[k] * inverse[l];
                }
                if let Some(l) = self.lowest[k] {
                    second += inverse[l];
                }
            }
            c = first * T::from_f64(self.first) + second * T::from_f64(self.second);
        }
        inverse[i] = c;
        let mut v = u.map(|u| u * c);
        for k in 0..3 {
            if let Some(l) = self.lower[k] {
                v[k] += inverse[l];
            }
        }
        vector[i] = v;
        let [x, y, z] = [u[0], u[1], u[2]];
        let mut t = [x * v[0], x * v[1], x * v[2], y * v[1], y * v[2], z * v[2]];
        if let Some(l) = self.lower[0] {
            for k in 0..3 {
                t[k] += vector[l][k];
            }
        }
        if let Some(l) = self.lower[1] {
            t[3] += vector[l][1];
            t[4] += vector[l][2];
        }
        if let Some(l) = self.lower[2] {
            t[5] += vector[l][2];
        }
        tensor[i] = match self.factorial {
            1.0 => t,
            f => t.map(|t| t * T::from_f64(f)),
        };
    }
}

/// Where γ - `by` e_axis is, if it is one.
pub(super) const fn lower(mut g: [u8; 3], axis: usize, by: u8) -> Option<usize> {
    if g[axis] < by {
        return None;
    }
    g[axis] -= by;
    Some(position(g))
}
