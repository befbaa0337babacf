use std::ops::Range;

use rayon::prelude::*;

use crate::expansion::{NEAR_SPACINGS, Surface};
use crate::links::{Rows, Span};
use crate::math::{Colour, Real, Vector};
use crate::octree::Octree;

/// Receivers side by side: one a lane of 256 bits in f32, two registers in f64.
const LANES: usize = 8;
/// Receivers of one task, at most.
const RECEIVERS: usize = 64;
/// Sources that are summed in a row: so many roundings at most. The sums are added up in f64.
const SOURCES: usize = 128;

/// Square of the near range, at least: without an area, too, a surfel does not light itself.
const SMALLEST: f64 = 1e-36;

/// P2P: adds what the surfels of each facet get, by the clamped point kernel, from those of the
/// facets in its row, times the weight of the link. The kernel is computed on the fly. Pairs near
/// each other ([`Surface::is_near`]) are left out: theirs are the stored form factors.
///
/// Eight f32 pairs take 30 flops each in 26 vector instructions of AVX2, three of them for the near
/// range; 15 compete for the two multipliers of a core: the floor is 0.94 cycles a pair. Rows of
/// thousands of sources take 1.2 (3.5 Gpairs/s a core on Zen 5 at 4.1 GHz); a leaf's ragged last
/// lanes cost more.
pub fn p2p<T: Real, C: Colour<T>>(
    octree: &Octree,
    surface: &Surface<T>,
    rows: &Rows,
    radiosity: &[C],
    irradiance: &mut [C],
) {
    if rows.is_empty() {
        return;
    }
    let sources = Sources::new(surface, radiosity);
    for level in 0..octree.depth() {
        // Facets of one level have no surfels in common, and lie in the octree's order.
        let mut tasks = Vec::new();
        let (mut rest, mut passed) = (&mut *irradiance, 0);
        for target in octree.level(level).filter(|&t| !rows.is_none(t)) {
            let surfels = octree.facets[target].surfels();
            let (_, own) = rest.split_at_mut(surfels.start - passed);
            let (own, after) = own.split_at_mut(surfels.len());
            (rest, passed) = (after, surfels.end);
            let first = surfels.step_by(RECEIVERS);
            tasks.extend(
                first
                    .zip(own.chunks_mut(RECEIVERS))
                    .map(|part| (target, part)),
            );
        }
        tasks
            .par_iter_mut()
            .for_each(|(target, (first, irradiance))| {
                sources.light(*first, irradiance, &rows.spans(octree, *target));
            });
    }
}

/// Brute force: the irradiance of every surfel from all that are not near it, unoccluded.
pub fn all_pairs<T: Real, C: Colour<T>>(surface: &Surface<T>, radiosity: &[C]) -> Vec<C> {
    let all = Span {
        begin: 0,
        end: surface.len() as u32,
        weight: 1.0,
    };
    let sources = Sources::new(surface, radiosity);
    let mut irradiance = vec![C::default(); surface.len()];
    irradiance
        .par_chunks_mut(RECEIVERS)
        .enumerate()
        .for_each(|(k, part)| sources.light(k * RECEIVERS, part, &[all]));
    irradiance
}

/// Surfels as sources, of which each has the charge A B / π.
struct Sources<'a, T: Real, C> {
    surface: &'a Surface<T>,
    charges: Vec<C>,
    /// Square of the near range of each.
    near: Vec<T>,
}

/// A value for each receiver of a group.
type Lanes<T> = [T; LANES];

/// Receivers that are worked on together; what exceeds their number is the last one again.
struct Group<T> {
    position: [Lanes<T>; 3],
    /// Against the normal.
    inward: [Lanes<T>; 3],
    /// Square of the near range.
    near: Lanes<T>,
}

impl<'a, T: Real, C: Colour<T>> Sources<'a, T, C> {
    fn new(surface: &'a Surface<T>, radiosity: &[C]) -> Self {
        let charge = |(&b, &area): (&C, &T)| b * (area / T::PI);
        let near_range = T::from_f64(NEAR_SPACINGS * NEAR_SPACINGS);
        let near = |&area: &T| (near_range * area).max(T::from_f64(SMALLEST));
        Sources {
            surface,
            near: surface.areas.iter().map(near).collect(),
            charges: radiosity
                .par_iter()
                .zip(&surface.areas)
                .map(charge)
                .collect(),
        }
    }

