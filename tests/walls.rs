//! Walls as thin as the points are apart, and doors in them: does light stay out where it must, and
//! get through where it may? Lengths are in spacings.

mod clouds;
mod rooms;

use clouds::{joined, moved, noisy, rotation};
use fmmgi_gpu::{Method, PointCloud, Surfels};
use glam::{DQuat, DVec3};
use rooms::*;

/// Edge of a room.
const ROOM: f64 = 20.0;

/// Two rooms behind each other along x, with a wall of `thickness` between them.
fn two_rooms(thickness: f64) -> [[Rect; 6]; 2] {
    let size = DVec3::splat(ROOM);
    [
        inside_of(DVec3::ZERO, size),
        inside_of(DVec3::X * (ROOM + thickness), size),
    ]
}

/// The points of both rooms, those of the first one first, and their number.
fn sampled(rooms: &[[Rect; 6]; 2], sampling: Sampling, seed: u64) -> (PointCloud, usize) {
    let [first, second] = [0, 1].map(|k| points(&rooms[k], 1.0, sampling, seed + k as u64));
    let lit = first.len();
    (joined([first, second]), lit)
}

/// Share of the segments from room to room that get through.
fn leak(cloud: &PointCloud, lit: usize) -> f64 {
    let surfels: Surfels = clouds::surfels(cloud);
    let apart = |i: usize, j: usize| {
        let first = |k: usize| (surfels.points[k] as usize) < lit;
        first(i) != first(j)
    };
    misjudged(&surfels, 200_000, apart, |_, _| false)[1]
}

#[test]
fn thin_walls_keep_light_out() {
    for (thickness, most) in [(5.0, 1e-3), (2.0, 3e-3), (1.0, 1e-2)] {
        let rooms = two_rooms(thickness);
        for sampling in SAMPLINGS {
            for (way, turn) in [("along the axes", DQuat::IDENTITY), ("tilted", rotation(3))] {
                let (cloud, lit) = sampled(&rooms, sampling, 1);
                let mut cloud = moved(&cloud, turn, 1.0, DVec3::ZERO);
                cloud.emission[..lit].fill(glam::Vec3::ONE);
                let segments = leak(&cloud, lit);
                let light = light(&cloud, Method::Fmm, 0.01);
                let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
                let share = mean(&light[lit..]) / mean(&light[..lit]);
                println!(
                    "wall of {thickness}, {sampling:?}, {way}: {segments:.1e} of the segments, \
                     {share:.1e} of the light"
                );
                assert!(segments < most && share < most);
            }
        }
    }
}

#[test]
fn noisy_walls_keep_light_out() {
    for (degrees, shift) in [(2.0_f64, 0.02), (5.0, 0.05)] {
        for thickness in [5.0, 2.0, 1.0] {
            for sampling in SAMPLINGS {
                let (cloud, lit) = sampled(&two_rooms(thickness), sampling, 1);
                let mut cloud = noisy(&cloud, degrees.to_radians(), shift, 5);
                cloud.emission[..lit].fill(glam::Vec3::ONE);
                let light = light(&cloud, Method::Direct, 0.01);
                let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
                println!(
                    "noise {degrees} {shift}, wall of {thickness}, {sampling:?}: segments {:.1e}, light {:.1e}",
                    leak(&cloud, lit),
                    mean(&light[lit..]) / mean(&light[..lit])
                );
            }
        }
    }
}

/// The two rooms with a door of `width` in the wall between them, its frame between the two.
fn with_door(thickness: f64, width: f64) -> (Vec<Rect>, Vec<Rect>) {
    let [mut first, mut second] = two_rooms(thickness).map(Vec::from);
    // Away from the middle and from the lattice.
    let low = [0.23 * ROOM, 0.31 * ROOM];
    let high = low.map(|x| x + width);
    let share = |p: [f64; 2]| p.map(|x| x / ROOM);
    let swapped = |[y, z]: [f64; 2]| [z, y];
    let near = first.remove(1);
    first.extend(with_hole(near, swapped(share(low)), swapped(share(high))));
    let far = second.remove(0);
    second.extend(with_hole(far, share(low), share(high)));
    let frame = inside_of(
        DVec3::new(ROOM, low[0], low[1]),
        DVec3::new(thickness, width, width),
    );
    second.extend(&frame[2..]);
    (first, second)
}

