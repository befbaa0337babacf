//! Derivatives and M2L of low orders with their loops written out, so that the compiler knows every
//! index, leaves out what is zero and keeps numbers in registers: M2L is 1.4 times as fast at
//! orders 1 and 2. From order 3 on its loops are as fast.

use super::derivatives::Term;
use super::indices::{count, degree, exponents, sums};
use super::interact::contract;
use crate::math::Real;

const EXPONENTS: [[u8; 3]; count(3)] = exponents();

macro_rules! written_out {
    ($order:literal, $derive:ident, $($i:literal)*) => {
        /// Derivatives of r rᵀ/r⁴ at the unit vector u.
        pub(super) fn $derive<T: Real>(u: [T::Rgb; 3], tensor: &mut [[T::Rgb; 6]]) {
            let mut inverse = [T::Rgb::default(); count($order)];
            let mut vector = [[T::Rgb::default(); 3]; count($order)];
            let tensor = &mut tensor[..count($order)];
            $({
                const TERM: Term = Term::new(EXPONENTS[$i]);
                TERM.derive::<T>($i, u, &mut inverse, &mut vector, tensor);
            })*
        }
    };
    ($order:literal, $derive:ident, $convolve:ident, $($i:literal)*) => {
        written_out!($order, $derive, $($i)*);

        /// Σ_α T^(α+β) M^α for every β.
        #[inline(always)]
        pub(super) fn $convolve<T: Real>(
            tensor: &[[T::Rgb; 6]],
            moments: &[[T::Rgb; 3]],
            mut field: impl FnMut(usize, [T::Rgb; 3]),
        ) {
            let tensor = &tensor[..count($order)];
            $({
                const DEGREE: usize = degree(EXPONENTS[$i]);
                const SUMS: [u16; count($order - DEGREE)] = sums(EXPONENTS[$i]);
                field($i, contract::<T>(tensor, &moments[..SUMS.len()], &SUMS));
            })*
        }
    };
}

written_out!(0, derive_0, convolve_0, 0);
written_out!(1, derive_1, convolve_1, 0 1 2 3);
written_out!(2, derive_2, convolve_2, 0 1 2 3 4 5 6 7 8 9);
written_out!(3, derive_3, 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19);