    /// Adds to the irradiance of the surfels from `first` on what they get from those in `spans`.
    fn light(&self, first: usize, irradiance: &mut [C], spans: &[Span]) {
        let mut groups: Vec<(Group<T>, [Lanes<f64>; 3])> = (first..first + irradiance.len())
            .step_by(LANES)
            .map(|k| self.group(k, first + irradiance.len() - 1))
            .map(|group| (group, Default::default()))
            .collect();
        for span in spans {
            let weight = f64::from(span.weight);
            let end = span.end as usize;
            for begin in (span.begin as usize..end).step_by(SOURCES) {
                for (group, sum) in &mut groups {
                    let part = self.gather(group, begin..end.min(begin + SOURCES));
                    for c in 0..C::CHANNELS {
                        for l in 0..LANES {
                            sum[c][l] += part[c][l].to_f64() * weight;
                        }
                    }
                }
            }
        }
        for (irradiance, (_, rgb)) in irradiance.chunks_mut(LANES).zip(&groups) {
            for (l, h) in irradiance.iter_mut().enumerate() {
                *h += C::from_rgb(rgb.map(|sum| T::from_f64(sum[l])));
            }
        }
    }

    /// The receivers from `first` on; after `last` it again.
    fn group(&self, first: usize, last: usize) -> Group<T> {
        let of = |vectors: &[T::Vec3], sign: T| {
            let lane = |l: usize| (vectors[last.min(first + l)] * sign).to_array();
            let lanes: [[T; 3]; LANES] = std::array::from_fn(lane);
            std::array::from_fn(|c| lanes.map(|v| v[c]))
        };
        Group {
            position: of(&self.surface.positions, T::ONE),
            inward: of(&self.surface.normals, -T::ONE),
            near: std::array::from_fn(|l| self.near[last.min(first + l)]),
        }
    }

    /// Red, green and blue of a group from a block of sources, in the widest instructions that the
    /// machine has.
    fn gather(&self, group: &Group<T>, sources: Range<usize>) -> [Lanes<T>; 3] {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2,fma")]
            fn wide<T: Real, C: Colour<T>>(
                all: &Sources<T, C>,
                group: &Group<T>,
                sources: Range<usize>,
            ) -> [Lanes<T>; 3] {
                all.sum::<true>(group, sources)
            }
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                // SAFETY: the machine has what `wide` is compiled for.
                return unsafe { wide(self, group, sources) };
            }
        }
        self.sum::<{ cfg!(target_arch = "aarch64") }>(group, sources)
    }

    /// Inlined, so that it is compiled for the instructions of the caller. `FUSED` says whether they
    /// multiply and add in one.
    #[inline(always)]
    fn sum<const FUSED: bool>(&self, group: &Group<T>, sources: Range<usize>) -> [Lanes<T>; 3] {
        let multiply_add = |a: T, b: T, c: T| {
            if FUSED { a.mul_add(b, c) } else { a * b + c }
        };
        let dot = |a: [T; 3], b: [T; 3], c: T| {
            multiply_add(
                a[0],
                b[0],
                multiply_add(a[1], b[1], multiply_add(a[2], b[2], c)),
            )
        };
        let positions = &self.surface.positions[sources.clone()];
        let normals = &self.surface.normals[sources.clone()];
        let near = &self.near[sources.clone()];
        let charges = &self.charges[sources];
        let mut sum = [[T::ZERO; LANES]; 3];
        for (((y, n), q), &near) in positions.iter().zip(normals).zip(charges).zip(near) {
            let ([y, n], q) = ([y, n].map(|v| v.to_array()), q.to_rgb());
            for l in 0..LANES {
                // From the source to the receiver, with `point_kernel`'s order of operations.
                let r = [0, 1, 2].map(|c| group.position[c][l] - y[c]);
                let inward = [0, 1, 2].map(|c| group.inward[c][l]);
                // As `Surface::is_near` does, not fused: on a grid many pairs are at its very range.
                let square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2];
                let range = if near > group.near[l] {
                    near
                } else {
                    group.near[l]
                };
                let inverse = if square < range {
                    T::ZERO
                } else {
                    T::ONE / square
                };
                let cos_x = positive(dot(inward, r, T::ZERO));
                let cos_y = positive(dot(n, r, T::ZERO));
                let kernel = (cos_x * inverse) * (cos_y * inverse);
                for c in 0..C::CHANNELS {
                    sum[c][l] = multiply_add(kernel, q[c], sum[c][l]);
                }
            }
        }
        sum
    }
}

/// max(0, x) in one instruction, which `Real::max` is not: that cares for NaN.
#[inline(always)]
fn positive<T: Real>(x: T) -> T {
    if x > T::ZERO { x } else { T::ZERO }
}
