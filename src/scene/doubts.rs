//! What of the coordinates is doubtful.

use std::fmt;
use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;

use super::{Scene, Source};
use crate::error::{Error, Result};
use crate::points::{PointCloud, Survey};

/// Clouds that lie so many times their size apart are not of one coordinate system.
const APART: f64 = 1000.0;
/// Steps of an f32, relative to the number.
const STEP: f64 = f32::EPSILON as f64;
/// Largest step, relative to the size of a cloud, at which two clouds are lit together.
const FINE: f64 = 1e-4;
/// Steps from point to point that are too few to tell a surface.
const FEW_STEPS: f64 = 3.0;
/// Heights are so many times larger than degrees.
const DEGREES: f64 = 100.0;
/// A lamp that is farther away than so many sizes of the cloud is in another place.
const FAR: f64 = 10.0;

/// Least and largest coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    pub min: DVec3,
    pub max: DVec3,
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let [min, max] = [self.min, self.max].map(|p| p.to_array().map(|x| x.to_string()));
        write!(f, "{} .. {}", min.join(" "), max.join(" "))
    }
}

impl Bounds {
    /// Of some points of a cloud that have a place; `None` without any.
    fn of(cloud: &PointCloud, points: Range<usize>) -> Option<Self> {
        let empty = || (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (min, max) = points
            .into_par_iter()
            .filter(|&i| cloud.is_placed(i))
            .map(|i| cloud.positions[i])
            .fold(empty, |(min, max), p| (min.min(p), max.max(p)))
            .reduce(empty, |a, b| (a.0.min(b.0), a.1.max(b.1)));
        min.is_finite().then_some(Bounds { min, max })
    }

    fn size(&self) -> f64 {
        (self.max - self.min).length()
    }

    fn distance(&self, other: &Bounds) -> f64 {
        let gap = (self.min - other.max).max(other.min - self.max);
        gap.max(DVec3::ZERO).length()
    }
}

impl Scene {
    /// The box around all points that have a place.
    pub fn bounds(&self) -> Option<Bounds> {
        Bounds::of(&self.cloud, 0..self.cloud.len())
    }

    /// Doubts of the coordinates, each in a sentence: too coarse, degrees, lamps far away.
    ///
    /// # Errors
    /// If the search for neighbours fails.
    pub fn doubts(&self) -> Result<Vec<String>> {
        let mut doubts = Vec::new();
        for source in &self.sources {
            let Some(bounds) = Bounds::of(&self.cloud, source.points.clone()) else {
                continue;
            };
            let file = source.path.display();
            if let Some((step, spacing)) = self.too_coarse(source, &bounds)? {
                doubts.push(format!(
                    "{file}: coordinates step by {step}, as the file stores them, and points lie \
                     {spacing:.3} apart: the shape is lost; export it with an offset, or as doubles"
                ));
            }
            if are_degrees(&bounds) {
                doubts.push(format!(
                    "{file}: x and y look like degrees, and z like metres: project it to metres \
                     (box {bounds})"
                ));
            }
        }
        if let Some(bounds) = self.bounds() {
            for light in &self.lights {
                let at = Bounds {
                    min: light.position,
                    max: light.position,
                };
                if bounds.distance(&at) > FAR * bounds.size() {
                    doubts.push(format!(
                        "the lamp at {} lies far from the points (box {bounds})",
                        light.position
                    ));
                }
            }
        }
        Ok(doubts)
    }

    /// The step of a file's coordinates and the distance of its points, if there are few steps from one
    /// to the next.
    fn too_coarse(&self, source: &Source, bounds: &Bounds) -> Result<Option<(f64, f64)>> {
        let positions = &self.cloud.positions[source.points.clone()];
        let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
        let step = 2f64.powf(largest.max(f64::MIN_POSITIVE).log2().floor()) * STEP;
        // Points on a surface are closer together than this share of its size, if they are many.
        let closest = bounds.size() / (positions.len().max(1) as f64).sqrt();
        let is_single = |p: &DVec3| p.is_nan() || p.as_vec3().as_dvec3() == *p;
        if step * 10.0 * FEW_STEPS < closest || !positions.par_iter().all(is_single) {
            return Ok(None);
        }
        let spacing = Survey::of(&self.cloud, source.points.clone())?.spacing;
        Ok(spacing
            .filter(|spacing| *spacing < FEW_STEPS * step)
            .map(|spacing| (step, spacing)))
    }

    /// Fails where files lie thousands of their sizes apart, unless that is `meant`, and where they cannot be
    /// told precisely together.
    pub(super) fn check_together(&self, meant: bool) -> Result<()> {
        let boxes: Vec<(&Source, Bounds)> = (self.sources.iter())
            .filter_map(|source| {
                let bounds = Bounds::of(&self.cloud, source.points.clone())?;
                Some((source, bounds))
            })
            .collect();
        for (i, (one, a)) in boxes.iter().enumerate() {
            for (other, b) in &boxes[..i] {
                let (gap, size) = (a.distance(b), a.size().max(b.size()));
                if gap <= APART * size {
                    continue;
                }
                let words = format!(
                    "{} and {} lie {gap:.0} apart, {:.0} times their size",
                    other.path.display(),
                    one.path.display(),
                    gap / size
                );
                if !meant {
                    return Err(Error::Usage(format!(
                        "{words}: are they in one coordinate system? --far-apart takes them as they are"
                    )));
                }
                let least = a.size().min(b.size());
                if gap * STEP > FINE * least {
                    return Err(Error::Invalid(format!(
                        "{words}: so far apart their points cannot be told from each other; light them \
                         one by one"
                    )));
                }
            }
        }
        Ok(())
    }
}

/// Whether x and y can be degrees, beside a height in metres.
fn are_degrees(bounds: &Bounds) -> bool {
    let size = bounds.max - bounds.min;
    let most = bounds.min.abs().max(bounds.max.abs());
    let flat = size.x.max(size.y);
    most.x <= 360.0
        && most.y <= 90.0
        && most.x.max(most.y) > 1.0
        && flat > 0.0
        && size.z > DEGREES * flat
}
