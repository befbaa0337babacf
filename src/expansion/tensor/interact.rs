//! Passes between two facets: M2L, P2L, M2P.

use super::indices::{Indices, count};
use super::{Workspace, parts, parts_mut};
use crate::math::{Real, Vector};

impl<T: Real> Workspace<'_, T> {
    /// M2L: adds the field of the moments `source` times the visible `fraction`, of an order that
    /// may be lower than that of either expansion. `way` leads from the source's centre to this
    /// one's.
    pub fn m2l(
        &mut self,
        order: usize,
        source: &[T::Rgb],
        source_scale: T,
        way: T::Vec3,
        target_scale: T,
        fraction: T,
        local: &mut [T::Rgb],
    ) {
        let far = Far::new(way);
        self.derive(order, far.direction);
        self.scale_moments(order, source, source_scale * far.inverse);
        let vectors = parts_mut(local).1;
        let step = target_scale * far.inverse;
        let mut strength = far.strength(fraction);
        for degree in 0..=order {
            let moments = &self.scaled[..count(order - degree)];
            for b in Indices::of_degree(degree) {
                let mut field = [T::Rgb::default(); 3];
                for (m, &sum) in moments.iter().zip(self.indices.sums(b)) {
                    let product = apply(&self.tensor[usize::from(sum)], m);
                    for i in 0..3 {
                        field[i] += product[i];
                    }
                }
                let factor = strength / self.factorials[b];
                for i in 0..3 {
                    vectors[b][i] += field[i] * factor;
                }
            }
            strength = strength * step;
        }
    }

    /// P2L: adds the field of a surfel with `flux` = A B (times its visible part) and unit `normal`.
    /// `way` leads from the surfel to the local expansion's centre.
    pub fn p2l(
        &mut self,
        flux: T::Rgb,
        normal: T::Vec3,
        way: T::Vec3,
        target_scale: T,
        local: &mut [T::Rgb],
    ) {
        let order = self.indices.order();
        let far = Far::new(way);
        self.derive(order, far.direction);
        let n = normal.to_array().map(T::Rgb::splat);
        let step = target_scale * far.inverse;
        let mut strength = far.strength(T::ONE);
        let vectors = parts_mut(local).1;
        for degree in 0..=order {
            for b in Indices::of_degree(degree) {
                let field = apply(&self.tensor[b], &n);
                let flux = flux * (strength / self.factorials[b]);
                for i in 0..3 {
                    vectors[b][i] += flux * field[i];
                }
            }
            strength = strength * step;
        }
    }

    /// M2P: irradiance of a surfel with unit `normal` from the moments `source`. `way` leads from
    /// the source's centre to the surfel.
    pub fn m2p(
        &mut self,
        source: &[T::Rgb],
        source_scale: T,
        way: T::Vec3,
        normal: T::Vec3,
    ) -> T::Rgb {
        let order = self.indices.order();
        let far = Far::new(way);
        self.derive(order, far.direction);
        let n = normal.to_array().map(T::Rgb::splat);
        let step = -source_scale * far.inverse;
        let vectors = parts(source).1;
        let mut irradiance = T::Rgb::default();
        let mut factor = far.strength(T::ONE);
        for degree in 0..=order {
            let mut sum = T::Rgb::default();
            for a in Indices::of_degree(degree) {
                let [x, y, z] = apply(&self.tensor[a], &n);
                let m = &vectors[a];
                sum += m[0] * x + m[1] * y + m[2] * z;
            }
            irradiance += sum * factor;
            factor = factor * step;
        }
        irradiance
    }

    /// M^α (-ratio)^|α|.
    fn scale_moments(&mut self, order: usize, moments: &[T::Rgb], ratio: T) {
        let vectors = parts(moments).1;
        let mut factor = T::ONE;
        for degree in 0..=order {
            for a in Indices::of_degree(degree) {
                self.scaled[a] = vectors[a].map(|m| m * factor);
            }
            factor = -factor * ratio;
        }
    }
}

/// A way between two centres.
struct Far<T: Real> {
    direction: T::Vec3,
    /// 1 / distance
    inverse: T,
}

impl<T: Real> Far<T> {
    #[inline(always)]
    fn new(way: T::Vec3) -> Self {
        let inverse = T::ONE / way.length();
        Far {
            direction: way * inverse,
            inverse,
        }
    }

    /// -fraction / (π distance²)
    #[inline(always)]
    fn strength(&self, fraction: T) -> T {
        -fraction / T::PI * self.inverse * self.inverse
    }
}

/// The symmetric tensor times a vector.
#[inline(always)]
fn apply<C>(tensor: &[C; 6], v: &[C; 3]) -> [C; 3]
where
    C: Copy + std::ops::Add<Output = C> + std::ops::Mul<Output = C>,
{
    let [xx, xy, xz, yy, yz, zz] = *tensor;
    [
        xx * v[0] + xy * v[1] + xz * v[2],
        xy * v[0] + yy * v[1] + yz * v[2],
        xz * v[0] + yz * v[1] + zz * v[2],
    ]
}
