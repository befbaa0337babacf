//! Time and memory of octree and lists for a box with a ball in it:
//! `cargo run --release --example lists -- 10000000 32 1e-5`.

mod room;

use std::time::Instant;

use fmmgi_gpu::links::{Cosines, Links, Mac, THETA, adaptive, dual};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Result, memory};

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
    let given = room::with_ball(n);
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
        dual(&octree, &s, mac.order, judge, &Silent)
    })?;
    println!("{:?}", links.counts());
    drop(links);
    let links: Links = step("adaptive lists", n, held, || {
        adaptive(&octree, &s, cosines, 3, &Silent)
    })?;
    println!("{:?}", links.counts());
    Ok(())
}
