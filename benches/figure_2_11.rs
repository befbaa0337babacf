//! Figure 2.11 of the report that this method comes from, repeated: one application of the operator to
//! the Cornell box without occlusion, by brute force and by the multipole method at 1% error, for its
//! numbers of points; then where the method begins to pay, and how its time grows.
//!
//! `cargo bench --bench figure_2_11`

use std::path::Path;
use std::time::Instant;

use fmmgi_gpu::chart::fit::exponent;
use fmmgi_gpu::chart::{Clock, median};
use fmmgi_gpu::links::{self, Accuracy, Links};
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::operator::{AllPairs, Fields, Fmm, TransportOperator, exact_irradiance};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::NothingInTheWay;
use fmmgi_gpu::{Result, Scene, Surfels};
use glam::{DVec3, Vec3};

const TOLERANCE: f64 = 0.01;
/// Points, the report's leaf size, and its seconds by the multipole method and by brute force.
const REPORT: [(usize, usize, f64, f64); 4] = [
    (1_658, 100, 1.112, 0.575),
    (12_632, 200, 7.302, 9.261),
    (36_600, 300, 15.975, 51.201),
    (110_528, 900, 30.568, 130.412),
];
const SIZES: [usize; 5] = [10_000, 31_600, 100_000, 316_000, 1_000_000];
/// Receivers at which the error is measured.
const RECEIVERS: usize = 300;

fn cornell(points: usize) -> Surfels {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    let options = SceneOptions {
        points: Some(points),
        seed: 0,
        ..SceneOptions::default()
    };
    let scene = Scene::load(&path, &options, &Silent).expect("scene");
    Surfels::prepare(&scene.cloud, &Silent)
        .expect("surfels")
        .surfels
}

/// The light that is sent out: what is reflected of an even light, and the lamp.
fn radiosity(surfels: &Surfels) -> Vec<DVec3> {
    let colours = surfels.reflectance.iter().zip(&surfels.emission);
    colours
        .map(|(r, e)| (*r + e.min(Vec3::ONE)).as_dvec3())
        .collect()
}

/// Median of the seconds of several runs.
fn seconds(runs: usize, mut run: impl FnMut()) -> f64 {
    let times = (0..runs).map(|_| {
        let clock = Clock::start();
        run();
        clock.spent().wall
    });
    median(&times.collect::<Vec<f64>>())
}

fn brute_force(surfels: &Surfels) -> f64 {
    let operator = AllPairs::<f32>::new(surfels);
    let field = operator
        .fields()
        .upload(&radiosity(surfels))
        .expect("field");
    let runs = if surfels.len() > 50_000 { 3 } else { 5 };
    seconds(runs, || drop(operator.apply(&field).expect("irradiance")))
}

/// Octree and links; a rough application says where light matters.
fn prepare(given: &Surfels, leaf_size: usize) -> Result<(Octree, Surfels, Links)> {
    let order = links::open::order(TOLERANCE);
    let (octree, surfels) = Octree::build(given, leaf_size);
    let sent = radiosity(&surfels);
    let rough = Accuracy::new(&octree, &sent, None, 0.3, order, 0);
    let rough = links::build(&surfels, &octree, &rough, &NothingInTheWay, &Silent)?;
    let operator = Fmm::<f32>::new(&surfels, &octree, &rough);
    let fields = operator.fields();
    let irradiance = fields.download(&operator.apply(&fields.upload(&sent)?)?)?;
    let fine = Accuracy::new(&octree, &sent, Some(&irradiance), TOLERANCE, order, 0);
    let links = links::build_open(&surfels, &octree, &fine, &Silent)?;
    Ok((octree, surfels, links))
}

/// One size with one leaf size.
struct Row {
    error: f64,
    application: f64,
    all_in: f64,
}

