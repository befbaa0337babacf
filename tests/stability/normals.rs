//! Normals that are flipped, tilted, at random or of odd length, and points beside their surface.

use std::f64::consts::TAU;

use fmmgi_gpu::PointCloud;
use glam::DVec3;
use rand::{Rng, RngExt};
use rand_pcg::Pcg64Mcg;

use crate::clouds::{direction, noisy, random};
use crate::harness::*;
use crate::scenes::{K, lit_room};

/// The room with other normals.
fn turned(mut turn: impl FnMut(DVec3, DVec3, &mut Pcg64Mcg) -> DVec3) -> PointCloud {
    let mut rng = random(9);
    let mut room = lit_room();
    for (p, n) in room.positions.iter().zip(&mut room.normals) {
        *n = turn(*p, n.as_dvec3(), &mut rng).as_vec3();
    }
    room
}

fn tilted(normal: DVec3, degrees: f64, rng: &mut impl Rng) -> DVec3 {
    let a = normal.any_orthonormal_vector();
    let around = rng.random_range(0.0..TAU);
    let aside = a * around.cos() + normal.cross(a) * around.sin();
    normal * degrees.to_radians().cos() + aside * degrees.to_radians().sin()
}

const CLASSIC: &str = "Cells of such normals stand across the surface. `classic` sees past points and not past \
    cells, and so other things; `gather` finds what a ray meets first, and that may be the back of a cell. \
    Neither is the exact sum over these cells, which `fmm` keeps to.";

const FLIPPED: &str = "Every other ray meets a back, where light ends, and `gather` says that it loses what sums \
    find between the fronts. Leave the normals out, so that they are estimated.";

/// Normals that make no surface.
fn hostile(name: String, room: PointCloud) -> Case {
    let case = Case::new(name, room, Truth::Sums).but(Way::Classic, Wrong(0.1));
    case.but(Way::Gather, Within(0.4)).remedy(CLASSIC)
}

pub fn normals() -> Vec<Case> {
    let mut cases = vec![
        Case::new(
            "every other normal flipped",
            turned(|_, n, rng| if rng.random() { n } else { -n }),
            Truth::Sums,
        )
        .but(Way::Gather, NotMet)
        .remedy(FLIPPED),
        Case::new(
            "the normals of one half flipped",
            turned(|p, n, _| if p.x > 0.5 { -n } else { n }),
            Truth::Sums,
        ),
        Case::new(
            "1% of the normals flipped",
            turned(|_, n, rng| if rng.random::<f64>() < 0.01 { -n } else { n }),
            Truth::Sums,
        ),
        Case::new(
            "normals at random",
            turned(|_, _, rng| direction(rng)),
            Truth::Sums,
        )
        .but(Way::Gather, NotMet)
        .but(Way::Classic, Within(0.2))
        .remedy(CLASSIC),
    ];
    for degrees in [60.0, 85.0, 89.9, 91.0] {
        let room = turned(|_, n, rng| tilted(n, degrees, rng));
        cases.push(hostile(
            format!("normals tilted by {degrees} degrees"),
            room,
        ));
    }
    let clean = sums(&lit_room());
    let mut short = lit_room();
    short.normals.iter_mut().for_each(|n| *n *= 1e-30);
    short.normals[4] *= 1e38;
    cases.push(Case::new(
        "normals of length 1e-30",
        short,
        Truth::Known(clean),
    ));
    let none = turned(|_, _, _| DVec3::NAN);
    cases.push(Case::new("normals that are no numbers", none, Truth::Sums));
    cases
}

/// Points beside their surface, against the light of the clean room and against exact sums over the
/// same points.
pub fn noise() -> Vec<Case> {
    let room = lit_room();
    let clean = sums(&room);
    let mut cases = Vec::new();
    for (noise, off) in [(0.3, 0.03), (1.0, 0.35)] {
        let noisy = noisy(&room, 0.0, noise / K as f64, 3);
        let name = format!("noise of {noise} spacings");
        let points = Case::new(&*name, noisy.clone(), Truth::Sums).but(Way::Gather, Within(0.08));
        cases.push(points.but(Way::Classic, Within(0.25)));
        let name = format!("{name}, against the clean room");
        let truth = Truth::Known(clean.clone());
        cases.push(
            Case::new(name, noisy, truth)
                .expect(Within(off))
                .remedy(NOISE),
        );
    }
    cases
}

const NOISE: &str = "Noise of a spacing makes shadows and takes 16% of the light. Thin such scans to a spacing \
    above their noise (`--spacing`).";
