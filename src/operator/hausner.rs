//! The operator in the basis of the report.

use std::iter::successors;

use glam::DVec3;
use rayon::prelude::*;

use crate::error::Result;
use crate::expansion::Surface;
use crate::expansion::hausner::{Basis, Local, Multipole};
use crate::links::Links;
use crate::octree::{Facet, Octree};
use crate::operator::{HostFields, TransportOperator};
use crate::passes::cpu::{near_field, p2p};
use crate::points::Surfels;

/// The operator with [`expansion::hausner`](crate::expansion::hausner): a reference for the Cartesian
/// tensors of [`Fmm`](super::Fmm), by the same links, but for mixed ones, which it leaves out.
///
/// An expansion of order p takes 384 C(p+3, 3) bytes, 32 KiB at order 6, and each facet has two: for
/// clouds of some ten thousand surfels.
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
            let range = self.octree.level(level);
            let (above, rest) = locals.split_at_mut(range.start);
            rest[..range.len()]
                .par_iter_mut()
                .zip(&facets[range])
                .for_each(|(local, facet)| local.l2l(&above[facet.parent as usize]));
        }
        locals
    }

    /// L2P at a leaf's surfels, and M2P and sampled links that end at the leaf or above.
    fn at_leaf(
        &self,
        leaf: usize,
        flux: &[DVec3],
        multipoles: &[Multipole],
        locals: &[Local],
    ) -> Vec<DVec3> {
        let (links, facets) = (self.links, &self.octree.facets);
        // Up to the root, which is its own parent.
        let above = |&f: &usize| (f > 0).then(|| facets[f].parent as usize);
        let targets: Vec<usize> = successors(Some(leaf), above).collect();
        let sampled: DVec3 = targets
            .iter()
            .flat_map(|&t| links.sampled.row(t))
            .map(|(s, kernel)| flux[facets[s].surfels()].iter().sum::<DVec3>() * f64::from(kernel))
            .sum();
        facets[leaf]
            .surfels()
            .map(|i| {
                let (normal, x) = (self.surface.normals[i], self.surface.positions[i]);
                let m2p: DVec3 = targets
                    .iter()
                    .flat_map(|&t| links.m2p.row(t))
                    .map(|(s, fraction)| multipoles[s].m2p(normal, x) * f64::from(fraction))
                    .sum();
                locals[leaf].l2p(normal, x) + m2p + sampled
            })
            .collect()
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
        let leaves = self.octree.leaves.par_iter();
        let mut irradiance: Vec<DVec3> = leaves
            .flat_map_iter(|&leaf| self.at_leaf(leaf as usize, &flux, &multipoles, &locals))
            .collect();
        let links = self.links;
        p2p(
            self.octree,
            &self.surface,
            &links.p2p,
            radiosity,
            &mut irradiance,
        );
        near_field::<f64, _>(&links.near, radiosity, &mut irradiance);
        Ok(irradiance)
    }
}

/// Centre and scale of a facet's expansions.
fn frame(facet: &Facet) -> (DVec3, f64) {
    (facet.centre.as_dvec3(), f64::from(facet.scale()))
}
