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
use serde::{Deserialize, Serialize};

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
    /// `None` if nobody looked.
    pub shares: Option<HoleShares>,
}

/// Parts of all directions from the surface.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct HoleShares {
    /// That lead to the back of a surface.
    pub backs: f64,
    /// That lead out of the cloud.
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
        let shares = Some(HoleShares { backs, out });
        Ok(Holes { scale, shares })
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
        let shares = self.shares.filter(|shares| shares.backs > LITTLE)?;
        let [backs, out] = [shares.backs, shares.out].map(|x| 100.0 * x);
        Some(format!(
            "{backs:.1}% of all directions lead through holes to the back of a surface: taken for as bright as \
             the others ({out:.1}% lead out)"
        ))
    }
}

/// Less is not worth a word.
const LITTLE: f64 = 0.001;

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use glam::Vec2;

    use super::*;
    use crate::octree::LEAF_SIZE;
    use crate::points::{PointCloud, Thinning};
    use crate::progress::Silent;

    /// A sphere that is lit inside, without a cap over which a plate lies that faces away. From everywhere on
    /// a sphere a part of it takes as much of the directions as of the area. What passes the rim by no more than
    /// its cells are wide counts as meeting it.
    #[test]
    fn a_cap_of_a_sphere_is_as_large_a_hole() {
        let (n, edge) = (16_000, 0.866_f32);
        let mut cloud = PointCloud::default();
        let mut add = |place: Vec3, normal: Vec3| {
            cloud.positions.push(place.as_dvec3());
            cloud.normals.push(normal);
            cloud.reflectance.push(Vec3::splat(0.5));
            cloud.emission.push(Vec3::ZERO);
        };
        for i in 0..n {
            let z = 1.0 - (2 * i + 1) as f32 / n as f32;
            let around = Vec2::from_angle(PI * (5.0_f32.sqrt() - 1.0) * i as f32);
            let place = (around * (1.0 - z * z).sqrt()).extend(z);
            if z < edge {
                add(place, -place);
            }
        }
        for k in 0..120 * 120 {
            let place = Vec3::new((k % 120) as f32 - 59.5, (k / 120) as f32 - 59.5, 0.0) * 0.1;
            add(place + Vec3::Z * (edge + 0.1), Vec3::Z);
        }
        let prepared = Surfels::prepare_fewer(&cloud, &Thinning::default(), &Silent).unwrap();
        let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
        let occluders = Occluders::build(&surfels);
        let holes = Holes::find(&surfels, &octree, &occluders, &Silent).unwrap();
        let cap = 0.5 * (1.0 - edge);
        let place = |i: usize| surfels.positions[i] + surfels.origin.as_vec3();
        let of_sphere: Vec<f32> = (0..surfels.len())
            .filter(|&i| surfels.normals[i].dot(place(i)) < 0.0)
            .map(|i| 1.0 - 1.0 / holes.scale()[i])
            .collect();
        let mean = of_sphere.iter().sum::<f32>() / of_sphere.len() as f32;
        let spacing = (4.0 * PI / n as f32).sqrt();
        let (radius, rim) = ((1.0 - edge * edge).sqrt(), 1.5 * spacing);
        let least = cap * (1.0 - rim / radius).powi(2);
        assert!(
            least < mean && mean < 1.03 * cap,
            "{mean}, not {least} to {cap}"
        );
        // What is scaled and scaled back is the same light.
        let mut light = vec![DVec3::ONE; surfels.len()];
        holes.lower(&mut light);
        holes.fill(&mut light);
        assert!(light.iter().all(|h| (h.x - 1.0).abs() < 1e-12));
    }
}
