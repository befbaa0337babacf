//! Planes through points by least squares.

use glam::DVec3;

/// A plane by least squares: the principal axes of some places.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Plane {
    /// A unit vector along the axis of the least variance, of either sign.
    pub normal: DVec3,
    /// Mean of the places.
    pub centre: DVec3,
    /// Variances along the principal axes, least first.
    pub variances: [f64; 3],
}

/// Heights beyond this many medians of all heights are no part of the plane.
const TRIM: f64 = 4.0;

impl Plane {
    /// The plane of at least one place.
    pub fn fit(places: impl Iterator<Item = DVec3> + Clone) -> Plane {
        let (sum, count) = places
            .clone()
            .fold((DVec3::ZERO, 0.0), |(sum, n), p| (sum + p, n + 1.0));
        let centre = sum / count;
        let mut m = [0.0; 6];
        for p in places {
            let d = p - centre;
            let terms = [
                d.x * d.x,
                d.y * d.y,
                d.z * d.z,
                d.x * d.y,
                d.x * d.z,
                d.y * d.z,
            ];
            m.iter_mut().zip(terms).for_each(|(m, t)| *m += t);
        }
        let (normal, variances) = least_axis(m.map(|m| m / count));
        Plane {
            normal,
            centre,
            variances,
        }
    }

    /// The plane of most of the places: the few that lie far off it do not count.
    pub fn robust(places: &[DVec3], heights: &mut Vec<f64>) -> Plane {
        let plane = Plane::fit(places.iter().copied());
        heights.clear();
        heights.extend(places.iter().map(|&p| plane.height(p).abs()));
        let middle = heights.len() / 2;
        let (.., &mut median, _) = heights.select_nth_unstable_by(middle, f64::total_cmp);
        let near = |p: &DVec3| plane.height(*p).abs() <= TRIM * median;
        if places.iter().all(near) {
            return plane;
        }
        Plane::fit(places.iter().copied().filter(near))
    }

    /// Signed distance of a place from the plane.
    pub fn height(&self, place: DVec3) -> f64 {
        self.normal.dot(place - self.centre)
    }

    /// Root of the mean square of the heights.
    pub fn rms(&self) -> f64 {
        self.variances[0].sqrt()
    }
}

/// Eigenvector of the least eigenvalue, and all eigenvalues from the least on, of the symmetric matrix
/// [xx, yy, zz, xy, xz, yz] without negative ones (Smith, "Eigenvalues of a symmetric 3 × 3 matrix",
/// 1961).
pub(super) fn least_axis([xx, yy, zz, xy, xz, yz]: [f64; 6]) -> (DVec3, [f64; 3]) {
    let mean = (xx + yy + zz) / 3.0;
    let off = xy * xy + xz * xz + yz * yz;
    let [a, b, c] = [xx - mean, yy - mean, zz - mean];
    let p = ((a * a + b * b + c * c + 2.0 * off) / 6.0).sqrt();
    if p <= f64::EPSILON * mean {
        return (DVec3::Z, [mean; 3]);
    }
    let half_determinant =
        (a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)) / 2.0;
    let angle = (half_determinant / p.powi(3)).clamp(-1.0, 1.0).acos() / 3.0;
    let largest = mean + 2.0 * p * angle.cos();
    let least = mean + 2.0 * p * (angle + std::f64::consts::TAU / 3.0).cos();
    let middle = 3.0 * mean - largest - least;
    // The rows of A - λ are orthogonal to the eigenvector of λ.
    let across = |value: f64| {
        let rows = [
            DVec3::new(xx - value, xy, xz),
            DVec3::new(xy, yy - value, yz),
            DVec3::new(xz, yz, zz - value),
        ];
        [(0, 1), (0, 2), (1, 2)]
            .map(|(i, j)| rows[i].cross(rows[j]))
            .into_iter()
            .max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))
            .unwrap_or_default()
    };
    let axis = across(least);
    // On a line all directions across it are alike.
    let axis = if axis.length() > 1e-12 * p * p {
        axis.normalize()
    } else {
        across(largest)
            .try_normalize()
            .map_or(DVec3::Z, |along| along.any_orthonormal_vector())
    };
    (axis, [least, middle, largest].map(|v| v.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    fn packed(m: DMat3) -> [f64; 6] {
        let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
        [x.x, y.y, z.z, x.y, x.z, y.z]
    }

    #[test]
    fn axes_are_those_of_the_matrix() {
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -0.5).normalize(), 0.7);
        for values in [
            [0.0, 1.0, 1.0],
            [0.0, 1e-9, 1.0],
            [0.1, 0.5, 0.9],
            [1.0, 1.0, 2.0],
            [0.0, 0.0, 1.0],
            [3.0, 3.0, 3.0],
            [0.0, 0.0, 0.0],
        ] {
            for scale in [1e-12, 1.0, 1e12] {
                let m = turn * DMat3::from_diagonal(DVec3::from(values)) * turn.transpose() * scale;
                let (axis, found) = least_axis(packed(m));
                assert!((axis.length() - 1.0).abs() < 1e-12);
                let residual = (m * axis - axis * (values[0] * scale)).length();
                assert!(residual <= 1e-7 * scale, "{values:?}: {residual:e}");
                for (a, b) in found.iter().zip(values) {
                    assert!(
                        (a - b * scale).abs() <= 1e-7 * scale,
                        "{found:?} {values:?}"
                    );
                }
            }
        }
    }
}
