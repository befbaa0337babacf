//! A device on trial: every kind of stage on a tiny case, next to its twin on the CPU.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use super::{Fields, Fmm, GpuFields, GpuFmm, HostFields, TransportOperator};
use crate::error::{Error, Result};
use crate::links::{Entry, Links, Rows};
use crate::octree::Octree;
use crate::passes::gpu::{Gpu, GpuVisibility};
use crate::points::{PointCloud, Surfels};
use crate::progress::Silent;
use crate::visibility::{CpuVisibility, Occluders, Segment, Visibility};

/// Points of a side of each patch: several leaves and levels, and more than a workgroup.
const SIDE: usize = 8;
/// Most surfels in a leaf.
const LEAF: usize = 4;
/// Relative difference that rounding in f32 stays far below: 4e-6 at most, in tests.
const ROUNDING: f64 = 1e-4;

/// Compares a device with the CPU: the stages on expansions up to an order, the others, fields, and
/// lines of sight. Its pipelines stay for the work.
///
/// Fails with [`Error::NoBackend`] if it computes otherwise.
pub fn trial(gpu: &Gpu, order: usize) -> Result<()> {
    let (octree, surfels) = Octree::build(&patches()?, LEAF);
    arithmetic(gpu).map_err(refused("fields"))?;
    sight(gpu, &surfels).map_err(refused("visibility"))?;
    let light = colours(surfels.len(), 0.0);
    for (stages, links) in kinds(&octree, &surfels, order) {
        let compare = || {
            let found = irradiance(&GpuFmm::new(gpu, &surfels, &octree, &links)?, &light)?;
            let wanted = irradiance(&Fmm::<f32>::new(&surfels, &octree, &links), &light)?;
            same(&found, &wanted)
        };
        compare().map_err(refused(stages))?;
    }
    Ok(())
}

/// Says of an error what it was about.
fn refused(stages: &'static str) -> impl Fn(Error) -> Error {
    move |error| match error {
        Error::Device(what) => Error::NoBackend(format!(
            "the device is not to be trusted: on trial, {stages}: {what}. Another driver may do, or \
             --backend cpu"
        )),
        other => other,
    }
}

fn same(found: &[DVec3], wanted: &[DVec3]) -> Result<()> {
    let norm = |light: &mut dyn Iterator<Item = DVec3>| -> f64 {
        light.map(|h| h.length_squared()).sum::<f64>().sqrt()
    };
    let off = norm(&mut found.iter().zip(wanted).map(|(a, b)| *a - *b))
        / norm(&mut wanted.iter().copied());
    // What is not finite is no less off.
    match off <= ROUNDING {
        true => Ok(()),
        false => Err(Error::Device(format!("off by {:.2}%", 100.0 * off))),
    }
}

/// Two bumpy patches that face each other.
fn patches() -> Result<Surfels> {
    let mut cloud = PointCloud::default();
    for (z, side) in [(0.0, 1.0), (1.0, -1.0)] {
        for k in 0..SIDE * SIDE {
            let [x, y] = [k % SIDE, k / SIDE].map(|i| i as f64 / SIDE as f64 - 0.45);
            let [u, v] = [0.6 * x, 0.6 * y];
            let bump = 0.03 * (7.0 * u).sin() * (5.0 * v).cos();
            cloud.positions.push(DVec3::new(u, v, z + bump));
            let tilt = Vec3::new((7.0 * u).cos() as f32, (5.0 * v).sin() as f32, 0.0);
            cloud.normals.push((Vec3::Z - 0.2 * tilt) * side);
            cloud.reflectance.push(Vec3::splat(0.5));
            cloud.emission.push(Vec3::ZERO);
        }
    }
    Ok(Surfels::prepare(&cloud, &Silent)?.surfels)
}

fn colours(n: usize, phase: f64) -> Vec<DVec3> {
    let colour = |k: usize| DVec3::new(1.0, 2.0, 3.0) * (k as f64 / n as f64 * TAU + phase);
    (0..n)
        .map(|k| 1.0 + 0.5 * colour(k).map(f64::sin))
        .collect()
}

