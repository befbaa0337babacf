//! The numbers of the expansion of 1/r⁴ and of its translations.

use std::f64::consts::PI;

use super::harmonics::{gaunt, sign};

/// e_n^j = 4 (n-j+1)! (j+1/2)! / ((n-j+1/2)! j!), for 0 ≤ 2j ≤ n; the factor of (C.7).
pub fn e(n: i64, j: i64) -> f64 {
    // The quotient of the factorials, which themselves leave the range of f64.
    let quotient = |i: i64| i as f64 / (i as f64 + 0.5);
    4.0 * (n - j + 1) as f64 * (j + 1..=n - j).map(quotient).product::<f64>()
}

/// The factor J(l1, m1, l2, s, N, M, L) of Sack's addition theorem (C.15): for r = r1 + r2,
/// |r1| < |r2|,
///
/// |r|^N Y_L^M(r) = Σ J |r1|^(l1+2s) Y_l1^m1(r1) |r2|^(N-l1-2s) Y_l2^(M-m1)(r2).
///
/// 0 where l1, l2 and L do not couple. N - L is even in all sums of appendix C; an odd one below
/// zero has no J.
pub fn sack_j(l1: i64, m1: i64, l2: i64, s: i64, n: i64, m: i64, l: i64) -> f64 {
    let coupled = (l1 + l2 - l) % 2 == 0 && (l1 - l2).abs() <= l && l <= l1 + l2;
    if !coupled {
        return 0.0;
    }
    let half = (n - l) as f64 / 2.0; // n/2 with the n of the formula
    let lambda = (l1 + l2 - l) / 2;
    let lambda_1 = (l - l1 + l2) / 2;
    let above = rising(-half, lambda)
        * rising(half + 1.5, l)
        * rising(lambda as f64 - half, s)
        * rising(-half - 0.5 - lambda_1 as f64, s);
    let below = rising(0.5, l1 + 1)
        * rising(half + 1.5, lambda_1)
        * rising(l1 as f64 + 1.5, s)
        * rising(1.0, s);
    2.0 * PI * sign(lambda) * gaunt(l, m, l1, m1, l2) * above / below
}

/// The Pochhammer symbol (a)_n = a (a+1) ... (a+n-1).
fn rising(a: f64, n: i64) -> f64 {
    (0..n).map(|i| a + i as f64).product()
}
