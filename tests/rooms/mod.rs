//! Rooms of rectangles: points on them, and the exact answers that the points are measured against.
#![allow(dead_code)]

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::visibility::{CpuVisibility, Occluders, Visibility, face};
use fmmgi_gpu::{Backend, Method, Occlusion, Options, PointCloud, Scene, Surfels, illuminate};
use glam::{DVec3, Vec3};
use rand::RngExt;

use crate::clouds::{cloud, random};

/// A parallelogram with right angles, seen from the side that u × v points to.
#[derive(Clone, Copy, Debug)]
pub struct Rect {
    pub corner: DVec3,
    pub u: DVec3,
    pub v: DVec3,
    pub emission: f64,
    pub reflectance: f64,
}

/// How points lie on a rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sampling {
    /// On a lattice.
    Grid,
    /// One in the middle half of each stratum, as the sampler of scenes places them.
    Strata,
    /// Anywhere.
    Random,
}

pub const SAMPLINGS: [Sampling; 3] = [Sampling::Grid, Sampling::Strata, Sampling::Random];

/// A grey rectangle that does not shine.
pub fn rect(corner: DVec3, u: DVec3, v: DVec3) -> Rect {
    Rect {
        corner,
        u,
        v,
        emission: 0.0,
        reflectance: 0.5,
    }
}

impl Rect {
    pub fn normal(&self) -> DVec3 {
        self.u.cross(self.v).normalize()
    }

    pub fn area(&self) -> f64 {
        self.u.cross(self.v).length()
    }

    pub fn at(&self, s: f64, t: f64) -> DVec3 {
        self.corner + self.u * s + self.v * t
    }

    /// Whether the open segment crosses the rectangle.
    pub fn blocks(&self, from: DVec3, to: DVec3) -> bool {
        let n = self.normal();
        let (a, b) = ((from - self.corner).dot(n), (to - self.corner).dot(n));
        let slack = 1e-9 * (self.u.length() + self.v.length());
        if a.abs() < slack || b.abs() < slack || (a > 0.0) == (b > 0.0) {
            return false;
        }
        let p = (from * b - to * a) / (b - a) - self.corner;
        let inside = |edge: DVec3| (0.0..=1.0).contains(&(p.dot(edge) / edge.length_squared()));
        inside(self.u) && inside(self.v)
    }

    /// Form factor to it from an element that looks along `normal`, nothing in the way: Lambert's
    /// formula over the edges of the part above the horizon.
    pub fn form_factor(&self, place: DVec3, normal: DVec3) -> f64 {
        let around = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let corners = around.map(|(s, t)| self.at(s, t) - place);
        if self.normal().dot(corners[0]) >= 0.0 {
            return 0.0;
        }
        let mut above: Vec<DVec3> = Vec::new();
        for k in 0..4 {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            let (ha, hb) = (normal.dot(a), normal.dot(b));
            if ha >= 0.0 {
                above.push(a);
            }
            if (ha >= 0.0) != (hb >= 0.0) {
                above.push(a.lerp(b, ha / (ha - hb)));
            }
        }
        let sum: f64 = (0..above.len())
            .map(|k| {
                let (a, b) = (above[k], above[(k + 1) % above.len()]);
                let across = b.cross(a);
                match across.length() > 0.0 {
                    true => a.angle_between(b) * normal.dot(across.normalize()),
                    false => 0.0,
                }
            })
            .sum();
        (sum / std::f64::consts::TAU).max(0.0)
    }
}

/// The walls of a box that is seen from inside (its faces: x = 0, x = 1, y = 0, ...).
pub fn inside_of(low: DVec3, size: DVec3) -> [Rect; 6] {
    let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|e| e * size);
    [
        rect(low, y, z),
        rect(low + x, z, y),
        rect(low, z, x),
        rect(low + y, x, z),
        rect(low, x, y),
        rect(low + z, y, x),
    ]
}

/// The same walls seen from outside.
pub fn outside_of(low: DVec3, size: DVec3) -> [Rect; 6] {
    inside_of(low, size).map(|r| Rect {
        u: r.v,
        v: r.u,
        ..r
    })
}

/// A rectangle without its part from `low` to `high` (shares of u and v), in up to four pieces.
pub fn with_hole(r: Rect, low: [f64; 2], high: [f64; 2]) -> Vec<Rect> {
    let part = |u: [f64; 2], v: [f64; 2]| Rect {
        corner: r.at(u[0], v[0]),
        u: r.u * (u[1] - u[0]),
        v: r.v * (v[1] - v[0]),
        ..r
    };
    let parts = [
        part([0.0, low[0]], [0.0, 1.0]),
        part([high[0], 1.0], [0.0, 1.0]),
        part([low[0], high[0]], [0.0, low[1]]),
        part([low[0], high[0]], [high[1], 1.0]),
    ];
    parts.into_iter().filter(|p| p.area() > 0.0).collect()
}

