//! The result: light at every point.

use std::f32::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::error::Result;
use crate::lights::form;
use crate::points::{Neighbours, PointCloud, Surfels};
use crate::progress::Progress;
use crate::scene::PointLight;
use crate::visibility::{NO_SURFEL, Occluders, Segment, blocked, first_hit};

/// Surfels around a point that is none, between which its light lies.
const AROUND: usize = 12;
/// So many around a surfel are looked at for its many points.
const BESIDE: usize = 20;
/// Difference of unit normals, and height over the distance of the farthest of them, at which a surfel
/// counts a quarter.
const BENT: f32 = 0.2;
const ASIDE: f32 = 0.3;
/// Surfels around say whether a lamp is seen if this part of what they count agrees.
const SURE: f32 = 0.95;
/// Cells at an edge that a place may lie behind, and how far, in their radii.
const AT_EDGE: usize = 3;
const BEHIND: f32 = 0.15;
/// Points done between two looks at whether the work should stop.
const BLOCK: usize = 1 << 17;

/// The illumination map: one entry a point of the cloud, in its order.
#[derive(Clone, Debug, Default)]
pub struct IlluminationMap {
    /// Irradiance H, direct and after all bounces (linear RGB; unit of the emission).
    pub irradiance: Vec<Vec3>,
    /// Radiosity B = emission + reflectance * H.
    pub radiosity: Vec<Vec3>,
    /// Unit normals of the side that gets this light; zero where there is none.
    pub normals: Vec<Vec3>,
    /// Radius in the scan's unit of the disc with the point's area; 0 where it stands for no surface.
    pub radius: Vec<f32>,
    /// False for points that were left out of the transport (no usable position or normal, strays, buried, thinned out, or a
    /// duplicate of another point): they send no light.
    pub in_transport: Vec<bool>,
}

/// Light of surfels that is handed to points.
pub(crate) struct Lit<'a> {
    pub surfels: &'a Surfels,
    /// Irradiance of the surfels: what lies between them is their mean.
    pub irradiance: &'a [DVec3],
    /// Lamps whose light is not in it: it is found at each point by itself.
    pub lamps: Vec<Lamp<'a>>,
    /// What stands in their way.
    pub occluders: Option<&'a Occluders>,
}

/// A lamp, and which surfels see it.
pub(crate) struct Lamp<'a> {
    pub light: &'a PointLight,
    /// `None` of those that face away.
    pub seen_from: Vec<Option<bool>>,
}

impl IlluminationMap {
    /// Hands the irradiance of surfels to the points of the cloud, whose places among the surfels are given.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
    pub fn new(
        cloud: &PointCloud,
        places: &[Option<u32>],
        surfels: &Surfels,
        irradiance: &[DVec3],
        progress: &dyn Progress,
    ) -> Result<IlluminationMap> {
        let lit = Lit {
            surfels,
            irradiance,
            lamps: Vec::new(),
            occluders: None,
        };
        IlluminationMap::of(cloud, places, &lit, progress)
    }

