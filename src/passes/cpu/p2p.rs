use std::ops::Range;

use rayon::prelude::*;

use crate::expansion::{NEAR_SPACINGS, Surface};
use crate::links::{Rows, Span};
use crate::math::{Real, Vector};
use crate::octree::Octree;

/// Receivers side by side: one a lane of 256 bits in f32, two registers in f64.
const LANES: usize = 8;
/// Receivers of one task, at most.
const RECEIVERS: usize = 64;
/// Sources that are summed before they are added to the rest, which keeps rounding small. In f32
/// they take 20 KiB, so that all receivers of a task find them in the first cache.
const SOURCES: usize = 512;

/// P2P: adds what the surfels of each facet get, by the clamped point kernel, from those of the
/// facets in its row, times the weight of the link. The kernel is computed on the fly. Pairs near
/// each other ([`Surface::is_near`]) are left out: theirs are the stored form factors.
///
/// An f32 pair takes 24 vector instructions for eight lanes, of which 15 (nine fused) compete for
/// the two multipliers of a core: the floor is one cycle a pair.
pub fn p2p<T: Real>(
    octree: &Octree,
    surface: &Surface<T>,
    rows: &Rows,
    radiosity: &[T::Vec3],
    irradiance: &mut [T::Vec3],
) {
    if rows.is_empty() {
        return;
    }
    let sources = Sources::new(surface, radiosity);
    let targets: Vec<usize> = (0..octree.facets.len())
        .filter(|&t| rows.row(t).next().is_some())
        .collect();
    let sums: Vec<Vec<T::Vec3>> = targets
        .par_iter()
        .map(|&t| sources.at_all(octree.facets[t].surfels(), &rows.spans(octree, t)))
        .collect();
    // One by one: a facet and a part of it may both be targets.
    for (&t, sums) in targets.iter().zip(&sums) {
        let surfels = octree.facets[t].surfels();
        for (h, &sum) in irradiance[surfels].iter_mut().zip(sums) {
            *h += sum;
        }
    }
}

/// Brute force: the irradiance of every surfel from all that are not near it, unoccluded.
pub fn all_pairs<T: Real>(surface: &Surface<T>, radiosity: &[T::Vec3]) -> Vec<T::Vec3> {
    let n = surface.len();
    let all = Span {
        begin: 0,
        end: n as u32,
        weight: 1.0,
    };
    Sources::new(surface, radiosity).at_all(0..n, &[all])
}

/// Surfels as sources, of which each has the charge A B / π.
struct Sources<'a, T: Real> {
    surface: &'a Surface<T>,
    charges: Vec<T::Vec3>,
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

impl<'a, T: Real> Sources<'a, T> {
    fn new(surface: &'a Surface<T>, radiosity: &[T::Vec3]) -> Self {
        let charge = |(&b, &area): (&T::Vec3, &T)| b * (area / T::PI);
        let near_range = T::from_f64(NEAR_SPACINGS * NEAR_SPACINGS);
        Sources {
            surface,
            near: surface.areas.iter().map(|&a| near_range * a).collect(),
            charges: radiosity
                .par_iter()
                .zip(&surface.areas)
                .map(charge)
                .collect(),
        }
    }

    /// Irradiance of receivers from the surfels in `spans`.
    fn at_all(&self, receivers: Range<usize>, spans: &[Span]) -> Vec<T::Vec3> {
        let all: Vec<usize> = receivers.collect();
        all.par_chunks(RECEIVERS)
            .flat_map_iter(|receivers| self.at(receivers, spans))
            .collect()
    }

    /// The same of the receivers of one task.
    fn at(&self, receivers: &[usize], spans: &[Span]) -> impl Iterator<Item = T::Vec3> + use<T> {
        let groups: Vec<Group<T>> = receivers
            .chunks(LANES)
            .map(|lanes| self.group(lanes))
            .collect();
        let mut sums = vec![[[T::ZERO; LANES]; 3]; groups.len()];
        for span in spans {
            let weight = T::from_f32(span.weight);
            let (begin, end) = (span.begin as usize, span.end as usize);
            for first in (begin..end).step_by(SOURCES) {
                let block = first..(first + SOURCES).min(end);
                for (group, sum) in groups.iter().zip(&mut sums) {
                    let part = self.gather(group, block.clone());
                    for c in 0..3 {
                        for l in 0..LANES {
                            sum[c][l] += part[c][l] * weight;
                        }
                    }
                }
            }
        }
        let lanes =
            move |[r, g, b]: [Lanes<T>; 3]| (0..LANES).map(move |l| T::Vec3::new(r[l], g[l], b[l]));
        sums.into_iter().flat_map(lanes).take(receivers.len())
    }

    fn group(&self, receivers: &[usize]) -> Group<T> {
        let of = |vectors: &[T::Vec3], sign: T| {
            let lane =
                |l: usize| (vectors[receivers[l.min(receivers.len() - 1)]] * sign).to_array();
            let lanes: [[T; 3]; LANES] = std::array::from_fn(lane);
            std::array::from_fn(|c| lanes.map(|v| v[c]))
        };
        Group {
            position: of(&self.surface.positions, T::ONE),
            inward: of(&self.surface.normals, -T::ONE),
            near: std::array::from_fn(|l| self.near[receivers[l.min(receivers.len() - 1)]]),
        }
    }

    /// Red, green and blue of a group from a block of sources, in the widest instructions that the
    /// machine has.
    fn gather(&self, group: &Group<T>, sources: Range<usize>) -> [Lanes<T>; 3] {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2,fma")]
            fn wide<T: Real>(
                all: &Sources<T>,
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
            let [y, n, q] = [y, n, q].map(|v| v.to_array());
            for l in 0..LANES {
                // From the source to the receiver, with `point_kernel`'s order of operations.
                let r = [0, 1, 2].map(|c| group.position[c][l] - y[c]);
                let inward = [0, 1, 2].map(|c| group.inward[c][l]);
                let square = dot(r, r, T::ZERO);
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
                for c in 0..3 {
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
