//! The operator by links: expansions from afar, form factors nearby.

use crate::error::Result;
use crate::expansion::Surface;
use crate::links::Links;
use crate::math::Real;
use crate::octree::Octree;
use crate::operator::{HostFields, TransportOperator};
use crate::passes::cpu::{l2l, l2p, m2l, m2m, near_field, p2m, p2p};
use crate::points::Surfels;

/// The operator on the CPU: f32 is the product, f64 its reference.
pub struct Fmm<'a, T: Real> {
    octree: &'a Octree,
    links: &'a Links,
    surface: Surface<T>,
    fields: HostFields<T>,
}

impl<'a, T: Real> Fmm<'a, T> {
    /// `surfels` are those in the octree's order.
    pub fn new(surfels: &Surfels, octree: &'a Octree, links: &'a Links) -> Self {
        Fmm {
            octree,
            links,
            surface: Surface::new(surfels),
            fields: HostFields::default(),
        }
    }
}

impl<T: Real> TransportOperator for Fmm<'_, T> {
    type Fields = HostFields<T>;

    fn fields(&self) -> &HostFields<T> {
        &self.fields
    }

    fn apply(&self, radiosity: &Vec<T::Vec3>) -> Result<Vec<T::Vec3>> {
        let mut moments = p2m(self.octree, &self.surface, radiosity);
        m2m(self.octree, &mut moments);
        let mut locals = m2l(self.octree, self.links, &moments);
        l2l(self.octree, &mut locals);
        let mut irradiance = l2p(self.octree, &self.surface, &locals);
        p2p(
            self.octree,
            &self.surface,
            &self.links.p2p,
            radiosity,
            &mut irradiance,
        );
        near_field::<T>(&self.links.near, radiosity, &mut irradiance);
        Ok(irradiance)
    }
}
