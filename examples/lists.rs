//! Time and memory of octree and lists for a box with a ball in it:
//! `cargo run --release --example lists -- 10000000 32 1e-5`.

use std::f32::consts::TAU;
use std::time::Instant;

use fmmgi_gpu::links::{Cosines, Links, Mac, THETA, adaptive, dual};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Result, Surfels, memory};
use glam::{Vec2, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Points anywhere on the walls of the unit box, seen from inside, and on a ball in its middle.
fn surfels(n: usize) -> Surfels {
    const RADIUS: f32 = 0.25;
    let ball = TAU * 2.0 * RADIUS * RADIUS;
    let area = (6.0 + ball) / n as f32;
    let half = 0.5 * area.sqrt();
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let mut s = Surfels::default();
    for i in 0..n {
        let (u, v): (f32, f32) = (rng.random(), rng.random());
        let at = rng.random::<f32>() * (6.0 + ball);
        let (position, normal) = if at < 6.0 {
            let (axis, side) = (at as usize / 2, at as usize % 2);
            let mut position = Vec3::splat(side as f32);
            position[(axis + 1) % 3] = u;
            position[(axis + 2) % 3] = v;
            (position, Vec3::AXES[axis] * (1.0 - 2.0 * side as f32))
        } else {
            let z = 2.0 * v - 1.0;
            let n = (Vec2::from_angle(TAU * u) * (1.0 - z * z).sqrt()).extend(z);
            (Vec3::splat(0.5) + n * RADIUS, n)
        };
        let corner = |k: usize| Vec2::from_angle(TAU * (k as f32 + 0.5) / 8.0) * half;
        s.positions.push(position);
        s.normals.push(normal);
        s.areas.push(area);
        s.reflectance.push(Vec3::splat(0.5));
        s.emission.push(Vec3::ZERO);
        s.cells.tangents.push(normal.any_orthonormal_vector());
        s.cells.corners.push(std::array::from_fn(corner));
        s.offsets.push(0.02 * half);
        s.points.push(i as u32);
    }
    s
}

/// Does one step; prints its time, and what the process took at most so far beside what it `held`.
fn step<T>(name: &str, n: usize, held: f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let done = work();
    let seconds = start.elapsed().as_secs_f64();
    let peak = memory::peak_bytes().unwrap_or(0) as f64 / n as f64 - held;
    println!("{name}: {seconds:.2} s, at most {peak:.0} bytes a surfel");
    done
}

fn main() -> Result<()> {
    let arguments: Vec<f64> = std::env::args()
        .skip(1)
        .filter_map(|a| a.parse().ok())
        .collect();
    let [n, leaf_size, tolerance] = arguments[..] else {
        eprintln!("usage: lists POINTS LEAF_SIZE TOLERANCE (1 and more: cosines of either sign)");
        std::process::exit(2);
    };
    let (n, leaf_size) = (n as usize, leaf_size as usize);
    let cosines = match tolerance < 1.0 {
        true => Cosines::Clamped {
            tolerance: tolerance as f32,
        },
        false => Cosines::Signed,
    };
    let given = surfels(n);
    // The surfels, and once more in the octree's order.
    let held = 2.0 * memory::peak_bytes().unwrap_or(0) as f64 / n as f64;
    let (octree, s) = step("octree", n, held, || Octree::build(&given, leaf_size));
    let facets = &octree.facets;
    println!("{} facets, {} levels", facets.len(), octree.depth());
    let mac = Mac {
        theta: THETA,
        order: 3,
        cosines,
    };
    let judge = |t: u32, s: u32| mac.judge(&facets[t as usize], &facets[s as usize]);
    let links: Links = step("dual traversal", n, held, || {
        dual(&octree, &s, judge, &Silent)
    })?;
    println!("{:?}", links.counts());
    drop(links);
    let links: Links = step("adaptive lists", n, held, || {
        adaptive(&octree, &s, cosines, 3, &Silent)
    })?;
    println!("{:?}", links.counts());
    Ok(())
}
