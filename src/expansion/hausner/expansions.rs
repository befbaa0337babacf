//! Multipole and local expansions about a centre.

use glam::DVec3;

use super::basis::Basis;
use super::function::functions;
use super::source_matrix::SourceMatrix;

/// What surfels around a centre send out, seen from afar (C.8).
#[derive(Clone)]
pub struct Multipole<'a> {
    basis: &'a Basis,
    centre: DVec3,
    scale: f64,
    /// M_nj^m with lengths in units of the scale.
    pub coefficients: Vec<SourceMatrix>,
}

/// Light that arrives around a centre from afar (C.29).
#[derive(Clone)]
pub struct Local<'a> {
    basis: &'a Basis,
    centre: DVec3,
    scale: f64,
    /// L_ks^m with the place of the receiver in units of the scale.
    pub coefficients: Vec<SourceMatrix>,
}

impl<'a> Multipole<'a> {
    /// No light. `scale` is a length like that of the sources' distances from the centre; it keeps
    /// the coefficients in range.
    pub fn new(basis: &'a Basis, centre: DVec3, scale: f64) -> Self {
        Multipole {
            basis,
            centre,
            scale,
            coefficients: vec![SourceMatrix::default(); basis.coefficients()],
        }
    }

    /// P2M: adds a surfel with `flux` = A B and unit `normal` (C.10).
    pub fn p2m(&mut self, flux: DVec3, normal: DVec3, position: DVec3) {
        let place = (position - self.centre) / self.scale;
        let source = SourceMatrix::of(flux, normal, place);
        let values = self.basis.p2m(place);
        for (c, value) in self.coefficients.iter_mut().zip(values) {
            c.add(&source, value);
        }
    }

    /// M2M: adds a child (C.23).
    pub fn m2m(&mut self, child: &Multipole) {
        let way = (self.centre - child.centre) / self.scale;
        let from = child.in_unit(self.scale);
        self.basis.m2m(way, &from, &mut self.coefficients);
    }

    /// M2P: irradiance of a surfel with unit `normal` outside the sphere of the sources (C.8).
    pub fn m2p(&self, normal: DVec3, position: DVec3) -> DVec3 {
        let place = (position - self.centre) / self.scale;
        let values = self.basis.m2p(place);
        received(&self.coefficients, &values, normal, place) / (self.scale * self.scale)
    }

    /// The coefficients with lengths in `unit`.
    fn in_unit(&self, unit: f64) -> Vec<SourceMatrix> {
        let ratio = self.scale / unit;
        let powers = |n: i64| [0, 1, 2].map(|power| ratio.powi((n + power) as i32));
        functions(self.basis.order())
            .zip(&self.coefficients)
            .map(|(f, c)| c.scaled(powers(f.n)))
            .collect()
    }
}

impl<'a> Local<'a> {
    /// No light. `scale` is a length like that of the receivers' distances from the centre; it keeps
    /// the coefficients in range.
    pub fn new(basis: &'a Basis, centre: DVec3, scale: f64) -> Self {
        Local {
            basis,
            centre,
            scale,
            coefficients: vec![SourceMatrix::default(); basis.coefficients()],
        }
    }

    /// P2L: adds a surfel with `flux` = A B and unit `normal`, outside the sphere of the receivers
    /// (C.14, in the basis of C.27).
    pub fn p2l(&mut self, flux: DVec3, normal: DVec3, position: DVec3) {
        let place = (position - self.centre) / self.scale;
        let source = SourceMatrix::of(flux, normal, place);
        let values = self.basis.p2l(place);
        for (c, value) in self.coefficients.iter_mut().zip(values) {
            c.add(&source, value / (self.scale * self.scale));
        }
    }

    /// M2L: adds the visible `fraction` of the light of `source`, in the functions up to `order` of
    /// both (C.30). Their spheres must not meet.
    pub fn m2l(&mut self, source: &Multipole, order: usize, fraction: f64) {
        let way = self.centre - source.centre;
        let distance = way.length();
        let order = order.min(self.basis.order());
        let mut light = vec![SourceMatrix::default(); self.coefficients.len()];
        let from = source.in_unit(distance);
        self.basis.m2l(order, way / distance, &from, &mut light);
        self.add(&light, distance, fraction / (distance * distance));
    }

    /// L2L: adds the light of the parent (C.34).
    pub fn l2l(&mut self, parent: &Local) {
        let way = (self.centre - parent.centre) / parent.scale;
        let mut light = vec![SourceMatrix::default(); self.coefficients.len()];
        self.basis.l2l(way, &parent.coefficients, &mut light);
        self.add(&light, parent.scale, 1.0);
    }

    /// L2P: irradiance of a surfel with unit `normal` (C.29).
    pub fn l2p(&self, normal: DVec3, position: DVec3) -> DVec3 {
        let place = (position - self.centre) / self.scale;
        received(&self.coefficients, &self.basis.l2p(place), normal, place)
    }

    /// Adds `factor` times coefficients about the same centre, of places in `unit`.
    fn add(&mut self, light: &[SourceMatrix], unit: f64, factor: f64) {
        // What the source has as a power of its place, the receiver has as 2 minus that power.
        let ratio = self.scale / unit;
        let powers = |n: i64| [2, 1, 0].map(|power| ratio.powi((n + power) as i32));
        let all = functions(self.basis.order()).zip(light);
        for (c, (f, light)) in self.coefficients.iter_mut().zip(all) {
            c.add(&light.scaled(powers(f.n)), factor);
        }
    }
}

/// RM(x) ⊗ the sum of coefficients times values.
fn received(coefficients: &[SourceMatrix], values: &[f64], normal: DVec3, place: DVec3) -> DVec3 {
    let mut sum = SourceMatrix::default();
    for (c, &value) in coefficients.iter().zip(values) {
        sum.add(c, value);
    }
    sum.received(normal, place)
}
