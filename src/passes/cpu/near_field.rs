use rayon::prelude::*;

use crate::links::Rows;
use crate::math::{Colour, Real};

/// Near field (P2P): adds what each surfel gets from the surfels it is linked to.
pub fn near_field<T: Real, C: Colour<T>>(near: &Rows, radiosity: &[C], irradiance: &mut [C]) {
    irradiance.par_iter_mut().enumerate().for_each(|(i, h)| {
        for (j, form_factor) in near.row(i) {
            *h += radiosity[j] * T::from_f32(form_factor);
        }
    });
}
