//! Where surfaces meet or nearly do: blocks on a floor, plates close to each other, the edges of a
//! room. Lengths are in spacings.

mod clouds;
mod rooms;

use std::f64::consts::PI;

use clouds::random;
use fmmgi_gpu::Method;
use glam::DVec3;
use rand::RngExt;
use rooms::*;

/// Irradiance by `method` at the places of `receivers`, next to the truth there.
fn against(
    rects: &[Rect],
    sampling: Sampling,
    method: Method,
    receiver: impl Fn(DVec3, DVec3) -> bool,
    truth: impl Fn(DVec3, DVec3) -> f64,
) -> Vec<(f64, f64)> {
    let cloud = points(rects, 1.0, sampling, 1);
    let light = light(&cloud, method, 0.01);
    (0..cloud.len())
        .map(|k| (k, cloud.positions[k], cloud.normals[k].as_dvec3()))
        .filter(|&(_, p, n)| receiver(p, n))
        .map(|(k, p, n)| (light[k], truth(p, n)))
        .collect()
}

fn on_floor(p: DVec3, n: DVec3) -> bool {
    n.z > 0.5 && p.z < 0.1
}

fn black(r: Rect) -> Rect {
    Rect {
        reflectance: 0.0,
        ..r
    }
}

fn shining(r: Rect) -> Rect {
    Rect {
        emission: 1.0,
        ..black(r)
    }
}

/// A floor of 40 by 40 without what is under a block of 8 by 8, 5 high, on it.
fn block_on_floor() -> (Vec<Rect>, [Rect; 5]) {
    let floor = rect(DVec3::ZERO, DVec3::X * 40.0, DVec3::Y * 40.0);
    let floor = with_hole(floor, [0.4, 0.4], [0.6, 0.6]);
    let b = outside_of(DVec3::new(16.0, 16.0, 0.0), DVec3::new(8.0, 8.0, 5.0));
    let sides = [b[0], b[1], b[2], b[3], b[5]];
    (floor.into_iter().map(black).collect(), sides.map(black))
}

/// What a place gets from an area of radiosity 1 around another, facing, with rectangles in the way.
fn exchanged(place: DVec3, normal: DVec3, to: DVec3, facing: DVec3, blockers: &[Rect]) -> f64 {
    let way = to - place;
    let (cos, cos_there) = (normal.dot(way), -facing.dot(way));
    let open = cos > 0.0 && cos_there > 0.0;
    match open && !blockers.iter().any(|b| b.blocks(place, to)) {
        true => cos * cos_there / (PI * way.length_squared().powi(2)),
        false => 0.0,
    }
}

/// Irradiance from a shining rectangle, from a random place in each of 64 by 64 strata.
fn quadrature(source: &Rect, blockers: &[Rect], place: DVec3, normal: DVec3) -> f64 {
    const STRATA: usize = 64;
    let mut rng = random(1);
    let strata = (0..STRATA * STRATA).map(|k| {
        let mut at = |q: usize| (q as f64 + rng.random::<f64>()) / STRATA as f64;
        let to = source.at(at(k / STRATA), at(k % STRATA));
        exchanged(place, normal, to, source.normal(), blockers)
    });
    strata.sum::<f64>() * source.area() / (STRATA * STRATA) as f64
}

// A shining ceiling over the block: irradiance of the floor within a spacing of it.
// Measured with exact sums: 0.8% for strata, 2.9% for a grid, whose pairs all cross the edge of the
// shadow at one place, and 2.1% for random points; with samples 2 to 4%. Against the same sums with the
// exact answer to who sees whom: 0, 0.4%, 0.5%.
#[test]
fn beside_a_block() {
    let (floor, block) = block_on_floor();
    let ceiling = shining(rect(
        DVec3::new(0.0, 0.0, 20.0),
        DVec3::Y * 40.0,
        DVec3::X * 40.0,
    ));
    let all: Vec<Rect> = [&floor[..], &block, &[ceiling]].concat();
    let middle = DVec3::new(20.0, 20.0, 0.0);
    let beside = |p: DVec3, n: DVec3| {
        let q = (p - middle).abs();
        on_floor(p, n) && q.x.max(q.y) < 5.0
    };
    for (sampling, most) in SAMPLINGS.into_iter().zip([0.045_f64, 0.015, 0.035]) {
        let truth = |p: DVec3, n: DVec3| quadrature(&ceiling, &block, p, n);
        for (method, most) in [(Method::Direct, most), (Method::Fmm, most.max(0.06))] {
            let [l2, bias] = errors(against(&all, sampling, method, beside, truth));
            println!(
                "beside a block, {sampling:?}, {method:?}: relative L2 {l2:.4}, bias {bias:+.4}"
            );
            assert!(l2 < most);
        }
        let cloud = points(&all, 1.0, sampling, 1);
        let areas = clouds::surfels(&cloud).areas;
        let sum = |p: DVec3, n: DVec3| {
            let lamps = (0..cloud.len()).filter(|&k| cloud.emission[k].x > 0.0);
            lamps
                .map(|k| {
                    let there = cloud.positions[k];
                    f64::from(areas[k]) * exchanged(p, n, there, ceiling.normal(), &block)
                })
                .sum()
        };
        let [l2, bias] = errors(against(&all, sampling, Method::Direct, beside, sum));
        println!(
            "beside a block, {sampling:?}, who sees whom alone: relative L2 {l2:.5}, bias {bias:+.5}"
        );
        assert!(l2 < 0.008);
    }
}

