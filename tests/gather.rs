//! Links by rays against exact sums, closed forms and path tracing.

mod closed_forms;
mod common;
mod tracer;

use std::sync::atomic::{AtomicU64, Ordering};

use closed_forms::{parallel, perpendicular};
use common::{random, scene};
use fmmgi_gpu::links::{self, Close, Rows};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Direct, TransportOperator, exact_irradiance};
use fmmgi_gpu::passes::cpu;
use fmmgi_gpu::progress::{Progress, Silent};
use fmmgi_gpu::visibility::{CpuVisibility, NothingInTheWay, Occluders, first_hit};
use fmmgi_gpu::{Backend, Error, Method, Options, Scene, Surfels, illuminate};
use glam::{DVec2, DVec3};
use rand::RngExt;
use tracer::{Bounces, Receiver, Room};

/// The surfels of a scene, and what they are to rays.
struct Case {
    surfels: Surfels,
    occluders: Occluders,
    /// In the scan's coordinates.
    positions: Vec<DVec3>,
}

impl Case {
    fn new(scene: &Scene) -> Case {
        let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
        let surfels = Octree::build(&prepared.surfels, LEAF_SIZE).1;
        let positions = surfels.positions.iter();
        Case {
            occluders: Occluders::build(&surfels),
            positions: positions.map(|p| p.as_dvec3() + surfels.origin).collect(),
            surfels,
        }
    }

    fn rays(&self, numbers: std::ops::Range<u32>, seed: u64) -> Rows {
        let Case {
            surfels, occluders, ..
        } = self;
        let close = Close::none(surfels);
        links::gather::<f32>(surfels, occluders, &close, numbers, seed, &Silent).unwrap()
    }
}

fn apply(rows: &Rows, radiosity: &[f64]) -> Vec<f64> {
    let radiosity: Vec<DVec3> = radiosity.iter().map(|&b| DVec3::splat(b)).collect();
    let mut irradiance = vec![DVec3::ZERO; radiosity.len()];
    cpu::near_field::<f64, _>(rows, &radiosity, &mut irradiance);
    irradiance.iter().map(|h| h.x).collect()
}

fn relative_l2(found: &[f64], truth: &[f64]) -> f64 {
    let error: f64 = found.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum();
    let norm: f64 = truth.iter().map(|b| b * b).sum();
    (error / norm).sqrt()
}

/// Of the mean.
fn bias(found: &[f64], truth: &[f64]) -> f64 {
    found.iter().sum::<f64>() / truth.iter().sum::<f64>() - 1.0
}

/// Standard error of the mean of two halves over all receivers, whose rays do not depend on each other,
/// relative to it.
fn mean_noise(a: &[f64], b: &[f64]) -> f64 {
    let square: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    square.sqrt() / (a.iter().sum::<f64>() + b.iter().sum::<f64>())
}

const RAYS: [u32; 4] = [64, 256, 1024, 4096];

/// What 4096 rays are off by.
struct Off {
    error: f64,
    /// Standard errors of the receivers, and of their mean.
    noise: f64,
    mean_noise: f64,
    bias: f64,
}

