//! How the cost of links grows with the number of points, at a fixed tolerance:
//! `cargo bench --bench growth`, with `-- 20000 200000 cave` for other numbers of points or some of
//! the scenes.
//!
//! Each line comes from a process of its own, whose memory is its own; the exponent is that of the
//! seconds of all its threads together. The plan says beforehand how much that will be: the
//! seconds of an idle machine, and the bytes beside the points.

use std::process::Command;

use fmmgi_gpu::chart::fit::exponent;
use fmmgi_gpu::chart::{Clock, Spent};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Method, Options, Scene, illuminate, memory};

const SCENES: [(&str, f64); 3] = [("cornell", 0.02), ("organic", 0.02), ("cave", 0.025)];
const SIZES: [usize; 4] = [20_000, 93_000, 430_000, 2_000_000];

fn main() {
    let given: Vec<String> = std::env::args().skip(1).collect();
    if let [flag, name, points, tolerance] = &given[..]
        && flag == "--one"
    {
        return one(name, points.parse().unwrap(), tolerance.parse().unwrap());
    }
    let sizes: Vec<usize> = given.iter().filter_map(|a| a.parse().ok()).collect();
    let sizes = if sizes.is_empty() {
        SIZES.to_vec()
    } else {
        sizes
    };
    let asked = |name: &str| given.iter().any(|a| a == name);
    let any = SCENES.iter().any(|(name, _)| asked(name));
    for (name, tolerance) in SCENES.iter().filter(|(name, _)| !any || asked(name)) {
        println!("{name} to {tolerance}");
        println!(
            "    points | prepare octree  links  tests  solve  total s (CPU) expected | segments, links a point | \
             bytes a point, estimated"
        );
        let times: Vec<(f64, f64)> = sizes.iter().map(|&n| line(name, n, *tolerance)).collect();
        println!(
            "  time grows as points^{:.2}",
            exponent(&times).unwrap_or(f64::NAN)
        );
    }
}

/// Prints the line of one size; points and CPU seconds.
fn line(name: &str, points: usize, tolerance: f64) -> (f64, f64) {
    let numbers = [points.to_string(), tolerance.to_string()];
    let child = Command::new(std::env::current_exe().unwrap())
        .args(["--one", name])
        .args(numbers)
        .output()
        .unwrap();
    let text = String::from_utf8(child.stdout).unwrap();
    let mut words = text.split('\t');
    let mut number = || words.next().unwrap().trim().parse::<f64>().unwrap();
    let (points, seconds) = (number(), number());
    println!("{}", words.next().unwrap().trim_end());
    (points, seconds)
}

/// A run in this process: surfels, CPU seconds and the line of the table.
fn one(name: &str, points: usize, tolerance: f64) {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
        ..SceneOptions::default()
    };
    let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    let options = Options {
        method: Method::Fmm,
        tolerance: Some(tolerance),
        ..Options::default()
    };
    let clock = Clock::start();
    let stats = illuminate(&scene, &options, Backend::Cpu, &Silent)
        .unwrap()
        .stats;
    let Spent { wall: total, cpu } = clock.spent();
    let (s, n) = (&stats.seconds, stats.surfels as f64);
    let bytes = memory::peak_bytes().map_or(f64::NAN, |b| b as f64 / n);
    let plan = stats.plan.unwrap();
    let estimated = plan.bytes as f64 / n;
    println!(
        "{n}\t{cpu}\t{n:10} | {:7.2} {:6.2} {:6.2} {:6.2} {:6.2} {total:6.2} ({cpu:.2}) {:8.2} | {:8.1} {:14.1} | \
         {bytes:8.0} {estimated:6.0}",
        s.prepare,
        s.octree,
        s.links,
        s.visibility,
        s.solve,
        plan.seconds,
        stats.segments as f64 / n,
        stats.links.values().sum::<u64>() as f64 / n,
    );
}
