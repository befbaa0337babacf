//! A cloud of any size, made in no time.

use std::f32::consts::TAU;

use fmmgi_gpu::Surfels;
use glam::{Vec2, Vec3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Points anywhere on the walls of the unit box, seen from inside, and on a ball in its middle.
pub fn with_ball(n: usize) -> Surfels {
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
