//! Passes between two facets: M2L, P2L, M2P.

use std::f64::consts::FRAC_1_PI;

use super::indices::{Indices, count};
use super::side_by_side::{self, Link};
use super::{Workspace, parts, parts_mut, written_out};
use crate::math::{Colour, Numbers, Real, Vector};

impl<T: Real, C: Colour<T>> Workspace<'_, T, C> {
    /// M2L: adds the field of the moments `source` times the visible `fraction`, of an order that
    /// may be lower than that of either expansion. `way` leads from the source's centre to this
    /// one's; `scales` are the source's and this one's.
    pub fn m2l(
        &mut self,
        order: usize,
        source: &[C],
        way: T::Vec3,
        scales: [T; 2],
        fraction: T,
        local: &mut [C],
    ) {
        let far = Far::new(way);
        self.derive(order, far.direction);
        let [source_ratio, target_ratio] = scales.map(|s| s * far.inverse);
        self.scale_moments(order, source, source_ratio);
        self.weigh(order, far.strength(fraction), target_ratio);
        let (tensor, moments, weights) = (&self.tensor, &self.scaled, &self.weights);
        let vectors = &mut parts_mut(local).1[..count(order)];
        let add = |b: usize, field: [C; 3]| {
            for i in 0..3 {
                vectors[b][i] += field[i] * weights[b];
            }
        };
        match order {
            0 => written_out::convolve_0::<T, C>(tensor, moments, add),
            1 => written_out::convolve_1::<T, C>(tensor, moments, add),
            2 => written_out::convolve_2::<T, C>(tensor, moments, add),
            _ => convolve::<T, C>(self.indices, order, tensor, moments, add),
        }
    }

    /// [`m2l`](Self::m2l) of all links of one order to an expansion with this scale.
    pub fn m2l_of_all<'m>(
        &mut self,
        order: usize,
        links: impl Iterator<Item = Link<'m, T, C>>,
        scale: T,
        local: &mut [C],
    ) {
        match order {
            side_by_side::ORDER => side_by_side::m2l(links, scale, local),
            _ => links.for_each(|link| {
                let scales = [link.scale, scale];
                self.m2l(order, link.moments, link.way, scales, link.fraction, local);
            }),
        }
    }

    /// P2L: adds the field of a surfel with `flux` = A B (times its visible part) and unit
    /// `normal`. `way` leads from the surfel to the local expansion's centre.
    pub fn p2l(
        &mut self,
        flux: C,
        normal: T::Vec3,
        way: T::Vec3,
        target_scale: T,
        local: &mut [C],
    ) {
        let order = self.indices.order();
        let far = Far::new(way);
        self.derive(order, far.direction);
        let n = normal.to_array().map(C::splat);
        self.weigh(order, far.strength(T::ONE), target_scale * far.inverse);
        let fields = self.tensor.iter().zip(&self.weights);
        for (l, (tensor, &weight)) in parts_mut(local).1.iter_mut().zip(fields) {
            let field = apply(tensor, &n);
            for i in 0..3 {
                l[i] += flux * (field[i] * weight);
            }
        }
    }

    /// M2P: irradiance of a surfel with unit `normal` from the moments `source`, of an order that may be
    /// lower than theirs. `way` leads from the source's centre to the surfel.
    pub fn m2p(
        &mut self,
        order: usize,
        source: &[C],
        source_scale: T,
        way: T::Vec3,
        normal: T::Vec3,
    ) -> C {
        let far = Far::new(way);
        self.derive(order, far.direction);
        let n = normal.to_array().map(C::splat);
        let step = -source_scale * far.inverse;
        let vectors = parts(source).1;
        let mut irradiance = C::default();
        let mut factor = far.strength(T::ONE);
        for degree in 0..=order {
            let mut sum = C::default();
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
    fn scale_moments(&mut self, order: usize, moments: &[C], ratio: T) {
        let vectors = parts(moments).1;
        let mut factor = T::ONE;
        for degree in 0..=order {
            for a in Indices::of_degree(degree) {
                self.scaled[a] = vectors[a].map(|m| m * factor);
            }
            factor = -factor * ratio;
        }
    }

    /// strength step^|β| / β!
    fn weigh(&mut self, order: usize, strength: T, step: T) {
        let mut factor = strength;
        for degree in 0..=order {
            for b in Indices::of_degree(degree) {
                self.weights[b] = factor * self.inverse_factorials[b];
            }
            factor = factor * step;
        }
    }
}

/// Σ_α T^(α+β) M^α for every β.
fn convolve<T: Real, C: Colour<T>>(
    indices: &Indices,
    order: usize,
    tensor: &[[C; 6]],
    moments: &[[C; 3]],
    mut field: impl FnMut(usize, [C; 3]),
) {
    for degree in 0..=order {
        let moments = &moments[..count(order - degree)];
        for b in Indices::of_degree(degree) {
            field(b, contract::<T, C>(tensor, moments, indices.sums(b)));
        }
    }
}

/// Σ_α T^(α+β) M^α, with the places of all α + β.
#[inline(always)]
pub(super) fn contract<T: Real, C: Numbers<T>>(
    tensor: &[[C; 6]],
    moments: &[[C; 3]],
    sums: &[u16],
) -> [C; 3] {
    let mut field = [C::default(); 3];
    for (m, &sum) in moments.iter().zip(sums) {
        let product = apply(&tensor[usize::from(sum)], m);
        for i in 0..3 {
            field[i] += product[i];
        }
    }
    field
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
        -fraction * T::from_f64(FRAC_1_PI) * self.inverse * self.inverse
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
