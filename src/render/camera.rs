//! A camera for clouds that come without one.

use glam::{DVec3, Vec3};

use super::view::View;
use crate::error::{Error, Result};
use crate::points::{PointCloud, Surfels};
use crate::scene::Camera;
use crate::visibility::{NO_SURFEL, Segment, Visibility};

/// Fields of view in degrees: natural from outside, wide in a room.
const FOV_OUTSIDE: f64 = 40.0;
const FOV_INSIDE: f64 = 70.0;
/// Surfels that stand for the cloud when candidates are judged.
const TARGETS: usize = 256;
/// Places tried inside, and directions probed from each.
const PLACES: usize = 64;
const PROBES: usize = 64;
/// Part of the probes that must be blocked where the cloud closes around a place. A scan has
/// holes (windows, the scanner's own shadow), so it is not 1.
const ENCLOSED: f64 = 0.9;
/// Free distance wanted around the camera inside, in diagonals of the cloud's box.
const CLEARANCE: f64 = 0.03;
/// Part of what the best side shows that is enough for a side that is liked better.
const ENOUGH: f64 = 0.75;
/// Points that may stick out of an edge of the frame, one in so many: a stray must not shrink the
/// rest.
const STRAYS: usize = 500;
/// Least length of the mean normal of a cloud that has a front, and cosine between up and one that faces up
/// or down.
const FRONT: f64 = 0.3;
const STEEP: f64 = 0.8;
/// Points that frame and clearance are taken from.
const FRAMED: usize = 1 << 16;

/// A camera that shows the cloud well.
///
/// Where the cloud closes around most places before its surfels, the camera stands inside, at the
/// place and in the direction that show most surfels from their front. Otherwise it stands outside,
/// as near as the frame allows: front and right and a little above, if that shows nearly as much as
/// the best side does.
///
/// Up is z, as scanners have it; it is y in two cases: a closed cloud less than a third as high in
/// y as in z (a tunnel along z), and an open one whose mean normal leans to +y, for what a scan of
/// a thing lacks is its underside.
///
/// `aspect` is width over height. The camera is the same in every run. Fails when there is no
/// finite point to look at or `aspect` is not a positive number.
pub fn fit(
    cloud: &PointCloud,
    surfels: &Surfels,
    visibility: &dyn Visibility,
    aspect: f64,
) -> Result<Camera> {
    if !(aspect > 0.0 && aspect.is_finite()) {
        return Err(Error::Usage(format!(
            "a picture's width over its height must be a positive number, not {aspect}"
        )));
    }
    let (origin, positions) = if surfels.is_empty() {
        let points = cloud.positions.iter().filter(|p| p.is_finite());
        let origin = points.clone().next().copied().unwrap_or_default();
        (origin, points.map(|&p| p - origin).collect())
    } else {
        let positions: Vec<DVec3> = surfels.positions.iter().map(|p| p.as_dvec3()).collect();
        (surfels.origin, positions)
    };
    let Some(&first) = positions.first() else {
        return Err(Error::Invalid("there is no point to look at".into()));
    };
    let low = positions.iter().copied().fold(first, DVec3::min);
    let high = positions.iter().copied().fold(first, DVec3::max);
    let area = surfels.areas.iter().copied().fold(0.0, f32::max);
    let extent = high - low;
    // A single point has the size of its disc; nothing is smaller than what its coordinates tell.
    let size = [extent.length(), f64::from(area).sqrt()]
        .into_iter()
        .find(|&s| s > 0.0)
        .unwrap_or(1.0)
        .max(1e-9 * origin.abs().max_element());
    if !size.is_finite() {
        return Err(Error::Invalid("the cloud is too large to look at".into()));
    }

    let sight = Sight::new(surfels, visibility);
    let camera = match inside(&sight, extent, size)? {
        Some(camera) => camera,
        None => {
            let few = spread(positions.len(), FRAMED).map(|i| positions[i]);
            outside(&sight, &few.collect::<Vec<_>>(), size, aspect)?
        }
    };
    Ok(Camera {
        position: camera.position + origin,
        look_at: camera.look_at + origin,
        ..camera
    })
}

