//! M2L of order 1, the order of links with tested visibility, for several links side by side: one link a lane
//! takes half of the time that three colours do.

use std::f64::consts::FRAC_1_PI;

use super::indices::count;
use super::{parts, parts_mut, written_out};
use crate::math::{Colour, Real, Vector};

/// The order.
pub const ORDER: usize = 1;
const COUNT: usize = count(ORDER);
/// Links side by side: one a lane of 256 bits in f32.
const LANES: usize = 8;

/// Where M2L takes light from.
#[derive(Clone, Copy)]
pub struct Link<'m, T: Real, C = <T as Real>::Rgb> {
    pub moments: &'m [C],
    /// From the source's centre to the target's.
    pub way: T::Vec3,
    /// The source's.
    pub scale: T,
    /// The visible part.
    pub fraction: T,
}

type Lanes<T> = [T; LANES];
/// Vectors of each multi-index, component by component and colour by colour.
type Vectors<T> = [[[Lanes<T>; 3]; 3]; COUNT];

struct Several<T: Real> {
    moments: Vectors<T>,
    way: [Lanes<T>; 3],
    scale: Lanes<T>,
    fraction: Lanes<T>,
}

/// Adds the fields of all links to a local expansion with this scale.
pub fn m2l<'m, T: Real, C: Colour<T>>(
    links: impl Iterator<Item = Link<'m, T, C>>,
    scale: T,
    local: &mut [C],
) {
    let mut links = links.peekable();
    if links.peek().is_none() {
        return;
    }
    let zero = [T::ZERO; LANES];
    let mut several = Several {
        moments: [[[zero; 3]; 3]; COUNT],
        way: [zero; 3],
        scale: zero,
        fraction: zero,
    };
    let mut sum: Vectors<T> = [[[zero; 3]; 3]; COUNT];
    let mut taken = 0;
    for link in links {
        several.take(taken, &link);
        taken += 1;
        if taken == LANES {
            several.add::<C>(scale, &mut sum);
            taken = 0;
        }
    }
    if taken > 0 {
        several.leave(taken);
        several.add::<C>(scale, &mut sum);
    }
    for (vector, sum) in parts_mut(local).1.iter_mut().zip(&sum) {
        for (component, colours) in vector.iter_mut().zip(sum) {
            *component += C::from_rgb(colours.map(|lanes| lanes.into_iter().sum()));
        }
    }
}

impl<T: Real> Several<T> {
    /// Puts a link into a lane.
    #[inline(always)]
    fn take<C: Colour<T>>(&mut self, lane: usize, link: &Link<T, C>) {
        for (to, from) in self.moments.iter_mut().zip(parts(link.moments).1) {
            for (to, from) in to.iter_mut().zip(from) {
                for (to, from) in to[..C::CHANNELS].iter_mut().zip(from.to_rgb()) {
                    to[lane] = from;
                }
            }
        }
        for (to, from) in self.way.iter_mut().zip(link.way.to_array()) {
            to[lane] = from;
        }
        self.scale[lane] = link.scale;
        self.fraction[lane] = link.fraction;
    }

    /// Lanes from this one on bring nothing.
    fn leave(&mut self, first: usize) {
        for lane in first..LANES {
            for way in &mut self.way {
                way[lane] = way[0];
            }
            for lanes in self.moments.as_flattened_mut().as_flattened_mut() {
                lanes[lane] = T::ZERO;
            }
        }
    }

    /// Adds their fields, in the widest instructions that the machine has.
    fn add<C: Colour<T>>(&self, scale: T, sum: &mut Vectors<T>) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide<T: Real, C: Colour<T>>(all: &Several<T>, scale: T, sum: &mut Vectors<T>) {
                all.fields::<C>(scale, sum);
            }
            if is_x86_feature_detected!("avx2") {
                // SAFETY: the machine has what `wide` is compiled for.
                return unsafe { wide::<T, C>(self, scale, sum) };
            }
        }
        self.fields::<C>(scale, sum);
    }

    /// Inlined, so that it is compiled for the instructions of the caller. As [`Workspace::m2l`], lane by lane.
    ///
    /// [`Workspace::m2l`]: super::Workspace::m2l
    #[inline(always)]
    fn fields<C: Colour<T>>(&self, scale: T, sum: &mut Vectors<T>) {
        let zero = [T::ZERO; LANES];
        let mut tensors = [[zero; 6]; COUNT];
        let (mut sources, mut weights) = (zero, [zero; 2]);
        // Each loop over lanes has none within, so that it is compiled to instructions for all of them.
        for l in 0..LANES {
            let way = [self.way[0][l], self.way[1][l], self.way[2][l]];
            let inverse = T::ONE / (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            let mut tensor = [[T::ZERO; 6]; COUNT];
            let u = [way[0] * inverse, way[1] * inverse, way[2] * inverse];
            written_out::derive_1::<T, T>(u, &mut tensor);
            for a in 0..COUNT {
                for k in 0..6 {
                    tensors[a][k][l] = tensor[a][k];
                }
            }
            sources[l] = -self.scale[l] * inverse;
            weights[0][l] = -self.fraction[l] * T::from_f64(FRAC_1_PI) * inverse * inverse;
            weights[1][l] = weights[0][l] * scale * inverse;
        }
        for c in 0..C::CHANNELS {
            for l in 0..LANES {
                let mut tensor = [[T::ZERO; 6]; COUNT];
                let mut moments = [[T::ZERO; 3]; COUNT];
                for a in 0..COUNT {
                    for k in 0..6 {
                        tensor[a][k] = tensors[a][k][l];
                    }
                    let factor = if a == 0 { T::ONE } else { sources[l] };
                    for i in 0..3 {
                        moments[a][i] = self.moments[a][i][c][l] * factor;
                    }
                }
                written_out::convolve_1::<T, T>(&tensor, &moments, |b, field| {
                    for i in 0..3 {
                        sum[b][i][c][l] += field[i] * weights[usize::from(b > 0)][l];
                    }
                });
            }
        }
    }
}