/// Errors at 64 to 4096 rays against a truth, at the surfels to `keep`, and the noise in them: half of
/// what two halves of the rays differ by. K stratified rays into a scene with edges leave a noise of
/// K^(-3/4) (Mitchell 1996).
fn converges(name: &str, case: &Case, radiosity: &[f64], truth: &[f64], keep: &[bool]) -> Off {
    let kept = |values: &[f64]| -> Vec<f64> {
        let pairs = values.iter().zip(keep).filter(|(_, keep)| **keep);
        pairs.map(|(v, _)| *v).collect()
    };
    let truth = kept(truth);
    let mut rows = case.rays(0..32, 1);
    let mut half = 32;
    let mut found = Vec::new();
    while half < 4096 {
        let more = case.rays(half..2 * half, 1);
        let halves = [&rows, &more].map(|rows| kept(&apply(rows, radiosity)));
        let mean: Vec<f64> = halves[0]
            .iter()
            .zip(&halves[1])
            .map(|(a, b)| 0.5 * (a + b))
            .collect();
        half *= 2;
        let off = Off {
            error: relative_l2(&mean, &truth),
            noise: 0.5 * relative_l2(&halves[0], &halves[1]),
            mean_noise: mean_noise(&halves[0], &halves[1]),
            bias: bias(&mean, &truth),
        };
        if RAYS.contains(&half) {
            println!(
                "{name}, {half} rays: error {:.5}, noise {:.5}, bias {:+.5}, noise of that {:.5}",
                off.error, off.noise, off.bias, off.mean_noise
            );
        }
        found.push(off);
        rows = links::mean(&rows, &more, &Silent).unwrap();
    }
    let last = found.pop().unwrap();
    let rate = (found[0].noise / last.noise).log(64.0);
    println!("{name}: noise falls as rays^-{rate:.2}");
    assert!(rate > 0.65, "{name}: {rate}");
    last
}

/// Exact sums have an error of their own: the middle of a cell counts for the whole. (Measured: bias
/// 0.20% from 64 rays on, and so none of the noise, which is 0.003% of the mean at 4096 rays.)
#[test]
fn it_converges_to_exact_sums() {
    let case = Case::new(&scene("cornell", 2000));
    let visibility = CpuVisibility::<f64>::new(&case.occluders);
    let direct = Direct::new(&case.surfels, &visibility, &Silent).unwrap();
    let wave = |p: &DVec3| 1.0 + 0.5 * (3.0 * p.x).sin() * (4.0 * p.y - 2.0 * p.z).cos();
    let radiosity: Vec<f64> = case.positions.iter().map(wave).collect();
    let colours: Vec<DVec3> = radiosity.iter().map(|&b| DVec3::splat(b)).collect();
    let exact: Vec<f64> = direct
        .apply(&colours)
        .unwrap()
        .iter()
        .map(|h| h.x)
        .collect();
    let all = vec![true; exact.len()];
    let off = converges("cornell", &case, &radiosity, &exact, &all);
    assert!(off.error < 0.012 && off.bias.abs() < 0.0025);
}

/// Part of a plate by which its cells stick out, at most: 0.11% by their areas, the rest by their scale
/// as occluders, which is what rays meet. (Measured biases: 0.23% and 0.10%, which more rays do not
/// change; of their mean the noise is 0.01%.)
const STICKS_OUT: f64 = 0.0026;

/// Fresh rays from the dark plate to the shining one.
fn plates(name: &str, place: impl Fn(DVec3) -> DVec2, truth: impl Fn(DVec2) -> f64) {
    let case = Case::new(&scene(name, 6000));
    let surfels = &case.surfels;
    let emission: Vec<f64> = surfels.emission.iter().map(|e| e.x.into()).collect();
    let keep: Vec<bool> = emission.iter().map(|&e| e == 0.0).collect();
    let truth: Vec<f64> = case.positions.iter().map(|&p| truth(place(p))).collect();
    let off = converges(name, &case, &emission, &truth, &keep);
    let some: Vec<usize> = (0..keep.len()).filter(|&i| keep[i]).step_by(10).collect();
    let colours: Vec<DVec3> = emission.iter().map(|&e| DVec3::splat(e)).collect();
    let exact = exact_irradiance(surfels, &NothingInTheWay, &some, &colours).unwrap();
    let exact: Vec<f64> = exact.iter().map(|(h, _)| h.x).collect();
    let exact = bias(&exact, &some.iter().map(|&i| truth[i]).collect::<Vec<_>>());
    println!("{name}: bias of exact sums {exact:+.5}");
    assert!(off.bias.abs() < STICKS_OUT.max(3.0 * off.mean_noise));
    assert!(off.error < 2.0 * off.noise, "{name}");
}

