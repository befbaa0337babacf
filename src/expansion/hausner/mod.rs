//! The basis of the original report, as a reference in f64: Hausner's expansion of 1/r⁴ in
//! functions (n, j, m), times matrices for the numerator of the kernel.
//!
//! After R. Goradia, *FMM-based Illumination Maps for Point Models* (2006), appendix C; numbers like
//! (C.20) are its equations. It expands the kernel without clamp, (C.2):
//! K(x, y) = (n_x · (y-x)) (n_y · (x-y)) / (π |x-y|⁴). For |y| < |x|
//!
//! 1/|x-y|⁴ = Σ_{n≥0} Σ_{j≤n/2} Σ_{|m|≤n-2j} π e_n^j S_nj^m(x) conj R_nj^m(y)  (C.7), with
//! R_nj^m(y) = |y|^n Y_{n-2j}^m(y) and S_nj^m(x) = |x|^(-n-4) Y_{n-2j}^m(x).
//!
//! | | coefficients about a centre | irradiance at x |
//! |---|---|---|
//! | [`Multipole`] (C.8)-(C.10) | M_nj^m = Σ A B conj R_nj^m(y) SM(y) | Σ e_n^j S_nj^m(x) RM(x) ⊗ M_nj^m |
//! | [`Local`] (C.27), (C.29) | L_ks^m = Σ A B e_k^s conj S_ks^m(y) SM(y) | Σ R_ks^m(x) RM(x) ⊗ L_ks^m |
//!
//! An expansion has C(p+3, 3) coefficients of 16 colours each, as many as there are monomials, since
//! 1/r⁴ is not harmonic: five times the numbers of the Cartesian tensors of the same order. Errors are
//! of the same size. The clamp of the kernel, which (C.2) lacks, is up to the links: they connect what
//! faces each other.
//!
//! The report is followed with these corrections; each was checked against direct sums.
//!
//! - (C.20), (C.23): the factor before J is e_{n-k}^j' / e_n^j, and
//!   J = J(k-2s, m₁, n-2j, s, -n+k-4, m+m₁, n-k-2j').
//! - (C.31), (C.33), (C.34): the last harmonic is conj Y^(m₁'-m₁), not conj Y^(-m₁'+m₁).
//! - (C.12)-(C.14) have another local basis than (C.27)-(C.30), which is the one used here; theirs
//!   are L_ks^m = e_k^s (-1)^m L'_ks^-m.
//! - (C.21), (C.24): signs and products as [`SourceMatrix`] has them.
//! - (C.30), (C.34): sums to infinity end at the order.

mod basis;
mod expansions;
mod function;
mod harmonics;
mod sack;
mod source_matrix;
mod translation;

pub use basis::Basis;
pub use expansions::{Local, Multipole};
pub use function::{Function, functions};
pub use harmonics::{spherical_harmonics, wigner_3j};
pub use sack::{e, sack_j};
pub use source_matrix::SourceMatrix;