/// What can be seen of the surfels, judged by a few of them.
struct Sight<'a> {
    surfels: &'a Surfels,
    visibility: &'a dyn Visibility,
    targets: Vec<usize>,
}

impl<'a> Sight<'a> {
    fn new(surfels: &'a Surfels, visibility: &'a dyn Visibility) -> Self {
        let targets = spread(surfels.len(), TARGETS).collect();
        Self {
            surfels,
            visibility,
            targets,
        }
    }

    /// A place just before a surfel.
    fn before(&self, i: usize) -> Vec3 {
        self.surfels.positions[i] + self.surfels.normals[i] * self.surfels.offsets[i]
    }

    /// For each place, the targets whose front it sees.
    fn seen(&self, places: &[Vec3]) -> Result<Vec<Vec<usize>>> {
        let mut segments = Vec::new();
        let mut ends = Vec::new();
        for (k, &place) in places.iter().enumerate() {
            for &i in &self.targets {
                let to = self.before(i);
                if self.surfels.normals[i].dot(place - to) > 0.0 {
                    segments.push(segment(place, NO_SURFEL, to, i as u32));
                    ends.push((k, i));
                }
            }
        }
        let mut seen = vec![Vec::new(); places.len()];
        let visible = self.visibility.visible(&segments)?;
        for (&(k, i), _) in ends.iter().zip(visible).filter(|(_, visible)| *visible) {
            seen[k].push(i);
        }
        Ok(seen)
    }

    /// Distance from a place to the nearest surfel.
    fn clearance(&self, place: Vec3) -> f64 {
        let distances = spread(self.surfels.len(), FRAMED)
            .map(|i| self.surfels.positions[i].distance_squared(place));
        f64::from(distances.fold(f32::INFINITY, f32::min)).sqrt()
    }

    /// For each place, the part of all directions in which something stands within `reach`.
    fn blocked(&self, places: &[Vec3], reach: f32) -> Result<Vec<f64>> {
        let segments: Vec<Segment> = places
            .iter()
            .flat_map(|&place| {
                (0..PROBES).map(move |k| {
                    segment(
                        place,
                        NO_SURFEL,
                        place + sphere(k, PROBES) * reach,
                        NO_SURFEL,
                    )
                })
            })
            .collect();
        let visible = self.visibility.visible(&segments)?;
        let share = |v: &[bool]| v.iter().filter(|v| !**v).count() as f64 / PROBES as f64;
        Ok(visible.chunks(PROBES).map(share).collect())
    }

    /// Places in the free space before surfels: half way along the longest free one of a few
    /// segments on the normal.
    fn places(&self, size: f32) -> Result<Vec<Vec3>> {
        const LENGTHS: [f32; 6] = [0.5, 0.25, 0.125, 0.06, 0.03, 0.015];
        let starts: Vec<usize> = spread(self.surfels.len(), PLACES).collect();
        let segments: Vec<Segment> = starts
            .iter()
            .flat_map(|&i| {
                LENGTHS.map(|length| {
                    let from = self.before(i);
                    let to = from + self.surfels.normals[i] * (length * size);
                    segment(from, i as u32, to, NO_SURFEL)
                })
            })
            .collect();
        let visible = self.visibility.visible(&segments)?;
        let longest = |(&i, free): (&usize, &[bool])| {
            let k = free.iter().position(|&free| free)?;
            Some(self.before(i) + self.surfels.normals[i] * (0.5 * LENGTHS[k] * size))
        };
        Ok(starts
            .iter()
            .zip(visible.chunks(LENGTHS.len()))
            .filter_map(longest)
            .collect())
    }
}

