//! Curved walls seen from inside: cells are flat, the wall is not, and still may not hide what is
//! seen.

mod clouds;
mod rooms;

use std::f64::consts::TAU;

use clouds::{cloud, direction, noisy, random, sphere};
use fmmgi_gpu::PointCloud;
use glam::{DVec2, DVec3};
use rand::RngExt;
use rooms::*;

/// Radius of the ring that the tunnel follows; its own is 1.
const RING: f64 = 4.0;
/// Length of the straight tunnel, of radius 1 too.
const LENGTH: f64 = 10.0;

/// A place on the tunnel's wall at the angle `along` the ring and `around` the tunnel, with the
/// normal that points inwards.
fn on_tunnel(along: f64, around: f64) -> (DVec3, DVec3) {
    let outwards = DVec2::from_angle(along).extend(0.0);
    let n = outwards * around.cos() + DVec3::Z * around.sin();
    (outwards * RING + n, -n)
}

/// About `n` points on the tunnel.
fn tunnel(n: usize, sampling: Sampling) -> PointCloud {
    let mut rng = random(3);
    let spacing = (TAU * TAU * RING / n as f64).sqrt();
    let rows = (TAU / spacing).round();
    let mut places = Vec::new();
    for row in 0..rows as usize {
        let width = TAU * (RING + (TAU * (row as f64 + 0.5) / rows).cos());
        let count = (width / spacing).round();
        for k in 0..count as usize {
            let [s, t]: [f64; 2] = std::array::from_fn(|_| rng.random::<f64>() - 0.5);
            let [s, t] = match sampling {
                Sampling::Grid => [0.0; 2],
                Sampling::Strata => [0.5 * s, 0.5 * t],
                Sampling::Random => [s * count, t],
            };
            let at = |k: usize, shift: f64, n: f64| TAU * (k as f64 + 0.5 + shift) / n;
            places.push(on_tunnel(at(k, s, count), at(row, t, rows)));
        }
    }
    cloud(places)
}

/// Whether the segment between two places on the wall, or beside it, stays in the tunnel.
fn in_tunnel(from: DVec3, to: DVec3) -> bool {
    const STEPS: usize = 200;
    let onto = |p: DVec3| {
        let centre = p.truncate().normalize().extend(0.0) * RING;
        centre + (p - centre).normalize()
    };
    let (from, to) = (onto(from), onto(to));
    (1..STEPS).all(|k| {
        let p = from.lerp(to, k as f64 / STEPS as f64);
        (p.truncate().length() - RING).powi(2) + p.z * p.z <= 1.0 + 1e-9
    })
}

fn in_sphere(n: usize, sampling: Sampling) -> PointCloud {
    match sampling {
        Sampling::Grid => sphere(n, 0.0, true, 1),
        Sampling::Strata => sphere(n, 0.5, true, 1),
        Sampling::Random => {
            let mut rng = random(1);
            cloud((0..n).map(|_| direction(&mut rng)).map(|d| (d, -d)))
        }
    }
}

/// The straight tunnel along z.
fn in_cylinder(n: usize, sampling: Sampling) -> PointCloud {
    let rect = rect(DVec3::ZERO, DVec3::Y * LENGTH, DVec3::X * TAU);
    let spacing = (TAU * LENGTH / n as f64).sqrt();
    let flat = points(&[rect], spacing, sampling, 1);
    cloud(flat.positions.iter().map(|p| {
        let n = DVec2::from_angle(p.x).extend(0.0);
        (n + DVec3::Z * p.y, -n)
    }))
}

// Measured without noise: 0 in the sphere and the straight tunnel (their walls bend away from all that
// is inside); 5e-5, 6e-5, 3.3e-4 in the winding one (grid, strata, random), where cells on the inner
// side of the bend stand out. With noise of 2 and 5 degrees: 7e-4 and 1.9e-3 of grids and strata,
// 1.4e-3 and 3.8e-3 of random points; with normals as they are 1.4e-3, 5e-3, 1.9e-3 and 2.4e-2.
#[test]
fn nothing_is_hidden_in_a_smooth_hollow() {
    let n = 4000;
    for sampling in SAMPLINGS {
        let even = sampling != Sampling::Random;
        for (name, cloud, area, winds) in [
            ("sphere", in_sphere(n, sampling), 2.0 * TAU, false),
            (
                "straight tunnel",
                in_cylinder(n, sampling),
                LENGTH * TAU,
                false,
            ),
            (
                "winding tunnel",
                tunnel(2 * n, sampling),
                RING * TAU * TAU,
                true,
            ),
        ] {
            let spacing = (area / cloud.len() as f64).sqrt();
            for (degrees, shift, most) in [
                (0.0_f64, 0.0, 1e-3),
                (2.0, 0.02, if even { 1.5e-3 } else { 3e-3 }),
                (5.0, 0.05, if even { 3e-3 } else { 6e-3 }),
            ] {
                let cloud = noisy(&cloud, degrees.to_radians(), shift * spacing, 4);
                let surfels = clouds::surfels(&cloud);
                let truth = |a, b| !winds || in_tunnel(a, b);
                let [occluded, leaked] = misjudged(&surfels, |_, _| true, truth);
                println!(
                    "{name}, {sampling:?}, {degrees} degrees, {shift} spacings of noise: false \
                     occlusion {occluded:.1e}, leak {leaked:.1e}"
                );
                assert!(occluded < most && leaked < 0.05);
            }
        }
    }
}
