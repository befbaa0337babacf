//! Holes of a fitted surface.
//!
//! A ray that meets the back of a surface has come through a hole: between surfels, or where no scanner
//! saw. What it would have met in front of that is not known, and unknown is not dark: such directions
//! bring what those do in the mean that meet a surface.
//!
//! With 1/s the part of these that is known, s F takes the place of the operator F. Surfels with
//! reflectance s ρ that get the light of lamps and sky 1/s times are the same equation, for irradiance/s:
//! what solves it need not know.

use glam::{DVec3, Vec3};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use crate::error::Result;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::{Purpose, Stratified, cosine_direction, stream};
use crate::visibility::{Occluders, first_hit};

/// Rays of a surfel; those of one leaf count together.
const RAYS: u32 = 16;
/// Where more than this part of what is met are backs, it is not the rest that says what they bring.
const MOST: f32 = 1.0 / 3.0;

/// Directions of surfels that lead through holes.
#[derive(Clone, Debug, Default)]
pub(super) struct Holes {
    /// For each surfel what its light from others is multiplied by, from 1 on; empty if that is nowhere needed.
    scale: Vec<f32>,
    /// Part of the directions that lead to backs, of all surface.
    pub backs: f64,
    /// Part that leads out of the cloud.
    pub out: f64,
}

impl Holes {
    /// Those of surfels in the octree's order.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
    pub fn find(
        surfels: &Surfels,
        octree: &Octree,
        occluders: &Occluders,
        progress: &dyn Progress,
    ) -> Result<Holes> {
        progress.stage("holes", 1);
        let reach = surfels.reach();
        // Rays that meet a back, and that meet nothing.
        let of_surfel = |i: usize| -> [u32; 2] {
            let mut random: Pcg64Mcg = stream(0, Purpose::Holes, i as u64);
            let points = Stratified::new(&mut random);
            let (normal, tangent) = (surfels.normals[i], surfels.cells.tangents[i]);
            let mut counts = [0; 2];
            for k in 0..RAYS {
                let [u, v] = points.get(k);
                let way = cosine_direction(normal, tangent, u, v);
                match first_hit::<f32>(occluders, &surfels.ray(i, way * reach)) {
                    Some(hit) if hit.front => {}
                    Some(_) => counts[0] += 1,
                    None => counts[1] += 1,
                }
            }
            counts
        };
        let counts: Vec<[u32; 2]> = (0..surfels.len()).into_par_iter().map(of_surfel).collect();
        progress.check()?;
        let part = |which: usize| {
            let areas = surfels.areas.iter().map(|a| f64::from(*a));
            let (sum, all) = (areas.zip(&counts)).fold((0.0, 0.0), |(sum, all), (area, count)| {
                (sum + area * f64::from(count[which]), all + area)
            });
            sum / (all * f64::from(RAYS)).max(f64::MIN_POSITIVE)
        };
        let (backs, out) = (part(0), part(1));
        let mut scale = vec![1.0; surfels.len()];
        for leaf in octree.facets.iter().filter(|facet| facet.is_leaf()) {
            let sum = |which: usize| leaf.surfels().map(|i| counts[i][which]).sum::<u32>() as f32;
            let met = (RAYS as usize * leaf.surfels().len()) as f32 - sum(1);
            let unknown = (sum(0) / met.max(1.0)).min(MOST);
            scale[leaf.surfels()].fill(1.0 / (1.0 - unknown));
        }
        Ok(Holes { scale, backs, out })
    }

    /// Makes reflectance that of the equation for irradiance/s.
    pub fn raise(&self, reflectance: &mut [Vec3]) {
        let each = reflectance.iter_mut().zip(&self.scale);
        each.for_each(|(r, s)| *r *= *s);
    }

    pub fn scale(&self) -> &[f32] {
        &self.scale
    }

    /// Makes light of lamps and sky that of this equation.
    pub fn lower(&self, lights: &mut [DVec3]) {
        let each = lights.iter_mut().zip(&self.scale);
        each.for_each(|(h, s)| *h /= f64::from(*s));
    }

    /// Makes irradiance of its solution.
    pub fn fill(&self, irradiance: &mut [DVec3]) {
        let each = irradiance.iter_mut().zip(&self.scale);
        each.for_each(|(h, s)| *h *= f64::from(*s));
    }

    /// What is to be said of it.
    pub fn told(&self) -> Option<String> {
        (self.backs > LITTLE).then(|| {
            format!(
                "{:.1}% of all directions lead through holes to the back of a surface: taken for as bright as \
                 the others ({:.1}% lead out)",
                100.0 * self.backs,
                100.0 * self.out
            )
        })
    }
}

/// Less is not worth a word.
const LITTLE: f64 = 0.001;