/// The camera inside, relative to the origin, if the cloud closes around most places in it.
fn inside(sight: &Sight, extent: DVec3, size: f64) -> Result<Option<Camera>> {
    let places = sight.places(size as f32)?;
    let blocked = sight.blocked(&places, size as f32)?;
    let (enclosed, blocked): (Vec<Vec3>, Vec<f64>) = places
        .iter()
        .zip(blocked)
        .filter(|(_, blocked)| *blocked > ENCLOSED)
        .unzip();
    if 2 * blocked.len() <= places.len() {
        return Ok(None);
    }
    // What the frame shows, counted in surfels; less if something stands right before the lens.
    let up = if 3.0 * extent.y < extent.z {
        DVec3::Y
    } else {
        DVec3::Z
    };
    let edge = (0.5 * FOV_INSIDE).to_radians().cos();
    let mut best: (f64, Option<Camera>) = (0.0, None);
    for (place, seen) in enclosed.iter().zip(sight.seen(&enclosed)?) {
        let clearance = sight.clearance(*place) / (CLEARANCE * size);
        let place = place.as_dvec3();
        let views: Vec<DVec3> = seen
            .iter()
            .map(|&i| sight.surfels.positions[i].as_dvec3() - place)
            .collect();
        for (azimuth, pitch) in (0..32).flat_map(|k| [0.0, -12.0, -24.0].map(|pitch| (k, pitch))) {
            let direction = turn(up, f64::from(azimuth) * 11.25, pitch);
            let (mut shown, mut along) = (0.0, 0.0);
            for view in &views {
                if view.dot(direction) > edge * view.length() {
                    shown += 1.0;
                    along += view.dot(direction);
                }
            }
            let score = shown * clearance.min(1.0);
            if score > best.0 {
                let look_at = place + direction * (along / shown);
                let camera = Camera {
                    position: place,
                    look_at,
                    up,
                    fov: FOV_INSIDE,
                };
                best = (score, Some(camera));
            }
        }
    }
    Ok(best.1)
}

/// The camera outside, relative to the origin.
fn outside(sight: &Sight, positions: &[DVec3], size: f64, aspect: f64) -> Result<Camera> {
    let up = up_of_open(sight.surfels);
    // In order of liking: right and left of the front (-y when z is up, +z when y is), the back,
    // the sides; then from well above, for rooms without a ceiling; last from where the normals point, for
    // what was seen from one place.
    let front = mean_normal(sight.surfels);
    let steep = front.dot(up).abs() > STEEP * front.length();
    let opposite = (front.length() > FRONT).then(|| {
        let across = if steep { turn(up, 0.0, 0.0) } else { up };
        framed(positions, -front.normalize(), across, size, aspect)
    });
    let cameras = [-20.0, -50.0]
        .into_iter()
        .flat_map(|pitch| {
            [35.0, -35.0, 145.0, -145.0, 0.0, 180.0, 90.0, -90.0]
                .map(|azimuth| framed(positions, turn(up, azimuth, pitch), up, size, aspect))
        })
        .chain(opposite)
        .collect::<Result<Vec<_>>>()?;
    let places: Vec<Vec3> = cameras.iter().map(|c| c.position.as_vec3()).collect();
    let seen = sight.seen(&places)?;
    // Facing surfels count more than slanted ones: from 20 degrees above, ground is a mere strip.
    let facing = |(&place, seen): (&Vec3, &Vec<usize>)| -> f64 {
        let cosine = |&i: &usize| {
            let towards = (place - sight.surfels.positions[i]).normalize_or_zero();
            f64::from(sight.surfels.normals[i].dot(towards))
        };
        seen.iter().map(cosine).sum()
    };
    let shown: Vec<f64> = places.iter().zip(&seen).map(facing).collect();
    let most = shown.iter().copied().fold(0.0, f64::max);
    let first = shown.iter().position(|&s| s >= ENOUGH * most).unwrap_or(0);
    Ok(cameras[first])
}

