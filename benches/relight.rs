//! What a kept transport saves: fresh solves and relights side by side, each with its error against
//! exact sums, and how fast a kept operator is loaded: `cargo bench --bench relight [-- POINTS LOADED]`,
//! by default 128000 and 1000000; 0 leaves a part out. Fresh solves are by `auto`; what is kept are links, and
//! then whatever a transport for many lights takes.

#[path = "../tests/relit/mod.rs"]
mod relit;

use std::io::Read;
use std::time::Instant;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Backend, Illumination, Method, Options, Transport, illuminate};
use relit::{errors, lamp, move_lamp};

const RECEIVERS: usize = 200;

struct Case {
    scene: &'static str,
    tolerance: f64,
    /// Where the lamp hangs, and what is said about it.
    lamps: &'static [(&'static str, [f64; 3])],
}

const CASES: [Case; 3] = [
    Case {
        scene: "cornell",
        tolerance: 0.02,
        lamps: &[
            ("at the ceiling", [0.5, 0.9, 0.5]),
            ("a little aside", [0.55, 0.9, 0.5]),
            ("in a corner", [0.85, 0.7, 0.8]),
            ("behind a block", [0.15, 0.2, 0.1]),
            ("at the ceiling again", [0.5, 0.9, 0.5]),
        ],
    },
    Case {
        scene: "two_rooms",
        tolerance: 0.02,
        lamps: &[
            ("in the first room", [2.0, 2.0, 1.5]),
            ("in the other room", [6.0, 2.0, 1.5]),
            ("in the first room again", [2.0, 2.0, 1.5]),
        ],
    },
    Case {
        scene: "organic",
        tolerance: 0.02,
        lamps: &[
            ("above", [0.5, 0.9, 0.5]),
            ("aside", [0.7, 0.9, 0.5]),
            ("low", [0.85, 0.1, 0.85]),
        ],
    },
];

fn main() {
    let mut numbers = std::env::args().filter_map(|a| a.parse().ok());
    let points = numbers.next().unwrap_or(128_000);
    let loaded = numbers.next().unwrap_or(1_000_000);
    if points > 0 {
        println!(
            "lamp: fresh s, error; relit s, error (links, visibility, solve, checks, verification), share, segments"
        );
        CASES.iter().for_each(|case| table(case, points));
    }
    if loaded > 0 {
        load(loaded);
    }
}

/// A kept operator against the mere reading of its file.
fn load(points: usize) {
    let case = &CASES[0];
    let scene = lamp(case.scene, points, case.lamps[0].1);
    let options = Options {
        method: Method::Fmm,
        tolerance: Some(case.tolerance),
        ..Options::default()
    };
    let fresh = || Transport::new(&scene, &options, Backend::Cpu, &Silent).unwrap();
    let (prepare, mut transport) = timed(fresh);
    let (light, _) = timed(|| transport.illuminate(&scene, &Silent).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept");
    let (save, ()) = timed(|| transport.save(&path).unwrap());
    drop(transport);
    let megabytes = std::fs::metadata(&path).unwrap().len() as f64 * 1e-6;
    println!(
        "{} points: prepared in {prepare:.2} s, lit in {light:.2} s, {megabytes:.0} MB saved in {save:.2} s",
        scene.cloud.len()
    );
    for _ in 0..3 {
        let mut chunk = vec![0; 1 << 17];
        let (read, ()) = timed(|| {
            let mut file = std::fs::File::open(&path).unwrap();
            while file.read(&mut chunk).unwrap() > 0 {}
        });
        let load = || Transport::load(&path, &scene, &options, Backend::Cpu, &Silent).unwrap();
        let (load, _) = timed(load);
        println!(
            "  read in {read:.3} s ({:.0} MB/s), loaded in {load:.3} s ({:.0} MB/s)",
            megabytes / read,
            megabytes / load
        );
    }
}

fn table(case: &Case, points: usize) {
    let by = |method| Options {
        method,
        tolerance: Some(case.tolerance),
        ..Options::default()
    };
    let mut scene = lamp(case.scene, points, case.lamps[0].1);
    println!(
        "{} of {} points, tolerance {}",
        case.scene,
        scene.cloud.len(),
        case.tolerance
    );
    let [links, any] = [Method::Fmm, Method::Auto].map(by);
    let kept = |options| Transport::new(&scene, options, Backend::Cpu, &Silent).unwrap();
    let mut kept = [("links", kept(&links)), ("auto", kept(&any))];
    for &(what, place) in case.lamps {
        move_lamp(&mut scene, place);
        let of = |lit: &Illumination| 100.0 * errors(&scene, lit, RECEIVERS, |_| true).indirect;
        let (fresh, afresh) = timed(|| illuminate(&scene, &any, Backend::Cpu, &Silent).unwrap());
        println!(
            "  {what:24} {fresh:5.2} {:5.2}%  {}",
            of(&afresh),
            way(&afresh)
        );
        for (by, transport) in &mut kept {
            let (seconds, relit) = timed(|| transport.illuminate(&scene, &Silent).unwrap());
            let s = &relit.stats.seconds;
            println!(
                "      {by:20} {seconds:5.2} {:5.2}%  ({:.2}, {:.2}, {:.2}, {:.2}, {:.2}) {:3.0}% {:9} {}",
                of(&relit),
                s.links,
                s.visibility,
                s.solve,
                s.checks,
                s.verification,
                100.0 * seconds / fresh,
                relit.stats.segments,
                way(&relit),
            );
        }
    }
}

fn way(lit: &Illumination) -> String {
    let rays = lit.stats.rays.map(|rays| format!(", {rays} rays"));
    let not_met = if lit.stats.met() { "" } else { ", not met" };
    format!(
        "{:?}{}{not_met}",
        lit.stats.method,
        rays.unwrap_or_default()
    )
}

fn timed<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let done = work();
    (start.elapsed().as_secs_f64(), done)
}
