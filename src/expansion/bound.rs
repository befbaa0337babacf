//! Errors of the tensor expansions: which order is enough for two facets.
//!
//! An expansion of order p leaves out the terms of degree p + 1 and more of the Taylor series of
//! T(r) = r rᵀ/|r|⁴ about the way R between the centres, in h = r - R = t - s. Take R = |R| = 1,
//! and in the plane of R and h let r be the complex number z = 1 + η e^{iγ} with η = |h|. T
//! projects onto r and divides by |r|², so that its part in the plane is half of the identity over
//! z z̄, plus half of the reflection that belongs to the number 1/z̄²; out of the plane it is zero.
//! In powers of η the coefficients of 1/(z z̄) and of 1/z̄² are sums of m + 1 numbers of modulus 1
//! at degree m. So the norm of the term of degree m is at most (m + 1) η^m, which is reached where
//! h lies along R.

/// Bound of an expansion's error at each place of the target, in units of Σ|q| / (π R²): that of
/// its field, and so of the irradiance of any surfel. `opening` is θ = (radius of the source's
/// expansion + radius of the target's) / R, of P2L and M2P with one of them only.
///
/// Σ_{m>p} (m + 1) θ^m = θ^(p+1) (p + 2 - (p + 1) θ) / (1 - θ)²; infinite from θ = 1 on. Sharp:
/// sources and receiver on the line through both centres, with normals along it, reach it.
pub fn remainder(order: usize, opening: f64) -> f64 {
    if opening < 1.0 {
        let p = order as f64;
        let rest = 1.0 - opening;
        opening.powf(p + 1.0) * (p + 2.0 - (p + 1.0) * opening) / (rest * rest)
    } else {
        f64::INFINITY
    }
}

/// Error to be expected of an expansion: root mean square over the target, as a part of the
/// irradiance. `source` and `target` are the radii of the expansions over the distance R, 0 where
/// there is none.
///
/// That is (source² + target²)^((p+1)/2): places of source and target are independent, and most are
/// well within the radii. Measured over pairs of flat or curved facets that face each other at any
/// angle up to 84 degrees, centred where the octree centres them, at openings of 0.2 to 0.6: 0.4 to
/// 1.4 times this to order 3 and up to 1.8 times at order 6, whatever the opening, where the
/// target's radius is no less than half the source's (0.1 to 1.3 where it is); for facets of four
/// surfels anywhere 0.8 to 1.8 times to order 3, up to 3.8 times at order 6. [`remainder`], which
/// takes all surfels to the rim and onto one line, is 25 (order 1, opening 0.2) to 600 times (order
/// 6, opening 0.6) the root mean square error.
pub fn expected_error(order: usize, source: f64, target: f64) -> f64 {
    source.hypot(target).powi(order as i32 + 1)
}

/// The least order up to `highest` whose error is at most `allowed`, if there is one.
pub fn least_order(highest: usize, allowed: f64, error: impl Fn(usize) -> f64) -> Option<usize> {
    (0..=highest).find(|&order| error(order) <= allowed)
}
