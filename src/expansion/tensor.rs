//! Cartesian tensor expansion to first order, of source and of receiver.
//!
//! Coefficients hold red, green and blue together and are scaled by the radius of their facet, so
//! that they keep their size whatever the unit of the scan.

use crate::math::{Real, Vector};

/// What a facet sends out, seen from afar.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moments<T: Real> {
    /// Q_k = Σ A B n_k.
    pub charge: [T::Vec3; 3],
    /// M_kj = Σ A B n_k s_j / scale, with s the place relative to the facet's centre.
    pub dipole: [[T::Vec3; 3]; 3],
    /// Σ A B.
    pub power: T::Vec3,
}

/// Light that arrives at a facet from afar.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Local<T: Real> {
    /// F_i at the facet's centre; irradiance is n · F.
    pub field: [T::Vec3; 3],
    /// G_il = scale * ∂F_i/∂x_l.
    pub gradient: [[T::Vec3; 3]; 3],
    /// Irradiance that does not depend on the normal: from sampled links.
    pub constant: T::Vec3,
}

impl<T: Real> Moments<T> {
    /// P2M: adds a surfel with `flux` = A B and unit `normal` at `place` = s / scale.
    pub fn add_surfel(&mut self, flux: T::Vec3, normal: T::Vec3, place: T::Vec3) {
        let place = place.to_array();
        for (k, n) in normal.to_array().into_iter().enumerate() {
            let q = flux * n;
            self.charge[k] += q;
            for (j, s) in place.into_iter().enumerate() {
                self.dipole[k][j] += q * s;
            }
        }
        self.power += flux;
    }

    /// M2M: adds a child whose scale is `ratio` times this one's, its centre at `place`, in units
    /// of this one's scale.
    pub fn add_child(&mut self, child: &Moments<T>, ratio: T, place: T::Vec3) {
        let place = place.to_array();
        for k in 0..3 {
            self.charge[k] += child.charge[k];
            for (j, s) in place.into_iter().enumerate() {
                self.dipole[k][j] += child.dipole[k][j] * ratio + child.charge[k] * s;
            }
        }
        self.power += child.power;
    }
}

impl<T: Real> Local<T> {
    /// M2L: adds the field of `source` times the visible `fraction`. The vector from the source's
    /// centre to this one's is `distance * direction`; scales of both are in units of the distance.
    ///
    /// F_i = -1/(π d²) [u_i (u·Q) - σ (u_k M_ki + u_i tr M - 4 u_i (u·M u))] with d the distance, u
    /// the direction and σ the source's scale; the gradient is its derivative.
    pub fn add_moments(
        &mut self,
        source: &Moments<T>,
        direction: T::Vec3,
        distance: T,
        source_scale: T,
        target_scale: T,
        fraction: T,
    ) {
        let u = direction.to_array();
        let strength = -fraction / (T::PI * distance * distance);
        let (four, twenty_four) = (T::from_f64(4.0), T::from_f64(24.0));
        let q = &source.charge;
        let m = &source.dipole;
        let contract = |v: &[T::Vec3; 3]| v[0] * u[0] + v[1] * u[1] + v[2] * u[2];
        let uq = contract(q);
        let trace = m[0][0] + m[1][1] + m[2][2];
        let mu: [T::Vec3; 3] = std::array::from_fn(|k| contract(&m[k]));
        let um: [T::Vec3; 3] =
            std::array::from_fn(|j| m[0][j] * u[0] + m[1][j] * u[1] + m[2][j] * u[2]);
        let umu = contract(&mu);
        // Derivative of the zeroth term along l and, contracted with M, the first-order field.
        let first: [T::Vec3; 3] =
            std::array::from_fn(|i| um[i] + trace * u[i] - umu * (four * u[i]));
        for i in 0..3 {
            self.field[i] += (uq * u[i] - first[i] * source_scale) * strength;
            for l in 0..3 {
                let delta = if i == l { T::ONE } else { T::ZERO };
                let ul = u[i] * u[l];
                let zeroth = uq * (delta - four * ul) + q[l] * u[i];
                let second = m[l][i] + trace * (delta - four * ul)
                    - (um[i] * u[l] + um[l] * u[i] + mu[l] * u[i]) * four
                    - umu * (four * delta - twenty_four * ul);
                self.gradient[i][l] += (zeroth - second * source_scale) * (strength * target_scale);
            }
        }
    }

    /// L2L: this local expansion about a child's centre at `place`, in units of this one's scale,
    /// for a child whose scale is `ratio` times this one's.
    pub fn at_child(&self, ratio: T, place: T::Vec3) -> Local<T> {
        let place = place.to_array();
        Local {
            field: std::array::from_fn(|i| self.field[i] + self.slope(i, place)),
            gradient: self.gradient.map(|row| row.map(|g| g * ratio)),
            constant: self.constant,
        }
    }

    /// Adds another expansion about the same centre.
    pub fn add(&mut self, other: &Local<T>) {
        for i in 0..3 {
            self.field[i] += other.field[i];
            for l in 0..3 {
                self.gradient[i][l] += other.gradient[i][l];
            }
        }
        self.constant += other.constant;
    }

    /// L2P: irradiance of a surfel with unit `normal` at `place` = t / scale.
    pub fn irradiance(&self, normal: T::Vec3, place: T::Vec3) -> T::Vec3 {
        let place = place.to_array();
        normal
            .to_array()
            .into_iter()
            .enumerate()
            .fold(self.constant, |sum, (i, n)| {
                sum + (self.field[i] + self.slope(i, place)) * n
            })
    }

    fn slope(&self, i: usize, place: [T; 3]) -> T::Vec3 {
        let g = &self.gradient[i];
        g[0] * place[0] + g[1] * place[1] + g[2] * place[2]
    }
}
