//! How the cost of links grows with the number of points, at a fixed tolerance:
//! `cargo bench --bench growth`, with `-- 20000 200000 cave` for other numbers of points or some of
//! the scenes.
//!
//! Each line comes from a process of its own, whose memory is its own; the exponent is that of the
//! seconds of all its threads together. The plan says beforehand how much that will be: the
//! seconds of an idle machine, and the bytes beside the points.

use std::process::Command;
use std::time::Instant;

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
        println!("  time grows as points^{:.2}", exponent(&times));
    }
}

/// Prints the line of one size; the logarithms of points and time.
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
    (points.ln(), seconds.ln())
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
    let (clock, before) = (Instant::now(), cpu_seconds());
    let stats = illuminate(&scene, &options, Backend::Cpu, &Silent)
        .unwrap()
        .stats;
    let (total, cpu) = (clock.elapsed().as_secs_f64(), cpu_seconds() - before);
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

/// Seconds of all threads of this process.
fn cpu_seconds() -> f64 {
    // SAFETY: getrusage fills the struct that it is given, which is one of plain numbers.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_SELF, &mut usage);
        usage
    };
    let seconds = |t: libc::timeval| t.tv_sec as f64 + 1e-6 * t.tv_usec as f64;
    seconds(usage.ru_utime) + seconds(usage.ru_stime)
}

/// Slope of the line through the points, least squares.
fn exponent(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / n;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let slope = |p: &(f64, f64)| (p.0 - x) * (p.1 - y);
    let square = |p: &(f64, f64)| (p.0 - x).powi(2);
    points.iter().map(slope).sum::<f64>() / points.iter().map(square).sum::<f64>()
}