/// Form factor from a place in the second room to what it sees of the first one's walls through
/// the door: the part of the far opening that lies behind the near one.
fn through_the_door(place: DVec3, normal: DVec3, thickness: f64, width: f64) -> f64 {
    let low = [0.23 * ROOM, 0.31 * ROOM];
    let opening = |x: f64| -> [[f64; 2]; 2] {
        // Seen in the plane of the second room's wall.
        let t = (place.x - ROOM - thickness) / (place.x - x);
        [0, 1].map(|k| {
            let p = [place.y, place.z][k];
            [low[k], low[k] + width].map(|q| p + (q - p) * t)
        })
    };
    let (near, far) = (opening(ROOM + thickness), opening(ROOM));
    let [y, z] = [0, 1].map(|k| [near[k][0].max(far[k][0]), near[k][1].min(far[k][1])]);
    if y[1] <= y[0] || z[1] <= z[0] {
        return 0.0;
    }
    rect(
        DVec3::new(ROOM + thickness, y[0], z[0]),
        DVec3::Y * (y[1] - y[0]),
        DVec3::Z * (z[1] - z[0]),
    )
    .form_factor(place, normal)
}

/// All walls of the first room shine with 1: the second room sees a door of radiosity 1.
#[test]
fn a_door_lets_through_what_it_should() {
    for (thickness, width) in [
        (5.0, 10.0),
        (2.0, 10.0),
        (1.0, 10.0),
        (1.0, 5.0),
        (1.0, 3.0),
    ] {
        for sampling in SAMPLINGS {
            let (mut bright, dark) = with_door(thickness, width);
            bright.iter_mut().for_each(|r| r.emission = 1.0);
            let (bright, mut dark) = (
                points(&bright, 1.0, sampling, 1),
                points(&dark, 1.0, sampling, 2),
            );
            dark.reflectance.fill(glam::Vec3::ZERO);
            let lit = bright.len();
            let mut cloud = joined([bright, dark]);
            cloud.reflectance.fill(glam::Vec3::ZERO);
            let inside = |k: usize| cloud.positions[k].x > ROOM + thickness;
            let truth: Vec<(usize, f64)> = (lit..cloud.len())
                .filter(|&k| inside(k))
                .map(|k| {
                    let (p, n) = (cloud.positions[k], cloud.normals[k].as_dvec3());
                    (k, through_the_door(p, n, thickness, width))
                })
                .collect();
            for method in [Method::Direct, Method::Fmm] {
                let light = light(&cloud, method, 0.01);
                let areas = |k: usize| cloud.areas.get(k).map_or(1.0, |&a| f64::from(a));
                let weighted = truth
                    .iter()
                    .map(|&(k, h)| (light[k] * areas(k), h * areas(k)));
                let [l2, bias] = errors(weighted);
                println!(
                    "door of {width} in a wall of {thickness}, {sampling:?}, {method:?}: rel L2 \
                     {l2:.4}, bias {bias:+.4}"
                );
                assert!(width < 10.0 || bias.abs() < 0.03);
            }
        }
    }
}

#[test]
fn debug_leaks() {
    use fmmgi_gpu::visibility::{CpuVisibility, Occluders, Segment, Visibility, face};
    use rand::RngExt;
    for sampling in SAMPLINGS {
        for (degrees, shift) in [(5.0_f64, 0.05), (5.0, 0.0), (0.0, 0.05)] {
            let (cloud, lit) = sampled(&two_rooms(5.0), sampling, 1);
            let cloud = noisy(&cloud, degrees.to_radians(), shift, 5);
            let s = clouds::surfels(&cloud);
            let mut rng = clouds::random(1);
            let n = s.len();
            let mut pairs: Vec<Segment> = Vec::new();
            while pairs.len() < 200_000 {
                let (i, j) = (rng.random_range(0..n), rng.random_range(0..n));
                if ((s.points[i] as usize) < lit) && (s.points[j] as usize) >= lit && face(&s, i, j)
                {
                    pairs.push(s.segment(i, j));
                }
            }
            let occluders = Occluders::build(&s);
            let seen = CpuVisibility::<f32>::new(&occluders)
                .visible(&pairs)
                .unwrap();
            let mut hist = [[0usize; 2]; 6];
            for (p, seen) in pairs.iter().zip(seen) {
                let (a, b) = (
                    glam::Vec3::from(p.from).as_dvec3() + s.origin,
                    glam::Vec3::from(p.to).as_dvec3() + s.origin,
                );
                let t = (22.5 - a.x) / (b.x - a.x);
                let q = a.lerp(b, t);
                let d = q.y.min(q.z).min(20.0 - q.y).min(20.0 - q.z);
                let bin = if d < 0.0 {
                    0
                } else if d < 0.25 {
                    1
                } else if d < 0.5 {
                    2
                } else if d < 1.0 {
                    3
                } else if d < 2.0 {
                    4
                } else {
                    5
                };
                hist[bin][usize::from(seen)] += 1;
            }
            println!(
                "{sampling:?} {degrees} {shift}: [blocked, leaked] at <0, <.25, <.5, <1, <2, more: {hist:?}"
            );
        }
    }
}