#[test]
fn parallel_plates() {
    plates("plates_parallel", |p| DVec2::new(p.x, p.z), parallel);
}

#[test]
fn perpendicular_plates() {
    plates(
        "plates_perpendicular",
        |p| DVec2::new(p.x, p.y),
        perpendicular,
    );
}

/// Rays meet cells where sums take points: close pairs, taken as sums take them, bring the limit of many
/// rays nearer to exact sums, and no more light than there is. (Measured: organic 0.85% without, 0.52% with
/// them; cave 7.2% and 3.9%.)
#[test]
fn close_pairs_bring_rays_to_exact_sums() {
    for (name, points) in [("organic", 8000), ("cave", 3000)] {
        let case = Case::new(&scene(name, points));
        let surfels = &case.surfels;
        let visibility = CpuVisibility::<f32>::new(&case.occluders);
        let radiosity: Vec<f64> = (surfels.positions.iter())
            .map(|p| f64::from(1.0 + (3.0 * p.x).sin() * p.z.cos()))
            .collect();
        let sent: Vec<DVec3> = radiosity.iter().map(|&b| DVec3::splat(b)).collect();
        let rows: Vec<usize> = (0..surfels.len()).step_by(points / 1000).collect();
        let exact = exact_irradiance(surfels, &visibility, &rows, &sent).unwrap();
        let exact: Vec<f64> = exact.iter().map(|(h, _)| h.x).collect();
        let close = Close::find(surfels, 3.0, &visibility, &Silent).unwrap();
        let [without, with] = [Close::none(surfels), close].map(|close| {
            let rays = links::gather::<f32>(surfels, &case.occluders, &close, 0..1024, 1, &Silent);
            let all = close.and(&rays.unwrap(), &Silent).unwrap();
            let sums = apply(&all, &vec![1.0; surfels.len()]);
            assert!(sums.iter().sum::<f64>() < (1.0 + 1e-6) * sums.len() as f64);
            let found = apply(&all, &radiosity);
            relative_l2(&rows.iter().map(|&i| found[i]).collect::<Vec<_>>(), &exact)
        });
        println!("{name}: 1024 rays are off by {without:.4}, with close pairs by {with:.4}");
        assert!(with < 0.75 * without);
    }
}

/// 4096 rays from each of 300 surfels of 20,000 against path tracing of the true surface: what their
/// mean is off by, and the noise of that.
fn against_path_tracing(name: &str) -> (f64, f64) {
    let scene = scene(name, 20_000);
    let lit = |options: Options| {
        let options = Options {
            tolerance: Some(0.003),
            ..options
        };
        illuminate(&scene, &options, Backend::Cpu, &Silent)
            .unwrap()
            .map
    };
    let method = Method::Gather;
    let known = lit(Options {
        method,
        rays: Some(256),
        ..Options::default()
    });
    let lights = lit(Options {
        method,
        max_bounces: Some(0),
        ..Options::default()
    });
    let case = Case::new(&scene);
    let surfels = &case.surfels;
    let point = |i: usize| surfels.points[i] as usize;
    let chosen: Vec<usize> = (0..surfels.len()).step_by(surfels.len() / 300).collect();
    let receivers: Vec<Receiver> = chosen
        .iter()
        .map(|&i| Receiver {
            place: case.positions[i],
            normal: surfels.normals[i].as_dvec3(),
        })
        .collect();
    let traced = Room::load(name).irradiance(&receivers, Bounces::All, 4096);
    let truth: Vec<f64> = traced.iter().map(|e| e.irradiance.x).collect();
    // Two halves of 32² strata each.
    let reach = surfels.reach();
    let half = |i: usize, seed: u64| {
        let mut random = random(2 * i as u64 + seed);
        let light = (0..1024 * 2).filter_map(|k| {
            let [u, v] = [k / 32 % 32, k % 32].map(|s| (s as f32 + random.random::<f32>()) / 32.0);
            let (a, b) = surfels.normals[i].any_orthonormal_pair();
            let (sin, cos) = (std::f32::consts::TAU * v).sin_cos();
            let aside = u.sqrt() * (cos * a + sin * b);
            let way = aside + (1.0 - u).sqrt() * surfels.normals[i];
            let hit = first_hit::<f32>(&case.occluders, &surfels.ray(i, way * reach))?;
            let from = hit.surfel as usize;
            let reflected = surfels.reflectance[from].x * known.irradiance[point(from)].x;
            hit.front.then_some(f64::from(reflected))
        });
        f64::from(lights.irradiance[point(i)].x) + light.sum::<f64>() / 2048.0
    };
    let [a, b] = [0, 1].map(|seed| chosen.iter().map(|&i| half(i, seed)).collect::<Vec<f64>>());
    let found: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
    let own: f64 = traced.iter().map(|e| e.error.x.powi(2)).sum();
    let own = own.sqrt() / truth.iter().sum::<f64>();
    let noise = mean_noise(&a, &b).hypot(own);
    let off = bias(&found, &truth);
    println!(
        "{name}: bias {off:+.5}, noise of that {noise:.5}, relative L2 {:.4}",
        relative_l2(&found, &truth)
    );
    (off, noise)
}

