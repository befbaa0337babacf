//! The operator in the basis of the report.

use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use crate::error::Result;
use crate::expansion::Surface;
use crate::expansion::hausner::{Basis, Local, Multipole};
use crate::links::Links;
use crate::octree::{Facet, Octree};
use crate::operator::{HostFields, TransportOperator};
use crate::points::Surfels;

/// The operator with Hausner's functions for expansions: a reference for the Cartesian tensors, by
/// the same links.
///
/// An expansion of order p takes 384 C(p+3, 3) bytes, 32 KiB at order 6, and each facet has two: for
/// clouds of some thousand surfels.
pub struct Hausner<'a> {
    octree: &'a Octree,
    links: &'a Links,
    surface: Surface<f64>,
    basis: Basis,
    fields: HostFields<f64>,
}

impl<'a> Hausner<'a> {
    /// `surfels` are those in the octree's order; `order` is that of moments and local expansions.
    /// Links of a higher order are taken at this one.
    pub fn new(surfels: &Surfels, octree: &'a Octree, links: &'a Links, order: usize) -> Self {
        Hausner {
            octree,
            links,
            surface: Surface::new(surfels),
            basis: Basis::new(order),
            fields: HostFields::default(),
        }
    }

    /// P2M and M2M, from the leaves up.
    fn multipoles(&self, flux: &[DVec3]) -> Vec<Multipole<'_>> {
        let facets = &self.octree.facets;
        let mut multipoles: Vec<Multipole> = facets
            .par_iter()
            .map(|facet| {
                let (centre, scale) = frame(facet);
                let mut multipole = Multipole::new(&self.basis, centre, scale);
                if facet.is_leaf() {
                    for j in facet.surfels() {
                        let (normal, y) = (self.surface.normals[j], self.surface.positions[j]);
                        multipole.p2m(flux[j], normal, y);
                    }
                }
                multipole
            })
            .collect();
        for level in (0..self.octree.depth()).rev() {
            let range = self.octree.level(level);
            let (upper, below) = multipoles.split_at_mut(range.end);
            upper[range.clone()]
                .par_iter_mut()
                .zip(&facets[range.clone()])
                .for_each(|(parent, facet)| {
                    for c in facet.children() {
                        parent.m2m(&below[c as usize - range.end]);
                    }
                });
        }
        multipoles
    }

    /// M2L and P2L, then L2L from the root down.
    fn locals(&self, flux: &[DVec3], multipoles: &[Multipole]) -> Vec<Local<'_>> {
        let facets = &self.octree.facets;
        let mut locals: Vec<Local> = facets
            .par_iter()
            .enumerate()
            .map(|(t, facet)| {
                let (centre, scale) = frame(facet);
                let mut local = Local::new(&self.basis, centre, scale);
                for (order, rows) in self.links.m2l.iter().enumerate() {
                    for (s, fraction) in rows.row(t) {
                        local.m2l(&multipoles[s], order, f64::from(fraction));
                    }
                }
                for (s, fraction) in self.links.p2l.row(t) {
                    for j in facets[s].surfels() {
                        let (normal, y) = (self.surface.normals[j], self.surface.positions[j]);
                        local.p2l(flux[j] * f64::from(fraction), normal, y);
                    }
                }
                local
            })
            .collect();
        for level in 1..self.octree.depth() {
            let Range { start, end } = self.octree.level(level);
            let (above, rest) = locals.split_at_mut(start);
            rest[..end - start]
                .par_iter_mut()
                .zip(&facets[start..end])
                .for_each(|(local, facet)| local.l2l(&above[facet.parent as usize]));
        }
        locals
    }

    /// M2P, P2P and sampled links that end at facet `t`: irradiance of its surfel `i`.
    fn received(
        &self,
        t: usize,
        i: usize,
        radiosity: &[DVec3],
        flux: &[DVec3],
        multipoles: &[Multipole],
    ) -> DVec3 {
        let (links, facets) = (self.links, &self.octree.facets);
        let (normal, x) = (self.surface.normals[i], self.surface.positions[i]);
        let mut irradiance = DVec3::ZERO;
        for (s, fraction) in links.m2p.row(t) {
            irradiance += multipoles[s].m2p(normal, x) * f64::from(fraction);
        }
        for (s, fraction) in links.p2p.row(t) {
            let pair = |j: usize| radiosity[j] * self.surface.point_form_factor(i, j);
            let light: DVec3 = facets[s].surfels().map(pair).sum();
            irradiance += light * f64::from(fraction);
        }
        for (s, kernel) in links.sampled.row(t) {
            let power: DVec3 = flux[facets[s].surfels()].iter().sum();
            irradiance += power * f64::from(kernel);
        }
        irradiance
    }
}

impl TransportOperator for Hausner<'_> {
    type Fields = HostFields<f64>;

    fn fields(&self) -> &HostFields<f64> {
        &self.fields
    }

    fn apply(&self, radiosity: &Vec<DVec3>) -> Result<Vec<DVec3>> {
        let areas = self.surface.areas.iter();
        let flux: Vec<DVec3> = radiosity.iter().zip(areas).map(|(&b, &a)| b * a).collect();
        let multipoles = self.multipoles(&flux);
        let locals = self.locals(&flux, &multipoles);
        let facets = &self.octree.facets;
        let mut leaves: Vec<usize> = (0..facets.len()).filter(|&f| facets[f].is_leaf()).collect();
        leaves.sort_unstable_by_key(|&f| facets[f].begin);
        let irradiance = |leaf: usize, i: usize| {
            let mut sum = locals[leaf].l2p(self.surface.normals[i], self.surface.positions[i]);
            // The leaf and all above it, down from the root, which is its own parent.
            let mut t = leaf;
            loop {
                sum += self.received(t, i, radiosity, &flux, &multipoles);
                if t == 0 {
                    break;
                }
                t = facets[t].parent as usize;
            }
            for (j, form_factor) in self.links.near.row(i) {
                sum += radiosity[j] * f64::from(form_factor);
            }
            sum
        };
        Ok(leaves
            .par_iter()
            .flat_map_iter(|&leaf| facets[leaf].surfels().map(move |i| (leaf, i)))
            .map(|(leaf, i)| irradiance(leaf, i))
            .collect())
    }
}

/// Centre and scale of a facet's expansions.
fn frame(facet: &Facet) -> (DVec3, f64) {
    (facet.centre.as_dvec3(), f64::from(facet.scale()))
}