/// Points at a mean distance of `spacing`; with their areas, unless they lie anywhere.
pub fn points(rects: &[Rect], spacing: f64, sampling: Sampling, seed: u64) -> PointCloud {
    let mut all = PointCloud::default();
    let mut rng = random(seed);
    for r in rects {
        let [nu, nv] = [r.u, r.v].map(|e| (e.length() / spacing).round().max(1.0) as usize);
        let mut at = |k: usize, n: usize| {
            let jitter = rng.random::<f64>() - 0.5;
            match sampling {
                Sampling::Grid => (k as f64 + 0.5) / n as f64,
                Sampling::Strata => (k as f64 + 0.5 + 0.5 * jitter) / n as f64,
                Sampling::Random => jitter + 0.5,
            }
        };
        let places = (0..nu * nv).map(|k| r.at(at(k / nv, nu), at(k % nv, nv)));
        let part = cloud(places.map(|p| (p, r.normal())));
        let n = part.len();
        all.positions.extend(part.positions);
        all.normals.extend(part.normals);
        if sampling != Sampling::Random {
            all.areas.extend(vec![(r.area() / n as f64) as f32; n]);
        }
        all.reflectance
            .extend(vec![Vec3::splat(r.reflectance as f32); n]);
        all.emission.extend(vec![Vec3::splat(r.emission as f32); n]);
    }
    all
}

/// Irradiance at every point, on the CPU.
pub fn light(cloud: &PointCloud, method: Method, tolerance: f64) -> Vec<f64> {
    let scene = Scene {
        cloud: cloud.clone(),
        ..Scene::default()
    };
    let options = Options {
        method,
        occlusion: Occlusion::Surfels,
        tolerance: Some(tolerance),
        ..Options::default()
    };
    let result = illuminate(&scene, &options, Backend::Cpu, &Silent).expect("a solution");
    assert!(result.stats.converged);
    result
        .map
        .irradiance
        .iter()
        .map(|h| f64::from(h.x))
        .collect()
}

/// Shares of random pairs of surfels that face each other and that `pair` accepts: blocked although
/// `truth` sees them (false occlusion, of what truth sees), and seen although `truth` does not (leak,
/// of what truth blocks).
pub fn misjudged(
    surfels: &Surfels,
    pair: impl Fn(usize, usize) -> bool,
    truth: impl Fn(DVec3, DVec3) -> bool,
) -> [f64; 2] {
    const PAIRS: usize = 100_000;
    let mut rng = random(1);
    let n = surfels.len();
    let pairs: Vec<(usize, usize)> = std::iter::repeat_with(|| {
        let [i, j] = [(); 2].map(|()| rng.random_range(0..n));
        (i, j)
    })
    .filter(|&(i, j)| face(surfels, i, j) && pair(i, j))
    .take(PAIRS)
    .collect();
    let segments: Vec<_> = pairs.iter().map(|&(i, j)| surfels.segment(i, j)).collect();
    let occluders = Occluders::build(surfels);
    let seen = CpuVisibility::<f32>::new(&occluders)
        .visible(&segments)
        .expect("answers");
    let (mut visible, mut occluded, mut hidden, mut leaked) = (0, 0, 0, 0);
    for (&(i, j), seen) in pairs.iter().zip(seen) {
        let at = |i: usize| surfels.positions[i].as_dvec3() + surfels.origin;
        if truth(at(i), at(j)) {
            visible += 1;
            occluded += usize::from(!seen);
        } else {
            hidden += 1;
            leaked += usize::from(seen);
        }
    }
    let share = |part: usize, all: usize| part as f64 / all.max(1) as f64;
    [share(occluded, visible), share(leaked, hidden)]
}

/// |found - true| / |true| in the L2 norm, and the difference of the sums.
pub fn errors(pairs: impl IntoIterator<Item = (f64, f64)>) -> [f64; 2] {
    let (mut e, mut n, mut found, mut truth) = (0.0, 0.0, 0.0, 0.0);
    for (a, b) in pairs {
        e += (a - b) * (a - b);
        n += b * b;
        found += a;
        truth += b;
    }
    [(e / n).sqrt(), found / truth - 1.0]
}