/// (Measured: -0.03%, noise 0.06%. With 3,000 points -0.27%, as exact sums over the same cells have.)
#[test]
fn cornell_against_path_tracing() {
    let (off, noise) = against_path_tracing("cornell");
    assert!(off.abs() < 3.0 * noise);
}

/// (Measured: -0.18%, noise 0.08%.)
#[test]
fn organic_against_path_tracing() {
    let (off, noise) = against_path_tracing("organic");
    assert!(off.abs() < 3.0 * noise);
}

/// A ray brings light from one surfel at most, and all rays weigh the same. In a closed room all of
/// them should bring some; between cells that are no mesh, some slip into bodies and meet their backs
/// from inside. (Measured: 0.987; without a rim 0.957.)
#[test]
fn rows_sum_up_to_one_at_most() {
    let case = Case::new(&scene("organic", 2000));
    let sums = apply(&case.rays(0..256, 1), &vec![1.0; case.surfels.len()]);
    assert!(sums.iter().all(|&sum| sum <= 1.0));
    let whole = sums.iter().filter(|&&sum| sum == 1.0).count();
    let mean = sums.iter().sum::<f64>() / sums.len() as f64;
    println!("row sum {mean:.4}, {whole} of {} are 1", sums.len());
    assert!(mean > 0.98);
}

#[test]
fn twice_the_rays_are_the_mean_of_both_halves() {
    let case = Case::new(&scene("organic", 1000));
    let halves = [0..64, 64..128].map(|numbers| case.rays(numbers, 3));
    let mean = links::mean(&halves[0], &halves[1], &Silent).unwrap();
    assert_eq!(mean, case.rays(0..128, 3));
    assert_ne!(mean, case.rays(0..128, 4));
}

/// Asks to stop after the first block.
#[derive(Default)]
struct Impatient(AtomicU64);

impl Progress for Impatient {
    fn advance(&self, n: u64) {
        self.0.fetch_add(n, Ordering::Relaxed);
    }

    fn cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed) > 0
    }
}

#[test]
fn many_rays_are_given_up_soon() {
    let case = Case::new(&scene("furnace", 500));
    let waiting = Impatient::default();
    let close = Close::none(&case.surfels);
    let many = 0..1 << 14;
    let rows = links::gather::<f32>(&case.surfels, &case.occluders, &close, many, 1, &waiting);
    assert!(matches!(rows, Err(Error::Interrupted)));
    assert!(waiting.0.load(Ordering::Relaxed) <= 64);
}
