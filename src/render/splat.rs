//! Surfels as discs with depth.
//!
//! Two passes, as in EWA splatting (Zwicker et al. 2001): the first finds the depth of the nearest
//! disc at each sample, the second blends all discs that lie on that surface, so that light runs
//! smoothly from point to point. Minima and sums are of integers: the picture depends neither on
//! the number of threads nor on the order of the points.

use std::array;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use glam::DVec3;
use rayon::prelude::*;

use super::image::Image;
use super::view::View;
use crate::error::{Error, Result};
use crate::map::IlluminationMap;
use crate::points::PointCloud;
use crate::progress::Progress;
use crate::scene::Camera;

/// Samples along each side of a pixel.
const SAMPLES: usize = 2;
/// Most pixels of a picture: 8K fits, and the buffers stay under 2 GiB.
const MAX_PIXELS: u64 = 1 << 25;
/// Radius drawn, in radii of the disc of equal area. Square cells are covered from 1.25 on, cells
/// three times as long as wide from 1.62 on, and at 1.7 a jittered grid shows 1 gap in 3000 samples
/// (at 1.5, 1 in 200). More would swell the outlines.
const SCALE: f64 = 1.7;
/// How far the rim of a disc is pushed away, in drawn radii: discs are shallow bowls in the depth
/// test, so that a rim that sticks out of a noisy or bent surface hides little.
const BOWL: f64 = 0.5;
/// Discs up to this far behind the nearest one, in drawn radii, are of the same surface.
const SAME_SURFACE: f64 = 0.5;
/// Weight of a rim, against 1 at the centre: whatever is covered gets a colour.
const RIM_WEIGHT: f64 = 1e-3;
/// Weights and colours are summed as multiples of 2^-40 of their maximum.
const FIXED_POINT: f64 = (1u64 << 40) as f64;

/// Draws what the camera sees of the lit cloud.
///
/// Every point is a disc in its tangent plane, seen from its front only: a closed room can be
/// looked into from outside. Points without a usable position, normal, radius or radiosity are not
/// drawn.
///
/// Fails when the cloud has no normals, the map has not one entry a point, the camera looks
/// nowhere, or the picture is empty or larger than 2^25 pixels.
pub fn picture(
    cloud: &PointCloud,
    map: &IlluminationMap,
    camera: &Camera,
    width: u32,
    height: u32,
    progress: &dyn Progress,
) -> Result<Image> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || pixels > MAX_PIXELS {
        return Err(Error::Usage(format!(
            "a picture has between 1 and {MAX_PIXELS} pixels; {width} x {height} was asked for"
        )));
    }
    let points = cloud.len();
    if cloud.normals.len() != points && map.normals.len() != points {
        return Err(Error::Invalid(format!(
            "a picture needs a normal at every point; {} of {points} have one",
            cloud.normals.len()
        )));
    }
    if map.radiosity.len() != points || map.radius.len() != points {
        return Err(Error::Invalid(format!(
            "the illumination map has {} entries, the cloud {points} points",
            map.radiosity.len().min(map.radius.len())
        )));
    }

    let screen = Screen::new(View::new(camera)?, width, height);
    let brightest = map
        .radiosity
        .iter()
        .filter(|b| b.is_finite())
        .fold(f32::MIN_POSITIVE, |most, b| most.max(b.max_element()));
    let scale = f64::from(brightest);
    progress.stage("picture", 2 * points as u64);
    each_point(points, progress, |i| {
        if let Some(disc) = screen.disc(cloud, map, i) {
            screen.cover(&disc);
        }
    })?;
    each_point(points, progress, |i| {
        if let Some(disc) = screen.disc(cloud, map, i) {
            let colour = map.radiosity[i].as_dvec3().max(DVec3::ZERO) / scale;
            screen.blend(&disc, colour);
        }
    })?;
    Ok(screen.resolve(scale))
}

fn each_point(points: usize, progress: &dyn Progress, work: impl Fn(usize) + Sync) -> Result<()> {
    const CHUNK: usize = 1024;
    (0..points.div_ceil(CHUNK))
        .into_par_iter()
        .try_for_each(|chunk| {
            progress.check()?;
            let range = chunk * CHUNK..points.min((chunk + 1) * CHUNK);
            progress.advance(range.len() as u64);
            range.for_each(&work);
            Ok(())
        })
}

/// A surfel in camera coordinates.
struct Disc {
    centre: DVec3,
    normal: DVec3,
    radius: f64,
    /// Height of its plane above the camera along the normal; negative, as its front is seen.
    plane: f64,
}

/// The samples of a picture with the nearest surface, and its pixels with what they have gathered.
struct Screen {
    view: View,
    width: usize,
    height: usize,
    /// Side of a sample at distance 1.
    step: f64,
    /// A depth a sample, as the bits of a positive f32, which order as the numbers do.
    nearest: Vec<AtomicU32>,
    /// Red, green and blue times weight, and weight, a pixel; in fixed point.
    gathered: Vec<[AtomicU64; 4]>,
}

const NOTHING: u32 = f32::INFINITY.to_bits();