    /// Hands the light of surfels to the points of the cloud, whose places among the surfels are given. Points
    /// beside the surfel that stands for them get what lies between the surfels around that face the same
    /// way.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
    pub(crate) fn of(
        cloud: &PointCloud,
        places: &[Option<u32>],
        lit: &Lit,
        progress: &dyn Progress,
    ) -> Result<IlluminationMap> {
        let (n, surfels) = (cloud.len(), lit.surfels);
        let left_out =
            |i: &usize| places[*i].is_some_and(|k| surfels.points[k as usize] != *i as u32);
        let tree = match (0..n).into_par_iter().any(|i| left_out(&i)) {
            true => Some(Neighbours::new(&surfels.positions)?),
            false => None,
        };
        let shared = tree.as_ref().and_then(|tree| tree.shared(BESIDE, n));
        progress.stage("points", n as u64);
        let mut map = IlluminationMap {
            irradiance: Vec::with_capacity(n),
            radiosity: Vec::with_capacity(n),
            normals: Vec::with_capacity(n),
            radius: Vec::with_capacity(n),
            in_transport: Vec::with_capacity(n),
        };
        let light = |i: usize| -> (Vec3, Vec3, f32) {
            let given = cloud.normals.get(i).and_then(|n| n.try_normalize());
            let Some(k) = places[i].map(|k| k as usize) else {
                return (Vec3::ZERO, given.unwrap_or_default(), 0.0);
            };
            let place = (cloud.positions[i] - surfels.origin).as_vec3();
            // Of two sides the one with more light.
            let on_side = |k: usize| {
                // What was told may have turned it.
                let given = given.map(|n| {
                    if n.dot(surfels.normals[k]) < 0.0 {
                        -n
                    } else {
                        n
                    }
                });
                let normal = given.unwrap_or(surfels.normals[k]);
                let mut around = match &tree {
                    Some(tree) if left_out(&i) => {
                        let near = match &shared {
                            Some(shared) => nearest(surfels, &shared[k], place),
                            None => tree.around(place, AROUND),
                        };
                        around(surfels, near, place, normal)
                    }
                    _ => Vec::new(),
                };
                if around.is_empty() {
                    around.push((k, 1.0));
                }
                let sum = |(sum, normals), &(k, weight): &(usize, f32)| {
                    let light = f64::from(weight) * lit.irradiance[k];
                    (sum + light, normals + weight * surfels.normals[k])
                };
                let (light, bent) = around.iter().fold((DVec3::ZERO, Vec3::ZERO), sum);
                let normal = given.unwrap_or(bent.normalize_or(normal));
                (light + lit.of_lamps(k, place, normal, &around), normal)
            };
            let radius = match surfels.stands_for(k, cloud.positions[i]) {
                true => (surfels.areas[k] / PI).sqrt(),
                false => 0.0,
            };
            let (mut light, mut normal) = on_side(k);
            if let Some(back) = surfels.back(k) {
                let other = on_side(back);
                if other.0.element_sum() > light.element_sum() {
                    (light, normal) = other;
                }
            }
            (light.as_vec3(), normal, radius)
        };
        for first in (0..n).step_by(BLOCK) {
            progress.check()?;
            let block = first..(first + BLOCK).min(n);
            let found: Vec<(Vec3, Vec3, f32)> = block.clone().into_par_iter().map(light).collect();
            for (i, (light, normal, radius)) in block.clone().zip(found) {
                map.irradiance.push(light);
                map.radiosity
                    .push(cloud.emission[i] + cloud.reflectance[i] * light);
                map.normals.push(normal);
                map.radius.push(radius);
                map.in_transport.push(places[i].is_some() && !left_out(&i));
            }
            progress.advance(block.len() as u64);
        }
        Ok(map)
    }
}

