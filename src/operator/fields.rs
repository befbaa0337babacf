//! Fields: light of each surfel, on the backend of the operator that they belong to.

use std::marker::PhantomData;

use glam::DVec3;
use rayon::prelude::*;

use crate::error::Result;
use crate::math::{Colour, Real};

/// Arithmetic on fields. A solver needs no more than this.
pub trait Fields {
    /// One RGB value a surfel, or one number.
    type Field;
    /// Their relative rounding.
    const EPSILON: f64;

    /// To the backend.
    fn upload(&self, values: &[DVec3]) -> Result<Self::Field>;
    /// From the backend; waits until it is there.
    fn download(&self, field: &Self::Field) -> Result<Vec<DVec3>>;
    /// The same values once more.
    fn copy(&self, field: &Self::Field) -> Result<Self::Field>;
    /// y += Σ a x over the terms (a, x)
    fn add(&self, terms: &[(f64, &Self::Field)], y: &mut Self::Field) -> Result<()>;
    /// x *= a
    fn scale(&self, a: f64, x: &mut Self::Field) -> Result<()>;
    /// x *= factor, surfel by surfel and channel by channel
    fn multiply(&self, factor: &Self::Field, x: &mut Self::Field) -> Result<()>;
    /// Σ x · y over surfels and channels, for each x; waits for all of them together.
    fn dots(&self, xs: &[&Self::Field], y: &Self::Field) -> Result<Vec<f64>>;

    /// y += a x
    fn axpy(&self, a: f64, x: &Self::Field, y: &mut Self::Field) -> Result<()> {
        self.add(&[(a, x)], y)
    }

    /// Σ x · y over surfels and channels
    fn dot(&self, x: &Self::Field, y: &Self::Field) -> Result<f64> {
        Ok(self.dots(&[x], y)?.iter().sum())
    }
}

/// Fields in main memory: red, green and blue, or one number, where all colours are grey.
#[derive(Clone, Copy, Debug, Default)]
pub struct HostFields<T: Real, C = <T as Real>::Vec3>(PhantomData<(T, C)>);

/// Sums are taken over blocks of fixed length, so that they do not depend on the number of
/// threads.
const BLOCK: usize = 4096;

impl<T: Real, C: Colour<T>> Fields for HostFields<T, C> {
    type Field = Vec<C>;
    const EPSILON: f64 = T::EPSILON;

    fn upload(&self, values: &[DVec3]) -> Result<Self::Field> {
        let narrow = |v: &DVec3| C::from_rgb(v.to_array().map(T::from_f64));
        Ok(values.par_iter().map(narrow).collect())
    }

    fn download(&self, field: &Self::Field) -> Result<Vec<DVec3>> {
        let wide = |v: &C| DVec3::from_array(v.to_rgb().map(T::to_f64));
        Ok(field.par_iter().map(wide).collect())
    }

    fn copy(&self, field: &Self::Field) -> Result<Self::Field> {
        Ok(field.par_iter().copied().collect())
    }

    fn add(&self, terms: &[(f64, &Self::Field)], y: &mut Self::Field) -> Result<()> {
        for &(a, x) in terms {
            let a = T::from_f64(a);
            y.par_iter_mut().zip(x).for_each(|(y, &x)| *y += x * a);
        }
        Ok(())
    }

    fn scale(&self, a: f64, x: &mut Self::Field) -> Result<()> {
        let a = T::from_f64(a);
        x.par_iter_mut().for_each(|x| *x = *x * a);
        Ok(())
    }

    fn multiply(&self, factor: &Self::Field, x: &mut Self::Field) -> Result<()> {
        x.par_iter_mut().zip(factor).for_each(|(x, &f)| *x = *x * f);
        Ok(())
    }

    fn dots(&self, xs: &[&Self::Field], y: &Self::Field) -> Result<Vec<f64>> {
        let product = |(&a, &b): (&C, &C)| -> f64 {
            let channels = (a * b).to_rgb().into_iter().take(C::CHANNELS);
            channels.sum::<T>().to_f64()
        };
        let dot = |x: &&Self::Field| {
            let blocks: Vec<f64> = x
                .par_chunks(BLOCK)
                .zip(y.par_chunks(BLOCK))
                .map(|(x, y)| x.iter().zip(y).map(product).sum())
                .collect();
            blocks.iter().sum()
        };
        Ok(xs.iter().map(dot).collect())
    }
}