fn multipole(given: &Surfels, leaf_size: usize) -> Row {
    let mut all_in = f64::INFINITY;
    let mut prepared = None;
    for _ in 0..3 {
        let start = Instant::now();
        let (octree, surfels, links) = prepare(given, leaf_size).expect("links");
        let operator = Fmm::<f32>::new(&surfels, &octree, &links);
        let field = operator
            .fields()
            .upload(&radiosity(&surfels))
            .expect("field");
        drop(operator.apply(&field).expect("irradiance"));
        all_in = all_in.min(start.elapsed().as_secs_f64());
        prepared = Some((octree, surfels, links));
    }
    let (octree, surfels, links) = prepared.expect("three runs");
    let operator = Fmm::<f32>::new(&surfels, &octree, &links);
    let fields = operator.fields();
    let sent = radiosity(&surfels);
    let field = fields.upload(&sent).expect("field");
    let application = seconds(7, || drop(operator.apply(&field).expect("irradiance")));
    let found = fields
        .download(&operator.apply(&field).expect("irradiance"))
        .expect("field");
    let n = surfels.len();
    let receivers: Vec<usize> = (0..RECEIVERS).map(|k| k * n / RECEIVERS).collect();
    let exact = exact_irradiance(&surfels, &NothingInTheWay, &receivers, &sent).expect("truth");
    let (error, norm) = receivers
        .iter()
        .zip(&exact)
        .fold((0.0, 0.0), |(e, n), (&i, (h, _))| {
            (e + (found[i] - *h).length_squared(), n + h.length_squared())
        });
    Row {
        error: (error / norm).sqrt(),
        application,
        all_in,
    }
}

fn own_leaf_size(surfels: usize) -> usize {
    links::open::leaf_size(links::open::order(TOLERANCE), surfels)
}

fn figure() {
    println!("Cornell box, one application, nothing in the way; {TOLERANCE} asked for");
    println!(
        "{:>8} {:>5} {:>9} {:>10} {:>12} {:>8} {:>12} {:>8}   report",
        "points", "leaf", "error", "brute s", "application", "x brute", "all-in s", "x brute"
    );
    for (points, leaf_size, report_fmm, report_brute) in REPORT {
        let surfels = cornell(points);
        let brute = brute_force(&surfels);
        for leaf_size in [leaf_size, own_leaf_size(surfels.len())] {
            let row = multipole(&surfels, leaf_size);
            println!(
                "{:>8} {leaf_size:>5} {:>9.2e} {brute:>10.4} {:>12.5} {:>8.1} {:>12.4} {:>8.1}   \
                 {report_brute} / {report_fmm} s = {:.1}",
                surfels.len(),
                row.error,
                row.application,
                brute / row.application,
                row.all_in,
                brute / row.all_in,
                report_brute / report_fmm
            );
        }
    }
}

/// Where two times that grow by powers of the number of points cross, between sizes.
fn break_even() {
    let mut last: Option<(f64, [f64; 2])> = None;
    let mut found = [None; 2];
    for k in 0..9 {
        let surfels = cornell(250 << k);
        let n = surfels.len() as f64;
        let brute = brute_force(&surfels);
        let row = multipole(&surfels, own_leaf_size(surfels.len()));
        let gains = [brute / row.application, brute / row.all_in].map(f64::ln);
        if let Some((before, gains_before)) = last {
            for (at, (now, then)) in found.iter_mut().zip(gains.into_iter().zip(gains_before)) {
                if at.is_none() && now > 0.0 {
                    let part = (-then / (now - then)).clamp(0.0, 1.0);
                    *at = Some(before * (n / before).powf(part));
                }
            }
        }
        last = Some((n, gains));
    }
    let name = |at: Option<f64>| at.map_or("beyond 64,000".to_owned(), |n| format!("{n:.0}"));
    println!(
        "\nbreak-even with brute force: application {} points, all-in {} points (report: about \
         10,000)",
        name(found[0]),
        name(found[1])
    );
}

fn growth() {
    println!(
        "\n{:>8} {:>9} {:>12} {:>14} {:>10}",
        "points", "error", "application", "points/s", "all-in s"
    );
    let mut times = Vec::new();
    for points in SIZES {
        let surfels = cornell(points);
        let row = multipole(&surfels, own_leaf_size(surfels.len()));
        println!(
            "{:>8} {:>9.2e} {:>12.5} {:>14.3e} {:>10.3}",
            surfels.len(),
            row.error,
            row.application,
            surfels.len() as f64 / row.application,
            row.all_in
        );
        times.push((surfels.len() as f64, row.application));
    }
    let slope = exponent(&times).expect("several sizes");
    println!("time grows as points^{slope:.2}");
}

fn main() {
    println!(
        "{} threads",
        std::thread::available_parallelism().map_or(1, |n| n.get())
    );
    figure();
    break_even();
    growth();
}
