//! Is the tolerance kept, and is the error that a solve states true? For scenes of some sizes and for
//! scans: what was asked for, what the solve measured itself (with its 95% bounds), and what exact sums
//! at 500 surfels say of the same solution; up to 5,000 points also how far the solution is from the
//! dense one after all bounces. Each for the whole irradiance and for the reflected part of
//! it, which under a sky may be further off than was asked for: the tolerance is that of both together.
//!
//! ```sh
//! cargo run --release --example tolerance                     # 2,000, 20,000 and 200,000 points
//! cargo run --release --example tolerance -- 2000 20000       # only these sizes
//! cargo run --release --example tolerance -- links 20000      # by links, where auto may take rays
//! cargo run --release --example tolerance -- cave.ply@0,0,2 lion.ply@sky,3,4,5
//! ```
//!
//! A scan is lit by point lights (`@X,Y,Z`), and with `@sky` by the sky. The way of each row is the one
//! that `auto` took.

use std::path::{Path, PathBuf};

use fmmgi_gpu::chart::truth::PointTruth;
use fmmgi_gpu::glam::{DVec3, Vec3};
use fmmgi_gpu::illuminate::Interval;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::{Backend, Illumination, Method, Options, Result, Scene, illuminate};

const SCENES: [&str; 4] = ["cornell", "two_rooms", "organic", "cave"];
const SIZES: [usize; 3] = [2000, 20_000, 200_000];
const TOLERANCES: [f64; 3] = [0.1, 0.03, 0.01];
/// A further tolerance for clouds up to a size.
const FINE: (f64, usize) = (0.003, 20_000);
/// Surfels whose light is summed up exactly.
const RECEIVERS: usize = 500;
/// Largest cloud that is compared with the dense solution.
const DENSE: usize = 5000;