impl Lit<'_> {
    /// Irradiance from the lamps at a place on the surface of a surfel. Whether a lamp is seen is as the surfels
    /// around say; where they disagree, it is tested.
    fn of_lamps(&self, k: usize, place: Vec3, normal: Vec3, around: &[(usize, f32)]) -> DVec3 {
        let surfels = self.surfels;
        let own = surfels.normals[k];
        // Points scatter about their surface, which is no bump that casts a shadow.
        let beside = own.dot(place - surfels.positions[k]) - surfels.offsets[k];
        let from = place - beside * own;
        let of_lamp = |lamp: &Lamp| {
            let to = (lamp.light.position - surfels.origin).as_vec3();
            let form = form(to - place, normal, surfels.areas[k])?;
            let said = |sums: [f32; 2], &(k, weight): &(usize, f32)| match lamp.seen_from[k] {
                Some(seen) => [sums[0] + if seen { weight } else { 0.0 }, sums[1] + weight],
                None => sums,
            };
            let [seen, all] = around.iter().fold([0.0; 2], said);
            let seen = match (seen >= SURE * all, seen <= (1.0 - SURE) * all) {
                (true, false) => true,
                (false, true) => false,
                _ => self.sees(k, from, to),
            };
            seen.then(|| lamp.light.intensity.as_dvec3() * f64::from(form))
        };
        self.lamps.iter().filter_map(of_lamp).sum()
    }

    /// Whether a lamp is seen from a place on surfel k. What lies in the way is not in it where the place is on that
    /// as well, next to an edge.
    fn sees(&self, k: usize, from: Vec3, to: Vec3) -> bool {
        let Some(occluders) = self.occluders else {
            return true;
        };
        let surfels = self.surfels;
        let mut segment = Segment {
            from: from.to_array(),
            skip_from: k as u32,
            to: to.to_array(),
            skip_to: surfels.back(k).map_or(NO_SURFEL, |back| back as u32),
        };
        if !blocked::<f32>(occluders, &segment) {
            return true;
        }
        let way = (to - from).normalize_or_zero();
        for _ in 0..AT_EDGE {
            let Some(hit) = first_hit::<f32>(occluders, &segment) else {
                return true;
            };
            let j = hit.surfel as usize;
            let size = (surfels.areas[j] / PI).sqrt();
            let height = surfels.normals[j].dot(from - surfels.positions[j]);
            if height.abs() > BEHIND * size {
                return false;
            }
            // Beyond it.
            let cos = surfels.normals[j].dot(way);
            let start = Vec3::from(segment.from);
            let there = surfels.normals[j].dot(surfels.positions[j] - start) / cos;
            if !(0.0..size).contains(&there) {
                return false;
            }
            segment.from = (start + (there + BEHIND * size) * way).to_array();
            segment.skip_from = hit.surfel;
        }
        false
    }
}

/// Of some surfels those nearest to a place, nearest first.
fn nearest(surfels: &Surfels, of: &[u32], place: Vec3) -> Vec<u32> {
    let distance = |k: &u32| surfels.positions[*k as usize].distance_squared(place);
    let mut of: Vec<(f32, u32)> = of.iter().map(|k| (distance(k), *k)).collect();
    of.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    of.into_iter().map(|(_, k)| k).take(AROUND).collect()
}

/// Surfels on one surface with a place, and what they count there: weights ((R - r) / R r)², so that at a surfel
/// it alone counts (R. Franke and G. Nielson, "Smooth interpolation of large sets of scattered data",
/// 1980). Empty if there are none.
fn around(surfels: &Surfels, near: Vec<u32>, place: Vec3, normal: Vec3) -> Vec<(usize, f32)> {
    let distance = |&k: &u32| surfels.positions[k as usize].distance(place);
    let reach = near.last().map_or(0.0, distance);
    let mut weights = Vec::with_capacity(near.len());
    let mut whole = 0.0;
    for k in near.iter().map(|&k| k as usize) {
        let way = surfels.positions[k] - place;
        let far = way.length();
        let same_side = surfels.normals[k].dot(normal) > 0.0;
        if far == 0.0 && same_side {
            return vec![(k, 1.0)];
        }
        let bent = surfels.normals[k].distance_squared(normal) / (BENT * BENT);
        let aside = (surfels.normals[k].dot(way) / (ASIDE * reach)).powi(2);
        let near = (reach - far) / (reach * far * (1.0 + bent) * (1.0 + aside));
        if near > 0.0 && same_side {
            weights.push((k, near * near));
            whole += near * near;
        }
    }
    if !(whole > 0.0 && whole.is_finite()) {
        return Vec::new();
    }
    weights.iter_mut().for_each(|w| w.1 /= whole);
    weights
}

impl IlluminationMap {
    /// The normal of a point: of the side that was lit, or the cloud's own; zero where there is none.
    pub fn normal(&self, cloud: &PointCloud, i: usize) -> Vec3 {
        let normal = self.normals.get(i).or(cloud.normals.get(i));
        normal.copied().unwrap_or(Vec3::ZERO)
    }
}
