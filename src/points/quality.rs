//! How good a cloud is as a surface.

use rayon::prelude::*;
use serde::Serialize;

use super::Surfels;

/// How good a cloud is as a surface, and what was left out of it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Quality {
    /// Points of the cloud.
    pub points: usize,
    /// Those that stand for the surface.
    pub surfels: usize,
    /// Points without coordinates or normal.
    pub unusable: usize,
    /// Points at the place of another one.
    pub duplicates: usize,
    /// Points that stood in for by others, because fewer were asked for.
    pub thinned: usize,
    /// Points that belong to no surface.
    pub strays: usize,
    /// Points inside of bodies or behind walls.
    pub buried: usize,
    /// How far points lay beside their surface, in spacings: median.
    pub noise: f64,
    /// Angle by which normals disagree with the positions, in degrees: median.
    pub scatter: f64,
    /// Square root of the area of a surfel, in the scan's unit: 5th percentile, median, 95th.
    pub spacing: [f64; 3],
    /// Surface area in the square of the scan's unit.
    pub area: f64,
}

impl Quality {
    /// Ratio of the densities of points, between the densest and the sparsest twentieth.
    pub fn density_ratio(&self) -> f64 {
        (self.spacing[2] / self.spacing[0]).powi(2)
    }

    /// Takes what the surfels tell.
    pub(super) fn measure(&mut self, surfels: &Surfels) {
        self.surfels = surfels.len();
        let mut areas = surfels.areas.clone();
        areas.par_sort_unstable_by(f32::total_cmp);
        let size = |k: usize| f64::from(areas[k * (areas.len() - 1) / 100]).sqrt();
        self.spacing = [5, 50, 95].map(size);
        self.area = areas.iter().map(|&a| f64::from(a)).sum();
    }

    /// What was found, a line each.
    pub fn lines(&self) -> Vec<String> {
        let [fine, median, coarse] = self.spacing;
        let mut lines = vec![
            format!(
                "{} points, {} of them surface of {:.4}",
                self.points, self.surfels, self.area
            ),
            format!(
                "spacing {median:.3}, {fine:.3} to {coarse:.3} for nine of ten: density varies {:.1} \
                 times",
                self.density_ratio()
            ),
            format!(
                "points lie {:.2} spacings beside their surface, normals {:.1} degrees off it",
                self.noise, self.scatter
            ),
        ];
        for (count, what) in [
            (self.unusable, "without coordinates or normal"),
            (self.duplicates, "at the place of another one"),
            (self.thinned, "thinned out"),
            (self.strays, "strays"),
            (self.buried, "buried"),
        ] {
            if count > 0 {
                let share = 100.0 * count as f64 / self.points as f64;
                lines.push(format!("{count} points ({share:.2}%) {what}"));
            }
        }
        lines
    }
}
