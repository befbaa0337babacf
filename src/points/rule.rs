//! The one rule by which cells, occluders and segments follow the cloud's noise.

use glam::Vec3;
use rayon::prelude::*;

use super::neighbours::{Last, Neighbours};

/// Surfels that the rule is measured on.
const SAMPLE: usize = 20_000;
/// Neighbours of each, among which those of similar normal are looked for.
const NEIGHBOURS: usize = 24;
/// Largest spacing of a cell, in medians of the spacing.
const LARGEST_SPACING: f64 = 30.0;
/// Offsets, in spacings: of clean surfaces, and at most.
const OFFSETS: [f64; 2] = [0.02, 0.3];
/// Between the two, for a roughness of 1.
const OFFSET_OF_ROUGHNESS: f64 = 4.0;

/// How far the surface can be trusted: the one rule by which cells, occluders and segments follow
/// the cloud's noise.
#[derive(Default)]
pub(super) struct SurfaceRule {
    /// How far positions and normals disagree, as a slope.
    pub roughness: f64,
    /// How far points lie beside the surface of their neighbours, in spacings.
    pub noise: f64,
    /// Height of a segment's ends above the surface, in spacings.
    pub offset: f64,
    /// Scale of a cell as an occluder.
    pub scale: f64,
    /// Cosine between normals below which two neighbours lie on two sides of a crease.
    pub crease: f64,
    /// Largest spacing that a cell is made for: a point farther from all others is a stray, not a
    /// piece of wall as large as the gap around it.
    pub largest_spacing: f64,
}

impl SurfaceRule {
    /// Clean surfaces keep their corners sharp and their seams tight; noisy ones get room, so
    /// that bumps of the noise cast no shadow.
    pub fn measure(normals: &[Vec3], neighbours: &Neighbours) -> SurfaceRule {
        let [roughness, noise, spacing] = roughness_noise_and_spacing(normals, neighbours);
        let [least, most] = OFFSETS;
        let offset = (OFFSET_OF_ROUGHNESS * roughness).clamp(least, most);
        SurfaceRule {
            roughness,
            noise,
            offset,
            scale: 1.02 + 0.4 * (offset - least),
            crease: (0.75 - 5.0 * roughness).clamp(0.5, 0.75),
            largest_spacing: LARGEST_SPACING * spacing,
        }
    }

    /// Is the surface as smooth as can be told?
    pub fn is_clean(&self) -> bool {
        self.offset <= OFFSETS[0]
    }
}

/// Roughness of the cloud, as a slope, distance of the points from the surface, in spacings, and
/// distance between neighbours: medians over a sample of the surfels, of means over the six nearest
/// neighbours of similar normal.
///
/// For neighbours on a circular arc (n_i + n_j) · (x_j - x_i) = 0 whatever the curvature, so that
/// the slope |(n_i + n_j) · d| / 2|d| measures noise of positions and normals alone.
fn roughness_noise_and_spacing(normals: &[Vec3], neighbours: &Neighbours) -> [f64; 3] {
    let step = normals.len().div_ceil(SAMPLE);
    let measured: Vec<[f64; 3]> = (0..normals.len())
        .into_par_iter()
        .step_by(step)
        .filter_map(|i| {
            let mut near = Vec::new();
            neighbours.find(i, NEIGHBOURS, normals, &mut Last::default(), &mut near);
            let normal = normals[i].as_dvec3();
            let similar = near.iter().filter(|n| n.normal.dot(normal) > 0.7).take(6);
            let zero = (0.0, 0.0, 0.0, 0.0);
            let (slopes, heights, lengths, count) =
                similar.fold(zero, |(slopes, heights, lengths, count), n| {
                    let length = n.offset.length();
                    let height = 0.5 * (normal + n.normal).dot(n.offset);
                    let slope = height.abs() / length;
                    (
                        slopes + slope,
                        heights + height,
                        lengths + length,
                        count + 1.0,
                    )
                });
            let means = [
                slopes,
                heights.abs() / lengths.max(f64::MIN_POSITIVE),
                lengths,
            ];
            (count > 0.0).then(|| [means[0] / count, means[1], means[2] / count])
        })
        .collect();
    // Without a single pair of neighbours there is nothing to follow and nothing to bound.
    let middle = |k: usize| median(measured.iter().map(|m| m[k]).collect());
    [
        middle(0).unwrap_or(0.0),
        middle(1).unwrap_or(0.0),
        middle(2).unwrap_or(f64::INFINITY),
    ]
}

/// The upper one of two middle values; `None` of nothing.
pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
