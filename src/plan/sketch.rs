//! A scene seen through few of its points: how much stands in the way, how uneven the light is.

use std::ops::Range;

use glam::{DVec3, Vec3};
use rand::RngExt;

use crate::error::Result;
use crate::illuminate::Spots;
use crate::lights;
use crate::links::{self, Close};
use crate::octree::{LEAF_SIZE, Octree};
use crate::points::{Evidence, PointCloud, Prepared, Surfels, Thinning};
use crate::progress::Silent;
use crate::random::{Purpose, stream};
use crate::scene::Scene;
use crate::visibility::{CpuVisibility, NothingInTheWay, Occluders, Visibility};

/// Points that are looked at, at most, and the part of a small cloud that is enough.
const POINTS: usize = 1000;
const ENOUGH: f64 = 0.33;
/// Points that a surface is fitted to.
const WITHOUT_NORMALS: usize = 20_000;
/// Segments between them that are tested.
const SEGMENTS: usize = 4000;
/// Rays that each of them casts.
const RAYS: u32 = 32;
/// Contrast where none is seen though there must be some.
const USUAL_CONTRAST: f64 = 2.0;
/// Tolerance of its lights.
const TOLERANCE: f64 = 0.2;

/// What decides on the cost of a solve, besides the number of points.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sketch {
    /// Part of the segments between points that face each other that something is in the way of.
    pub hidden: f64,
    /// Standard deviation of the light that a ray brings, relative to that which all bring: root mean
    /// squares over the points. 0 where nothing is reflected.
    pub contrast: f64,
    /// Part of that which is left when bright spots are sampled apart.
    pub left: f64,
    /// Reflected light in units of all that comes from all around, which is that of the sky too.
    pub reflected: f64,
    /// How much of the surface in sight is curved or rough, 0 to 1: where the normal of a point is not
    /// that of the next one, though there is no edge between them.
    pub curved: f64,
    /// Part of the points that shine.
    pub shining: f64,
    /// Whether the points get light from a sky.
    pub sky: bool,
}

impl Sketch {
    /// Looks at some points of a scene.
    pub fn of(scene: &Scene, open: bool, seed: u64) -> Sketch {
        let cloud = &scene.cloud;
        let some = |light: &Vec3| *light != Vec3::ZERO;
        let shining = cloud.emission.iter().filter(|e| some(e)).count();
        let sky = some(&scene.sky);
        let lit = sky || shining > 0 || scene.lights.iter().any(|light| some(&light.intensity));
        let reflected = lit && cloud.reflectance.iter().any(some);
        // What is no usable cloud has nothing to show.
        let mut sketch = look(scene, open, seed).unwrap_or_default();
        if reflected && sketch.contrast == 0.0 {
            // The light was too small to be among the few.
            (sketch.contrast, sketch.left, sketch.reflected) = (USUAL_CONTRAST, 1.0, 1.0);
        }
        // What was overlooked are spots.
        let overlooked = overlooked(scene);
        sketch.contrast *= overlooked;
        sketch.left /= overlooked;
        Sketch {
            shining: shining as f64 / cloud.len().max(1) as f64,
            sky,
            ..sketch
        }
    }
}

/// Everything but the lights.
fn look(scene: &Scene, open: bool, seed: u64) -> Result<Sketch> {
    let prepared = few(scene)?;
    if prepared.surfels.is_empty() {
        return Ok(Sketch::default());
    }
    let surfels = Octree::build(&prepared.surfels, LEAF_SIZE).1;
    let occluders = Occluders::build(&surfels);
    let tester: Box<dyn Visibility> = match open {
        true => Box::new(NothingInTheWay),
        false => Box::new(CpuVisibility::<f32>::new(&occluders)),
    };
    let visibility = tester.as_ref();
    let hidden = hidden(&surfels, visibility, seed)?;
    let mut light = lights::point_lights(&surfels, &scene.lights, visibility, &Silent)?.irradiance;
    let emitted = lights::emitters(&surfels, TOLERANCE, seed, visibility, &Silent)?;
    let sky = match scene.sky == Vec3::ZERO {
        true => vec![DVec3::ZERO; surfels.len()],
        false => lights::sky(
            &surfels, scene.sky, TOLERANCE, seed, visibility, None, &Silent,
        )?,
    };
    for other in [&emitted, &sky] {
        light
            .iter_mut()
            .zip(other)
            .for_each(|(h, more)| *h += *more);
    }
    let ambient = light.iter().sum::<DVec3>() / light.len() as f64;
    let sent: Vec<DVec3> = (light.iter().zip(&surfels.reflectance))
        .map(|(h, r)| r.as_dvec3() * (*h + ambient))
        .collect();
    let spots = Spots::of(&surfels, &light).is_spot;
    let of_others: Vec<DVec3> = (sent.iter().zip(&spots).zip(&surfels.reflectance))
        .map(|((b, is_spot), r)| if *is_spot { r.as_dvec3() * ambient } else { *b })
        .collect();
    let close = Close::none(&surfels);
    let rays = links::gather::<f32>(&surfels, &occluders, &close, 0..RAYS, seed, &Silent)?;
    // Variance of what rays bring, and the squares of the mean and of that with the sky.
    let moments = |sent: &[DVec3]| {
        let (mut variance, mut whole, mut ambient) = (0.0, 0.0, 0.0);
        for i in 0..surfels.len() {
            let (mut mean, mut square) = (DVec3::ZERO, 0.0);
            for (j, weight) in rays.row(i) {
                mean += f64::from(weight) * sent[j];
                square += f64::from(weight) * sent[j].length_squared();
            }
            variance += (square - mean.length_squared()).max(0.0);
            whole += mean.length_squared();
            ambient += (mean + sky[i]).length_squared();
        }
        [variance, whole, ambient]
    };
    let [variance, whole, ambient] = moments(&sent);
    let [left, ..] = moments(&of_others);
    Ok(Sketch {
        hidden,
        contrast: match whole > 0.0 {
            true => (variance / whole).sqrt(),
            false => 0.0,
        },
        left: match variance > 0.0 {
            true => (left / variance).sqrt().min(1.0),
            false => 1.0,
        },
        reflected: match ambient > 0.0 {
            true => (whole / ambient).sqrt(),
            false => 1.0,
        },
        curved: curved(&surfels),
        ..Sketch::default()
    })
}