impl Screen {
    fn new(view: View, width: u32, height: u32) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self {
            view,
            width,
            height,
            step: 2.0 * view.half_height / (height * SAMPLES) as f64,
            nearest: (0..width * height * SAMPLES * SAMPLES)
                .into_par_iter()
                .map(|_| AtomicU32::new(NOTHING))
                .collect(),
            gathered: (0..width * height)
                .into_par_iter()
                .map(|_| Default::default())
                .collect(),
        }
    }

    /// The disc of a point, if it can be drawn and shows its front.
    fn disc(&self, cloud: &PointCloud, map: &IlluminationMap, i: usize) -> Option<Disc> {
        let centre = self.view.place(cloud.positions[i]);
        let normal = map.normal(cloud, i).as_dvec3().normalize_or_zero();
        let normal = self.view.direction(normal);
        let radius = f64::from(map.radius[i]) * SCALE;
        let plane = normal.dot(centre);
        // Each comparison is false for NaN.
        let usable = plane < 0.0 && plane.is_finite() && radius > 0.0 && radius.is_finite();
        (usable && map.radiosity[i].is_finite()).then_some(Disc {
            centre,
            normal,
            radius,
            plane,
        })
    }

    fn cover(&self, disc: &Disc) {
        self.each_sample(disc, |x, y, depth, _| {
            self.nearest[self.sample(x, y)].fetch_min((depth as f32).to_bits(), Relaxed);
        });
    }

    fn blend(&self, disc: &Disc, colour: DVec3) {
        self.each_sample(disc, |x, y, depth, rim| {
            let nearest = f32::from_bits(self.nearest[self.sample(x, y)].load(Relaxed));
            if f64::from(depth as f32) > f64::from(nearest) + SAME_SURFACE * disc.radius {
                return;
            }
            let weight = (1.0 - rim).powi(2) + RIM_WEIGHT;
            let parts = [
                colour.x * weight,
                colour.y * weight,
                colour.z * weight,
                weight,
            ];
            let pixel = y / SAMPLES * self.width + x / SAMPLES;
            for (sum, part) in self.gathered[pixel].iter().zip(parts) {
                sum.fetch_add((part * FIXED_POINT) as u64, Relaxed);
            }
        });
    }

    fn sample(&self, x: usize, y: usize) -> usize {
        y * self.width * SAMPLES + x
    }

    /// Calls `visit` with column, row, depth (with the bowl) and squared distance from the centre
    /// in radii for each sample whose ray meets the disc.
    fn each_sample(&self, disc: &Disc, visit: impl Fn(usize, usize, f64, f64)) {
        let (columns, rows) = self.bounds(disc);
        let middle =
            DVec3::new(self.width as f64, self.height as f64, 0.0) * (0.5 * SAMPLES as f64);
        for y in rows {
            for x in columns.clone() {
                let ray = DVec3::new(
                    (x as f64 + 0.5 - middle.x) * self.step,
                    (middle.y - y as f64 - 0.5) * self.step,
                    1.0,
                );
                // The ray has length 1 along the view, so this is the depth of the meeting point.
                let depth = disc.plane / disc.normal.dot(ray);
                let rim = (ray * depth - disc.centre).length_squared() / disc.radius.powi(2);
                if depth > 0.0 && rim <= 1.0 {
                    visit(x, y, depth + BOWL * disc.radius * rim, rim);
                }
            }
        }
    }

    /// Columns and rows of the samples that a disc can cover: the projection of the disc's box in
    /// camera coordinates, as far as it lies before the camera and on the screen.
    fn bounds(&self, disc: &Disc) -> (Range<usize>, Range<usize>) {
        let normal = disc.normal;
        let half = (DVec3::ONE - normal * normal)
            .max(DVec3::ZERO)
            .map(f64::sqrt)
            * disc.radius;
        let (low, high) = (disc.centre - half, disc.centre + half);
        if high.z <= 0.0 {
            return (0..0, 0..0);
        }
        let (near, far) = (low.z.max(f64::MIN_POSITIVE), high.z);
        let project = |low: f64, high: f64, size: usize| {
            let first = low / if low > 0.0 { far } else { near } / self.step;
            let last = high / if high > 0.0 { near } else { far } / self.step;
            let size = (size * SAMPLES) as f64;
            let first = (0.5 * size + first - 0.5).ceil().clamp(0.0, size);
            let last = (0.5 * size + last + 0.5).floor().clamp(0.0, size);
            first as usize..last as usize
        };
        (
            project(low.x, high.x, self.width),
            project(-high.y, -low.y, self.height),
        )
    }

    fn resolve(self, scale: f64) -> Image {
        let (radiosity, coverage) = (0..self.width * self.height)
            .into_par_iter()
            .map(|pixel| {
                let (x, y) = (pixel % self.width * SAMPLES, pixel / self.width * SAMPLES);
                let covered = (0..SAMPLES * SAMPLES)
                    .map(|k| self.sample(x + k % SAMPLES, y + k / SAMPLES))
                    .filter(|&k| self.nearest[k].load(Relaxed) != NOTHING)
                    .count();
                let [r, g, b, weight]: [f64; 4] =
                    array::from_fn(|k| self.gathered[pixel][k].load(Relaxed) as f64);
                let sum = DVec3::new(r, g, b) * scale;
                let mean = if weight > 0.0 {
                    sum / weight
                } else {
                    DVec3::ZERO
                };
                (mean.as_vec3(), covered as f32 / (SAMPLES * SAMPLES) as f32)
            })
            .unzip();
        Image {
            width: self.width as u32,
            height: self.height as u32,
            radiosity,
            coverage,
        }
    }
}
