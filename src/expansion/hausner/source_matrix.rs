//! The numerator of the kernel as a product of two matrices.

use glam::DVec3;

/// SM(y), red, green and blue together (C.5).
///
/// With the tangent plane a = (n, -n·r) and the place b = (r, 1) of a surfel, as vectors of four, the
/// numerator (n_x · (y-x)) (n_y · (x-y)) is (a_x · b_y) (a_y · b_x). So the 16 numbers of SM(y), which
/// the report writes as blocks n r^t, n, (r·n) r^t and r·n, are the matrix a_y b_y^t, the receiver's
/// RM(x) is b_x a_x^t, RM ⊗ SM = b_x^t SM a_x, and the translation matrices TM of (C.21), (C.24) and
/// (C.32) are those of homogeneous coordinates. The trace a_y · b_y is zero, so that 15 are independent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SourceMatrix(pub [[DVec3; 4]; 4]);

impl SourceMatrix {
    /// SM of a surfel at `place` with unit `normal`, times its `flux`.
    pub fn of(flux: DVec3, normal: DVec3, place: DVec3) -> SourceMatrix {
        let b = point(place);
        SourceMatrix(plane(normal, place).map(|a| b.map(|b| flux * (a * b))))
    }

    /// RM(x) ⊗ SM for a receiver at `place` with unit `normal`.
    pub fn received(&self, normal: DVec3, place: DVec3) -> DVec3 {
        let (a, b) = (plane(normal, place), point(place));
        let row = |row: &[DVec3; 4]| (0..4).map(|k| row[k] * a[k]).sum::<DVec3>();
        (0..4).map(|i| row(&self.0[i]) * b[i]).sum()
    }

    /// The same about a centre moved by `t`: TM(t) ⊗ SM.
    pub fn moved(&self, t: DVec3) -> SourceMatrix {
        // a' = (n, -n·r + n·t), b' = (r - t, 1)
        let t = t.to_array();
        let mut moved = self.0;
        for k in 0..4 {
            for i in 0..3 {
                moved[3][k] += self.0[i][k] * t[i];
            }
        }
        for row in &mut moved {
            for k in 0..3 {
                row[k] -= row[3] * t[k];
            }
        }
        SourceMatrix(moved)
    }

    /// Its entries times a factor for each power of the place in them: 0, 1 or 2.
    pub fn scaled(&self, factors: [f64; 3]) -> SourceMatrix {
        let mut scaled = *self;
        for i in 0..4 {
            for k in 0..4 {
                scaled.0[i][k] *= factors[usize::from(i == 3) + usize::from(k < 3)];
            }
        }
        scaled
    }

    /// self += factor * other
    pub fn add(&mut self, other: &SourceMatrix, factor: f64) {
        for (row, other) in self.0.iter_mut().zip(&other.0) {
            for (x, y) in row.iter_mut().zip(other) {
                *x += *y * factor;
            }
        }
    }
}

fn plane(normal: DVec3, place: DVec3) -> [f64; 4] {
    normal.extend(-normal.dot(place)).to_array()
}

fn point(place: DVec3) -> [f64; 4] {
    place.extend(1.0).to_array()
}