// A low strip shines along the floor; behind the block, as wide as the floor, all is dark. Measured:
// nothing of grids and strata, 3e-8 of the light before it of random points.
#[test]
fn no_light_under_a_block() {
    let floor = |x: f64, width: f64| black(rect(DVec3::X * x, DVec3::X * width, DVec3::Y * 40.0));
    let strip = shining(rect(DVec3::ZERO, DVec3::Y * 40.0, DVec3::Z * 3.0));
    let block = outside_of(DVec3::new(16.0, 0.0, 0.0), DVec3::new(8.0, 40.0, 5.0)).map(black);
    let [near, far, top] = [block[0], block[1], block[5]];
    let all = [floor(0.0, 16.0), floor(24.0, 16.0), strip, near, far, top];
    for sampling in SAMPLINGS {
        for method in [Method::Direct, Method::Fmm] {
            let light = |keep: &dyn Fn(DVec3) -> bool| {
                let floor = |p: DVec3, n: DVec3| on_floor(p, n) && keep(p);
                let found = against(&all, sampling, method, floor, |_, _| 0.0);
                found.iter().map(|p| p.0).sum::<f64>() / found.len() as f64
            };
            let share = light(&|p| p.x > 24.0) / light(&|p| p.x < 16.0);
            println!(
                "behind a block, {sampling:?}, {method:?}: {share:.1e} of the light before it"
            );
            assert!(share < 1e-6);
        }
    }
}

// Two plates of 30 by 30 that face each other across a narrow gap. Measured (grid, strata, random):
// 0.1%, 0.9%, 2.8% at a gap of 3; 0.6%, 1.7%, 5.3% at 2; 1.5%, 2.4%, 12% at 1. Beyond two spacings
// surfels are points to each other: over a gap of one that is a sum with nodes as wide as the kernel,
// and the areas of random points are cells'.
#[test]
fn close_parallel_walls() {
    for (gap, most) in [
        (3.0, [0.003, 0.013, 0.04]),
        (2.0, [0.009, 0.025, 0.08]),
        (1.0, [0.023, 0.035, 0.17]),
    ] {
        let lower = shining(rect(DVec3::ZERO, DVec3::X * 30.0, DVec3::Y * 30.0));
        let upper = black(rect(DVec3::Z * gap, DVec3::Y * 30.0, DVec3::X * 30.0));
        for (sampling, most) in SAMPLINGS.into_iter().zip(most) {
            for method in [Method::Direct, Method::Fmm] {
                let truth = |p, n| lower.form_factor(p, n);
                let above = |p: DVec3, _| p.z > 0.0;
                let [l2, bias] = errors(against(&[lower, upper], sampling, method, above, truth));
                println!(
                    "plates {gap} apart, {sampling:?}, {method:?}: relative L2 {l2:.4}, bias \
                     {bias:+.4}"
                );
                assert!(l2 < most);
            }
        }
    }
}

// A shining floor and a wall on it, of 20 by 20: irradiance of the wall up to some height. Measured
// within one spacing of the edge (grid, strata, random): 0.7%, 1.7%, 8.2%.
#[test]
fn near_the_edge_of_a_room() {
    let floor = shining(rect(DVec3::ZERO, DVec3::X * 20.0, DVec3::Y * 20.0));
    let wall = black(rect(DVec3::ZERO, DVec3::Y * 20.0, DVec3::Z * 20.0));
    for (sampling, most) in SAMPLINGS.into_iter().zip([0.011, 0.025, 0.12]) {
        for method in [Method::Direct, Method::Fmm] {
            for height in [1.0, 3.0, 20.0] {
                let near = |p: DVec3, n: DVec3| n.x > 0.5 && p.z < height;
                let truth = |p, n| floor.form_factor(p, n);
                let [l2, bias] = errors(against(&[floor, wall], sampling, method, near, truth));
                println!(
                    "wall up to {height} over a floor, {sampling:?}, {method:?}: relative L2 \
                     {l2:.4}, bias {bias:+.4}"
                );
                assert!(l2 < most);
            }
        }
    }
}
