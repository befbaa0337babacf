//! Is what `auto` chooses the best there is? `cargo bench --bench choices`, with `-- 3000 10000 cave` for
//! other numbers of points or some of the scenes.
//!
//! For every scene, number of points and tolerance: `auto` and everything that it might have chosen
//! instead. Each solution is verified against the exact sums over its own points; of those that keep the
//! tolerance the fastest is what `auto` is held against. Times are the CPU seconds of all threads, of
//! everything after the points are there, the least of several runs. Last what the plan expected: seconds
//! on an idle machine of two cores, and bytes beside the points.

use std::time::Instant;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Method, Options, Plan, Scene, Stats, Transport, illuminate};

const SCENES: [&str; 7] = [
    "cornell",
    "two_rooms",
    "organic",
    "cave",
    "furnace",
    "plates_parallel",
    "plates_perpendicular",
];
const SIZES: [usize; 3] = [1000, 3000, 10_000];
const TOLERANCES: [f64; 3] = [0.1, 0.03, 0.01];
/// Exact sums over more points are never the fastest.
const DIRECT: usize = 5000;
const RAYS: [u32; 7] = [16, 32, 64, 128, 256, 512, 1024];
/// Runs shorter than this are repeated.
const SHORT: f64 = 0.5;

fn main() {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let sizes: Vec<usize> = given.iter().filter_map(|a| a.parse().ok()).collect();
    let sizes = if sizes.is_empty() {
        SIZES.to_vec()
    } else {
        sizes
    };
    let tolerances: Vec<f64> = (given.iter())
        .filter_map(|a| a.strip_prefix("to=")?.parse().ok())
        .collect();
    let tolerances = if tolerances.is_empty() {
        TOLERANCES.to_vec()
    } else {
        tolerances
    };
    let asked = |name: &&&str| given.iter().any(|a| a == **name);
    let any = SCENES.iter().any(|name| asked(&name));
    println!(
        "scene, points, tolerance   | auto: CPU s, method    | best that keeps it      | auto/best | \
         expected s"
    );
    let mut ratios = Vec::new();
    for name in SCENES.iter().filter(|name| !any || asked(name)) {
        for &points in &sizes {
            let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
            let options = SceneOptions {
                points: Some(points),
                seed: 1,
                ..SceneOptions::default()
            };
            let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
            for &tolerance in &tolerances {
                ratios.push(line(name, &scene, tolerance));
            }
        }
    }
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    let within = ratios.iter().filter(|r| **r <= 1.3).count();
    println!(
        "auto/best: median {median:.2}, worst {:.2}, within 1.3 in {within} of {}",
        ratios[ratios.len() - 1],
        ratios.len()
    );
}

/// A way to do it, and what it took.
struct Run {
    what: String,
    seconds: f64,
    keeps: bool,
}

/// Prints a line; the ratio of auto to the best.
fn line(name: &str, scene: &Scene, tolerance: f64) -> f64 {
    let options = |method| Options {
        method,
        tolerance: Some(tolerance),
        ..Options::default()
    };
    let (auto, stats) = run(|| {
        illuminate(scene, &options(Method::Auto), Backend::Cpu, &Silent)
            .unwrap()
            .stats
    });
    let plan = stats.plan.clone().unwrap();
    let mut runs = vec![Run {
        what: told(&stats),
        seconds: auto,
        keeps: true,
    }];
    let mut add = |what: &str, found: (f64, Stats)| {
        let (seconds, stats) = found;
        let keeps = stats.converged && stats.error.is_none_or(|error| error.met);
        runs.push(Run {
            what: format!("{what}{}", told(&stats)),
            seconds,
            keeps,
        });
        keeps
    };
    let planned = |plan: &Plan, method| {
        run(|| {
            let plan = plan.clone();
            let options = options(method);
            let mut transport =
                Transport::planned(scene, &options, Backend::Cpu, plan, &Silent).unwrap();
            transport.illuminate(scene, &Silent).unwrap().stats
        })
    };
    let by_links = Plan::new(scene, &options(Method::Fmm), &Backend::Cpu).unwrap();
    for order in [0, 1, 2, 3] {
        let plan = Plan {
            order: Some(order),
            ..by_links.clone()
        };
        add("", planned(&plan, Method::Fmm));
    }
    for leaf_size in [2, 8, 16] {
        let plan = Plan {
            leaf_size,
            ..by_links.clone()
        };
        let what = format!("leaves of {leaf_size}: ");
        add(&what, planned(&plan, Method::Fmm));
    }
    if scene.cloud.len() <= DIRECT {
        let plan = Plan::new(scene, &options(Method::Direct), &Backend::Cpu).unwrap();
        add("", planned(&plan, Method::Direct));
    }
    for rays in RAYS {
        let options = Options {
            rays: Some(rays),
            ..options(Method::Gather)
        };
        let found = run(|| {
            illuminate(scene, &options, Backend::Cpu, &Silent)
                .unwrap()
                .stats
        });
        if add("", found) {
            break;
        }
    }
    let keeping = runs.iter().filter(|run| run.keeps);
    let best = keeping.min_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let best = best.unwrap();
    let ratio = auto / best.seconds;
    println!(
        "{name:20} {:6} {tolerance:4} | {auto:6.2} {:16} | {:6.2} {:17} | {ratio:9.2} | {:5.2}",
        scene.cloud.len(),
        told(&stats),
        best.seconds,
        best.what,
        plan.seconds,
    );
    ratio
}

/// The method in words.
fn told(stats: &Stats) -> String {
    match (stats.rays, stats.order) {
        (Some(rays), _) => format!("{rays} rays"),
        (_, Some(order)) => format!("fmm of order {order}"),
        _ => "direct".into(),
    }
}

/// CPU seconds, and what came of it.
fn run(work: impl Fn() -> Stats) -> (f64, Stats) {
    let once = || {
        let before = cpu_seconds();
        let stats = work();
        (cpu_seconds() - before, stats)
    };
    let clock = Instant::now();
    let (mut least, stats) = once();
    while clock.elapsed().as_secs_f64() < SHORT {
        least = least.min(once().0);
    }
    (least, stats)
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
