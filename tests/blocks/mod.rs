//! Steps of the error from surfel to surfel, on cornell's back wall.
#![allow(dead_code)]

use std::collections::BTreeMap;

use fmmgi_gpu::Illumination;
use fmmgi_gpu::operator::exact_irradiance;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use glam::DVec3;

/// Neighbours of a place.
const NEIGHBOURS: usize = 8;

/// Places on the wall with their neighbours, and the light there.
pub struct Wall {
    /// Surfel and neighbour.
    pairs: Vec<(usize, usize)>,
    /// By surfel: irradiance, and by exact sums over the same radiosity.
    pub light: BTreeMap<usize, (DVec3, DVec3)>,
}

impl Wall {
    /// So many places, spread over the wall z = 0.
    pub fn back(lit: &Illumination, places: usize) -> Wall {
        let s = &lit.surfels;
        let height = |i: usize| f64::from(s.positions[i].z) + s.origin.z;
        let on_wall = |&i: &usize| s.normals[i].z > 0.9 && height(i) < 1e-3;
        let wall: Vec<usize> = (0..s.len()).filter(on_wall).collect();
        let step = wall.len().div_ceil(places);
        let mut pairs = Vec::new();
        for &i in wall.iter().step_by(step) {
            let distance = |j: usize| s.positions[i].distance_squared(s.positions[j]);
            let mut others: Vec<usize> = wall.iter().copied().filter(|&j| j != i).collect();
            others.select_nth_unstable_by(NEIGHBOURS, |&a, &b| distance(a).total_cmp(&distance(b)));
            pairs.extend(others[..NEIGHBOURS].iter().map(|&j| (i, j)));
        }
        let mut receivers: Vec<usize> = pairs.iter().flat_map(|&(i, j)| [i, j]).collect();
        receivers.sort_unstable();
        receivers.dedup();
        let of = |values: &[glam::Vec3], i: usize| values[s.points[i] as usize].as_dvec3();
        let radiosity: Vec<DVec3> = (0..s.len()).map(|i| of(&lit.map.radiosity, i)).collect();
        let occluders = Occluders::build(s);
        let visibility = CpuVisibility::<f32>::new(&occluders);
        let exact = exact_irradiance(s, &visibility, &receivers, &radiosity).unwrap();
        let light = receivers.iter().zip(exact);
        let light = light.map(|(&i, (exact, _))| (i, (of(&lit.map.irradiance, i), exact)));
        Wall {
            pairs,
            light: light.collect(),
        }
    }

    /// 99th percentile of the differences between the errors of neighbours, relative to the light.
    pub fn p99(&self) -> f64 {
        let error = |i: usize| {
            let (found, exact) = self.light[&i];
            (found - exact).element_sum()
        };
        let difference =
            |&(i, j): &(usize, usize)| (error(i) - error(j)).abs() / self.light[&i].1.element_sum();
        let mut differences: Vec<f64> = self.pairs.iter().map(difference).collect();
        differences.sort_unstable_by(f64::total_cmp);
        differences[differences.len() * 99 / 100]
    }
}