/// Links of each kind, from everywhere on the one patch to everywhere on the other, with the names
/// of the stages that they take.
fn kinds(octree: &Octree, surfels: &Surfels, order: usize) -> Vec<(&'static str, Links)> {
    let rows = |count: usize, height: &dyn Fn(usize) -> f32| {
        let apart = |t: usize, s: usize| (height(t) - height(s)).abs() > 0.8;
        let pairs = (0..count).flat_map(|t| (0..count).map(move |s| (t, s)));
        let entry = |(t, s): (usize, usize)| Entry {
            target: t as u32,
            source: s as u32,
            weight: ((t * 7 + s * 3) % 8 + 1) as f32 / 8.0,
        };
        let entries = pairs.filter(|&(t, s)| apart(t, s)).map(entry);
        Rows::new(count, entries.collect())
    };
    let facets = octree.facets.len();
    let far = rows(facets, &|f| octree.facets[f].centre.z);
    let near = rows(surfels.len(), &|i| surfels.positions[i].z);
    let expanded = || {
        let mut links = Links::none(facets, surfels.len());
        links.m2l = vec![Rows::none(facets); order + 1];
        links
    };
    let mut m2l = expanded();
    m2l.m2l[order] = far.clone();
    let mut sampled = expanded();
    sampled.sampled = far.clone();
    let mut m2p = expanded();
    m2p.m2p = far.clone();
    let mut p2l = expanded();
    p2l.p2l = far.clone();
    let mut mixed = expanded();
    mixed.mixed = far.clone();
    let mut p2p = expanded();
    p2p.p2p = far;
    let mut near_field = expanded();
    near_field.near = near;
    vec![
        ("near field", near_field),
        ("P2P", p2p),
        ("M2L, with P2M, M2M, L2L and L2P", m2l),
        ("M2L of samples", sampled),
        ("M2P, with P2M and M2M", m2p),
        ("P2L, with L2L and L2P", p2l),
        ("mixed", mixed),
    ]
}

fn irradiance<O: TransportOperator>(operator: &O, light: &[DVec3]) -> Result<Vec<DVec3>> {
    let fields = operator.fields();
    fields.download(&operator.apply(&fields.upload(light)?)?)
}

/// What a solver does with fields.
fn arithmetic(gpu: &Gpu) -> Result<()> {
    let n = 2 * SIDE * SIDE;
    let found = calculated(&GpuFields::new(gpu, n)?, n)?;
    same(&found, &calculated(&HostFields::<f32>::default(), n)?)
}

fn calculated<F: Fields>(fields: &F, n: usize) -> Result<Vec<DVec3>> {
    let mut x = fields.upload(&colours(n, 0.0))?;
    let y = fields.upload(&colours(n, 1.0))?;
    fields.scale(-0.5, &mut x)?;
    fields.multiply(&y, &mut x)?;
    fields.axpy(0.3, &y, &mut x)?;
    let mut all = fields.download(&x)?;
    all.push(DVec3::new(fields.dot(&x, &y)?, fields.dot(&x, &x)?, 0.0) / n as f64);
    Ok(all)
}

/// Lines of sight between the patches, and past one of them.
fn sight(gpu: &Gpu, surfels: &Surfels) -> Result<()> {
    let occluders = Occluders::build(surfels);
    let n = surfels.len() as u32;
    let segments: Vec<Segment> = (0..n)
        .flat_map(|i| {
            let from = surfels.positions[i as usize];
            let across = surfels.normals[i as usize].z.signum() * Vec3::Z;
            [0.5, 1.5].map(|length| Segment {
                from: from.to_array(),
                skip_from: i,
                to: (from + length * across).to_array(),
                skip_to: i,
            })
        })
        .collect();
    let found = GpuVisibility::new(gpu, &occluders)?.visible(&segments)?;
    let wanted = CpuVisibility::<f32>::new(&occluders).visible(&segments)?;
    match found.iter().zip(&wanted).filter(|(a, b)| a != b).count() {
        0 => Ok(()),
        wrong => Err(Error::Device(format!(
            "{wrong} of {} lines of sight are wrong",
            segments.len()
        ))),
    }
}