/// Cosines between normals of neighbours on a curved surface: not of one plane, nor across an edge.
const CURVED: Range<f32> = 0.7..0.9995;

/// A body of a sixth of all points is in the sight of most others.
const IN_SIGHT: f64 = 6.0;

fn curved(surfels: &Surfels) -> f64 {
    let cosines: Vec<f32> = (surfels.normals.windows(2))
        .map(|pair| pair[0].dot(pair[1]))
        .filter(|cosine| *cosine > CURVED.start)
        .collect();
    let curved = cosines.iter().filter(|cosine| CURVED.contains(*cosine));
    (IN_SIGHT * curved.count() as f64 / cosines.len().max(1) as f64).min(1.0)
}

/// How much larger the contrast of the lamps' light is, as bright spots close to them are not among the few
/// points that are looked at.
fn overlooked(scene: &Scene) -> f64 {
    let positions = &scene.cloud.positions;
    let light = |p: &DVec3| -> f64 {
        let lamps = scene.lights.iter();
        lamps
            .map(|lamp| {
                f64::from(lamp.intensity.element_sum()) / lamp.position.distance_squared(*p)
            })
            .sum()
    };
    let step = positions.len().div_ceil(looked_at(positions.len())).max(1);
    let mut sums = [[0.0; 3]; 2];
    for (i, p) in positions.iter().enumerate() {
        let light = light(p);
        if light.is_finite() {
            let some = i % step == 0;
            for sums in &mut sums[..=usize::from(some)] {
                *sums = [sums[0] + 1.0, sums[1] + light, sums[2] + light * light];
            }
        }
    }
    let [all, some] = sums.map(|[count, sum, squares]| count * squares / (sum * sum));
    let ratio = (all / some).sqrt();
    if ratio.is_finite() {
        ratio.max(1.0)
    } else {
        1.0
    }
}

/// How many of so many points are looked at.
fn looked_at(points: usize) -> usize {
    ((ENOUGH * points as f64) as usize).clamp(1, POINTS)
}

/// Surfels of some of the points, as if they were the whole cloud. A surface without normals is fitted to
/// more of them.
fn few(scene: &Scene) -> Result<Prepared> {
    let cloud = &scene.cloud;
    let missing = cloud.normals.len() < cloud.len() || cloud.normals.contains(&Vec3::ZERO);
    let enough = looked_at(cloud.len());
    if !missing {
        return Surfels::prepare(&every(cloud, enough), &Silent);
    }
    let evidence = Evidence {
        lamps: scene.lights.iter().map(|light| light.position).collect(),
        ..Evidence::default()
    };
    let thinning = Thinning {
        max_points: Some(enough),
        ..Thinning::default()
    };
    Surfels::of_scan(
        &every(cloud, WITHOUT_NORMALS),
        &evidence,
        &thinning,
        &Silent,
    )
}

fn every(cloud: &PointCloud, most: usize) -> PointCloud {
    let step = cloud.len().div_ceil(most).max(1);
    fn of<T: Copy>(all: &[T], step: usize) -> Vec<T> {
        all.iter().copied().step_by(step).collect()
    }
    PointCloud {
        positions: of(&cloud.positions, step),
        normals: of(&cloud.normals, step),
        reflectance: of(&cloud.reflectance, step),
        emission: of(&cloud.emission, step),
        ..PointCloud::default()
    }
}

fn hidden(surfels: &Surfels, visibility: &dyn Visibility, seed: u64) -> Result<f64> {
    let mut random = stream(seed, Purpose::Sketch, 0);
    let n = surfels.len();
    let pairs = (0..SEGMENTS).map(|_| [(); 2].map(|()| random.random_range(0..n)));
    let faces = |i: usize, j: usize| {
        surfels.normals[i].dot(surfels.positions[j] - surfels.positions[i]) > 0.0
    };
    let segments: Vec<_> = pairs
        .filter(|&[i, j]| faces(i, j) && faces(j, i))
        .map(|[i, j]| surfels.segment(i, j))
        .collect();
    let seen = visibility.visible(&segments)?.into_iter().filter(|v| *v);
    Ok(1.0 - seen.count() as f64 / segments.len().max(1) as f64)
}