/// Weighted by area; of length 1 for a plane, 0 where the surface is closed.
fn mean_normal(surfels: &Surfels) -> DVec3 {
    let areas = surfels.normals.iter().zip(&surfels.areas);
    let sum: DVec3 = areas.map(|(n, &a)| n.as_dvec3() * f64::from(a)).sum();
    sum / surfels.areas.iter().map(|&a| f64::from(a)).sum::<f64>()
}

fn up_of_open(surfels: &Surfels) -> DVec3 {
    let mean = mean_normal(surfels);
    // A wall has a mean normal near 1 in length, which tells its front and nothing about up.
    let underside = mean.y > 0.02 && mean.y > 3.0 * mean.z.abs() && mean.length() < 0.5;
    if underside { DVec3::Y } else { DVec3::Z }
}

/// The nearest camera that looks along `direction` and has the positions in its frame.
///
/// In camera axes a point (x, y, z) is within the right edge of a camera at (cx, cy, -d) if
/// x - cx <= (z + d) t, with t the half width at distance 1; the other edges likewise. The largest
/// x - z t and -x - z t over the points give cx and the smallest d.
fn framed(
    positions: &[DVec3],
    direction: DVec3,
    up: DVec3,
    size: f64,
    aspect: f64,
) -> Result<Camera> {
    let camera = Camera {
        position: DVec3::ZERO,
        look_at: direction,
        up,
        fov: FOV_OUTSIDE,
    };
    let view = View::new(&camera)?;
    const MARGIN: f64 = 0.92;
    let tall = MARGIN * view.half_height;
    let wide = tall * aspect;
    let edge = |f: &dyn Fn(DVec3) -> f64| -> f64 {
        let mut values: Vec<f64> = positions.iter().map(|&p| f(view.direction(p))).collect();
        let at = values.len() - 1 - values.len() / STRAYS;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let (right, left) = (edge(&|p| p.x - p.z * wide), edge(&|p| -p.x - p.z * wide));
    let (top, bottom) = (edge(&|p| p.y - p.z * tall), edge(&|p| -p.y - p.z * tall));
    let nearest = edge(&|p| -p.z);
    let distance = ((right + left) / (2.0 * wide))
        .max((top + bottom) / (2.0 * tall))
        .max(nearest + 0.5 * size);
    let position = view.right * (0.5 * (right - left)) + view.up * (0.5 * (top - bottom))
        - direction * distance;
    let middle = positions.iter().map(|p| p.dot(direction)).sum::<f64>() / positions.len() as f64;
    let depth = (middle + distance).max(0.5 * size);
    Ok(Camera {
        position,
        look_at: position + direction * depth,
        ..camera
    })
}

/// The direction of a view from `azimuth` degrees right of the front, tilted up by `pitch`.
fn turn(up: DVec3, azimuth: f64, pitch: f64) -> DVec3 {
    let front = if up == DVec3::Z {
        DVec3::Y
    } else {
        DVec3::NEG_Z
    };
    let (sin, cos) = azimuth.to_radians().sin_cos();
    let level = front * cos + up.cross(front) * sin;
    let (sin, cos) = pitch.to_radians().sin_cos();
    level * cos + up * sin
}

fn segment(from: Vec3, skip_from: u32, to: Vec3, skip_to: u32) -> Segment {
    Segment {
        from: from.to_array(),
        skip_from,
        to: to.to_array(),
        skip_to,
    }
}

/// At most `count` of `len` indices, spread evenly.
fn spread(len: usize, count: usize) -> impl Iterator<Item = usize> {
    let count = count.min(len);
    (0..count).map(move |k| (2 * k + 1) * len / (2 * count))
}

/// The k-th of n directions that cover the sphere evenly (a Fibonacci spiral).
fn sphere(k: usize, n: usize) -> Vec3 {
    let z = 1.0 - (2 * k + 1) as f64 / n as f64;
    let turn = k as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let r = (1.0 - z * z).sqrt();
    DVec3::new(r * turn.cos(), r * turn.sin(), z).as_vec3()
}
