//! Clusters of small surfaces, and the light between them as it is defined.
#![allow(dead_code)]

use std::f64::consts::PI;

use fmmgi_gpu::expansion::{Workspace, coefficients};
use fmmgi_gpu::math::{Colour, Real, Vector};
use glam::{DQuat, DVec3};
use rand::{Rng, RngExt};

use crate::clouds::direction;

/// Places, normals and fluxes (red, green, blue) about a centre.
#[derive(Clone, Debug)]
pub struct Cluster {
    pub centre: DVec3,
    pub places: Vec<DVec3>,
    pub normals: Vec<DVec3>,
    pub flux: Vec<DVec3>,
}

impl Cluster {
    /// Within `radius` of `centre`, facing along `axis` within about 25 degrees.
    pub fn ball(rng: &mut impl Rng, centre: DVec3, axis: DVec3, radius: f64, n: usize) -> Cluster {
        let mut c = Cluster {
            centre,
            places: Vec::new(),
            normals: Vec::new(),
            flux: Vec::new(),
        };
        for _ in 0..n {
            c.places
                .push(centre + direction(rng) * (radius * rng.random::<f64>().cbrt()));
            c.normals.push((axis + 0.4 * direction(rng)).normalize());
            let mut flux = || rng.random_range(0.2..1.0) * radius * radius;
            c.flux.push(DVec3::new(flux(), flux(), flux()));
        }
        c
    }

    pub fn moved(&self, turn: DQuat, unit: f64, shift: DVec3) -> Cluster {
        let place = |p: &DVec3| turn * *p * unit + shift;
        Cluster {
            centre: place(&self.centre),
            places: self.places.iter().map(place).collect(),
            normals: self.normals.iter().map(|n| turn * *n).collect(),
            flux: self.flux.iter().map(|f| *f * unit * unit).collect(),
        }
    }

    /// Light n · F of this cluster at a place, without clamp.
    pub fn light(&self, x: DVec3, n: DVec3) -> DVec3 {
        let of = |((y, m), f): ((&DVec3, &DVec3), &DVec3)| {
            let r = x - *y;
            let r2 = r.length_squared();
            *f * (-n.dot(r) * m.dot(r) / (PI * r2 * r2))
        };
        self.places
            .iter()
            .zip(&self.normals)
            .zip(&self.flux)
            .map(of)
            .sum()
    }

    /// Light at all places of this cluster as a target.
    pub fn lit(&self, light: impl FnMut((&DVec3, &DVec3)) -> DVec3) -> Vec<DVec3> {
        self.places.iter().zip(&self.normals).map(light).collect()
    }

    /// Moments about `centre`.
    pub fn moments<T: Real>(
        &self,
        workspace: &mut Workspace<T>,
        order: usize,
        centre: DVec3,
        scale: f64,
    ) -> Vec<T::Rgb> {
        let mut moments = vec![T::Rgb::default(); coefficients(order)];
        for ((p, n), f) in self.places.iter().zip(&self.normals).zip(&self.flux) {
            let place = vector::<T>((*p - centre) / scale);
            workspace.p2m(colour::<T>(*f), vector::<T>(*n), place, &mut moments);
        }
        moments
    }
}

pub fn colour<T: Real>(v: DVec3) -> T::Rgb {
    T::Rgb::from_rgb(v.to_array().map(T::from_f64))
}

pub fn vector<T: Real>(v: DVec3) -> T::Vec3 {
    T::Vec3::from_rgb(v.to_array().map(T::from_f64))
}

pub fn wide<T: Real>(v: T::Rgb) -> DVec3 {
    DVec3::from_array(v.to_rgb().map(T::to_f64))
}

/// Relative L2 difference.
pub fn difference(found: &[DVec3], wanted: &[DVec3]) -> f64 {
    assert_eq!(found.len(), wanted.len());
    let square = |v: &DVec3| v.length_squared();
    let off: f64 = found
        .iter()
        .zip(wanted)
        .map(|(a, b)| square(&(*a - *b)))
        .sum();
    (off / wanted.iter().map(square).sum::<f64>()).sqrt()
}