fn main() -> Result<()> {
    let (sizes, others): (Vec<String>, Vec<String>) = std::env::args()
        .skip(1)
        .partition(|a| a.parse::<usize>().is_ok());
    let mut sizes: Vec<usize> = sizes.iter().filter_map(|a| a.parse().ok()).collect();
    let (tolerances, others): (Vec<String>, Vec<String>) =
        others.into_iter().partition(|a| a.parse::<f64>().is_ok());
    let (links, others): (Vec<String>, Vec<String>) =
        others.into_iter().partition(|a| a == "links");
    let method = if links.is_empty() {
        Method::Auto
    } else {
        Method::Fmm
    };
    let (scenes, scans): (Vec<String>, Vec<String>) = others
        .into_iter()
        .partition(|a| SCENES.contains(&a.as_str()));
    let mut tolerances: Vec<f64> = tolerances.iter().filter_map(|a| a.parse().ok()).collect();
    if tolerances.is_empty() {
        tolerances = TOLERANCES.into();
        tolerances.push(FINE.0);
    }
    if sizes.is_empty() && scans.is_empty() {
        sizes = SIZES.into();
    }
    println!(
        "| scene | points | asked | way | met | measured, in all | exact | measured, reflected | exact | \
         dense: in all, reflected | segments a point | seconds | verified in | model |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|---|---|");
    for &points in &sizes {
        for name in SCENES {
            if !scenes.is_empty() && !scenes.iter().any(|s| s == name) {
                continue;
            }
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
            let options = SceneOptions {
                points: Some(points),
                seed: 1,
                ..SceneOptions::default()
            };
            rows(
                name,
                &Scene::load(&path, &options, &Silent)?,
                method,
                &tolerances,
            )?;
        }
    }
    for scan in &scans {
        let mut parts = scan.split('@');
        let path = PathBuf::from(parts.next().unwrap_or_default());
        let mut scene = Scene::load(&path, &SceneOptions::default(), &Silent)?;
        for light in parts {
            let place: Vec<f64> = light.split(',').filter_map(|x| x.parse().ok()).collect();
            match place[..] {
                [x, y, z] => scene.lights.push(PointLight {
                    position: DVec3::new(x, y, z),
                    intensity: Vec3::ONE,
                }),
                _ => scene.sky = Vec3::ONE,
            }
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        rows(&name, &scene, method, &tolerances)?;
    }
    Ok(())
}

/// A row for each tolerance.
fn rows(name: &str, scene: &Scene, method: Method, tolerances: &[f64]) -> Result<()> {
    let dense = match scene.cloud.len() <= DENSE {
        true => Some(Dense::solve(scene)?),
        false => None,
    };
    let truth = PointTruth::find(scene, RECEIVERS, &Silent)?;
    for &tolerance in tolerances {
        if tolerance <= FINE.0 && scene.cloud.len() > FINE.1 {
            continue;
        }
        let options = Options {
            method,
            tolerance: Some(tolerance),
            below_model: true,
            seed: 1,
            ..Options::default()
        };
        let clock = std::time::Instant::now();
        let lit = illuminate(scene, &options, Backend::Cpu, &Silent)?;
        let seconds = clock.elapsed().as_secs_f64();
        // They have no error that could be measured, and do not tell the reflected part.
        let exact = lit.stats.method == Method::Direct;
        let [total, reflected] = against_exact_sums(&truth, &lit).map(percent);
        let dense = dense.as_ref().map_or("".into(), |dense| {
            let [total, reflected] = dense.against(&lit).map(percent);
            match exact {
                true => total,
                false => format!("{total}, {reflected}"),
            }
        });
        let error = lit.stats.error.unwrap_or_default();
        let told = |error: Interval| {
            let [value, low, high] = [error.value, error.low, error.high].map(|x| 100.0 * x);
            format!("{value:.2}% ({low:.2} to {high:.2})")
        };
        let way = match (lit.stats.method, lit.stats.rays) {
            (Method::Gather, Some(rays)) => format!("rays, {rays}"),
            (Method::Direct, _) => "exact sums".into(),
            _ => "links".into(),
        };
        println!(
            "| {name} | {} | {} | {way} | {} | {} | {} | {} | {} | {dense} | {} | {seconds:.1} | {:.0}% | {} |",
            lit.stats.points,
            percent(tolerance),
            if error.met || exact { "yes" } else { "no" },
            told(error.total.rel_l2),
            total,
            error.reflected.map_or("".into(), |r| told(r.rel_l2)),
            if exact { "".into() } else { reflected },
            lit.stats.segments / lit.stats.surfels as u64,
            100.0 * lit.stats.seconds.verification / seconds,
            lit.stats.model_error.map_or("".into(), percent),
        );
    }
    Ok(())
}

fn percent(x: f64) -> String {
    format!("{:.2}%", 100.0 * x)
}

/// Relative L2 errors of all irradiance and of the reflected part: one application of the exact
/// operator to the solution.
fn against_exact_sums(truth: &PointTruth, lit: &Illumination) -> [f64; 2] {
    let exact = truth.of(&lit.map.irradiance);
    let mut direct = vec![DVec3::ZERO; lit.map.irradiance.len()];
    for (&point, h) in lit.surfels.points.iter().zip(&lit.direct) {
        direct[point as usize] = *h;
    }
    let [mut errors, mut norms] = [[0.0; 2]; 2];
    for (k, point) in truth.points().enumerate() {
        let truth = [exact.all[k], exact.reflected[k]];
        let whole = lit.map.irradiance[point].as_dvec3();
        let found = [whole, whole - direct[point]];
        for part in 0..2 {
            errors[part] += (found[part] - truth[part]).length_squared();
            norms[part] += truth[part].length_squared();
        }
    }
    [0, 1].map(|part| (errors[part] / norms[part]).sqrt())
}

/// The solution by exact sums: of each point the irradiance and the reflected part of it.
struct Dense([Vec<DVec3>; 2]);

impl Dense {
    fn solve(scene: &Scene) -> Result<Dense> {
        let solve = |max_bounces| {
            let options = Options {
                method: Method::Direct,
                tolerance: Some(1e-3),
                max_bounces,
                seed: 2,
                ..Options::default()
            };
            let lit = illuminate(scene, &options, Backend::Cpu, &Silent)?;
            Ok::<Vec<DVec3>, fmmgi_gpu::Error>(
                lit.map.irradiance.iter().map(|h| h.as_dvec3()).collect(),
            )
        };
        let (whole, direct) = (solve(None)?, solve(Some(0))?);
        let reflected = whole.iter().zip(direct).map(|(h, d)| *h - d).collect();
        Ok(Dense([whole, reflected]))
    }

    /// Relative L2 errors of a solution.
    fn against(&self, lit: &Illumination) -> [f64; 2] {
        let [mut errors, mut norms] = [[0.0; 2]; 2];
        for (i, &point) in lit.surfels.points.iter().enumerate() {
            let p = point as usize;
            let whole = lit.map.irradiance[p].as_dvec3();
            let direct = lit.direct.get(i).copied().unwrap_or_default();
            let found = [whole, whole - direct];
            for part in 0..2 {
                errors[part] += (found[part] - self.0[part][p]).length_squared();
                norms[part] += self.0[part][p].length_squared();
            }
        }
        [0, 1].map(|part| (errors[part] / norms[part]).sqrt())
    }
}
