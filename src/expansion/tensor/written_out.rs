//! Derivatives and M2L of low orders with their loops written out, so that the compiler knows every
//! index, leaves out what is zero and keeps numbers in registers: M2L is 1.4 times as fast at
//! orders 1 and 2. From order 3 on its loops are as fast.

use super::derivatives::Term;
use super::indices::{count, degree, exponents, sums};
use super::interact::contract;
use crate::math::{Numbers, Real};

const EXPONENTS: [[u8; 3]; count(3)] = exponents();

macro_rules! written_out {
    ($order:literal, $derive:ident, $($i:literal)*) => {
        /// Derivatives of r rᵀ/r⁴ at the unit vector u.
        #[inline(always)]
        pub(super) fn $derive<T: Real, C: Numbers<T>>(u: [C; 3], tensor: &mut [[C; 6]]) {
            let mut inverse = [C::default(); count($order)];
            let mut vector = [[C::default(); 3]; count($order)];
            const COUNT: usize = count($order);
            let tensor = &mut tensor[..COUNT];
            $({
                const TERM: Term = Term::new(EXPONENTS[$i]);
                TERM.derive::<T, C>($i, u, &mut inverse, &mut vector, tensor);
            })*
        }
    };
    ($order:literal, $derive:ident, $convolve:ident, $($i:literal)*) => {
        written_out!($order, $derive, $($i)*);

        /// Σ_α T^(α+β) M^α for every β.
        #[inline(always)]
        pub(super) fn $convolve<T: Real, C: Numbers<T>>(
            tensor: &[[C; 6]],
            moments: &[[C; 3]],
            mut field: impl FnMut(usize, [C; 3]),
        ) {
            const COUNT: usize = count($order);
            let tensor = &tensor[..COUNT];
            $({
                const DEGREE: usize = degree(EXPONENTS[$i]);
                const SUMS: [u16; count($order - DEGREE)] = sums(EXPONENTS[$i]);
                field($i, contract::<T, C>(tensor, &moments[..SUMS.len()], &SUMS));
            })*
        }
    };
}

written_out!(0, derive_0, convolve_0, 0);
written_out!(1, derive_1, convolve_1, 0 1 2 3);
written_out!(2, derive_2, convolve_2, 0 1 2 3 4 5 6 7 8 9);
written_out!(3, derive_3, 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19);
