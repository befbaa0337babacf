//! The operator by links: expansions from afar, form factors nearby.

use crate::error::Result;
use crate::expansion::Surface;
use crate::links::{Links, MIXED_ORDER};
use crate::math::{Colour, Real};
use crate::octree::Octree;
use crate::operator::{HostFields, TransportOperator};
use crate::passes::cpu::{l2l, l2p, m2l, m2m, m2p, mixed, near_field, p2l, p2m, p2p};
use crate::points::Surfels;

/// The operator on the CPU: f32 is the product, f64 its reference.
pub struct Fmm<'a, T: Real> {
    octree: &'a Octree,
    links: &'a Links,
    surface: Surface<T>,
    fields: HostFields<T>,
}

impl<'a, T: Real> Fmm<'a, T> {
    /// `surfels` are those in the octree's order. Expansions are of the order that the links need.
    pub fn new(surfels: &Surfels, octree: &'a Octree, links: &'a Links) -> Self {
        Fmm {
            octree,
            links,
            surface: Surface::new(surfels),
            fields: HostFields::default(),
        }
    }

    /// The same for grey light: the same bits, of one colour instead of three.
    pub fn grey(&self) -> GreyFmm<'_, T> {
        GreyFmm {
            fmm: self,
            fields: HostFields::default(),
        }
    }

    fn irradiance<C: Colour<T>>(&self, radiosity: &[C]) -> Vec<C> {
        let (octree, links, surface) = (self.octree, self.links, &self.surface);
        let mut moments = p2m(links.order(), octree, surface, radiosity);
        m2m(octree, &mut moments);
        let mut locals = m2l(octree, links, &moments);
        p2l(octree, &links.p2l, surface, radiosity, &mut locals);
        l2l(octree, &mut locals);
        let mut irradiance = l2p(octree, surface, &locals);
        m2p(octree, &links.m2p, surface, &moments, &mut irradiance);
        mixed(
            links.order().min(MIXED_ORDER),
            octree,
            &links.mixed,
            surface,
            radiosity,
            &moments,
            &mut irradiance,
        );
        p2p(octree, surface, &links.p2p, radiosity, &mut irradiance);
        near_field::<T, C>(&links.near, radiosity, &mut irradiance);
        irradiance
    }
}

impl<T: Real> TransportOperator for Fmm<'_, T> {
    type Fields = HostFields<T>;

    fn fields(&self) -> &HostFields<T> {
        &self.fields
    }

    fn apply(&self, radiosity: &Vec<T::Vec3>) -> Result<Vec<T::Vec3>> {
        Ok(self.irradiance(radiosity))
    }
}

/// [`Fmm`] for grey light.
pub struct GreyFmm<'a, T: Real> {
    fmm: &'a Fmm<'a, T>,
    fields: HostFields<T, T>,
}

impl<T: Real> TransportOperator for GreyFmm<'_, T> {
    type Fields = HostFields<T, T>;

    fn fields(&self) -> &HostFields<T, T> {
        &self.fields
    }

    fn apply(&self, radiosity: &Vec<T>) -> Result<Vec<T>> {
        Ok(self.fmm.irradiance(radiosity))
    }
}
