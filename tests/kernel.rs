//! Kernel and form factors against definitions, integrals and closed forms.

mod clouds;

use std::f64::consts::PI;

use clouds::{direction, random};
use fmmgi_gpu::expansion::{Surface, point_kernel, polygon_form_factor};
use fmmgi_gpu::points::MAX_EDGES;
use glam::{DQuat, DVec3};
use rand::{Rng, RngExt};

fn close(found: f64, wanted: f64, slack: f64, what: &str) {
    assert!(
        (found - wanted).abs() <= slack,
        "{what}: {found}, not {wanted}"
    );
}

#[test]
fn the_kernel_is_its_definition() {
    let mut rng = random(1);
    for _ in 0..1000 {
        let [x, n, y, m] = std::array::from_fn(|_| direction(&mut rng));
        let r = y - x;
        let d = r.length();
        let wanted = (n.dot(r) / d).max(0.0) * (-m.dot(r) / d).max(0.0) / (PI * d * d);
        let found = point_kernel::<f64>(x, n, y, m);
        close(found, wanted, 1e-12 * (1.0 + wanted), "kernel");
        assert_eq!(found, point_kernel::<f64>(y, m, x, n), "reciprocity");
        let [a, b, c, e] = [x, n, y, m].map(|v| v.as_vec3());
        // Five roundings each of the cosines, against |r|, and as many of the rest.
        let narrow = f64::from(point_kernel::<f32>(a, b, c, e));
        close(narrow, wanted, 2e-6 * (wanted + 1.0 / (PI * d * d)), "f32");
    }
    let (o, z) = (DVec3::ZERO, DVec3::Z);
    assert_eq!(point_kernel::<f64>(o, z, o, -z), 0.0, "at one place");
    assert_eq!(point_kernel::<f64>(o, z, z, -z), 1.0 / PI);
    assert_eq!(point_kernel::<f64>(o, z, z, z), 0.0, "from behind");
    assert_eq!(
        point_kernel::<f64>(o, -z, z, -z),
        0.0,
        "from below the horizon"
    );
}

/// A convex polygon of `edges` corners on a circle, seen from the front, the rest repeated.
fn polygon(
    rng: &mut impl Rng,
    centre: DVec3,
    normal: DVec3,
    radius: f64,
    edges: usize,
) -> [DVec3; MAX_EDGES] {
    let t = normal.any_orthonormal_vector();
    let b = normal.cross(t);
    let mut angles: Vec<f64> = (0..edges)
        .map(|k| 2.0 * PI * (k as f64 + 0.8 * rng.random::<f64>()) / edges as f64)
        .collect();
    angles.sort_by(f64::total_cmp);
    std::array::from_fn(|k| {
        let angle = angles[k.min(edges - 1)];
        centre + (t * angle.cos() + b * angle.sin()) * radius
    })
}

/// The mean over its triangles, cut up `depth` times, of the point kernel.
fn integrated(normal: DVec3, corners: &[DVec3; MAX_EDGES], depth: u32) -> f64 {
    fn triangle(normal: DVec3, t: [DVec3; 3], depth: u32) -> f64 {
        let [a, b, c] = t;
        if depth == 0 {
            let area = 0.5 * (b - a).cross(c - a);
            if area == DVec3::ZERO {
                return 0.0;
            }
            let centre = (a + b + c) / 3.0;
            let kernel = point_kernel::<f64>(DVec3::ZERO, normal, centre, area.normalize());
            return kernel * area.length();
        }
        let [d, e, f] = [(a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5];
        [[a, d, f], [d, b, e], [f, e, c], [d, e, f]]
            .into_iter()
            .map(|t| triangle(normal, t, depth - 1))
            .sum()
    }
    (1..MAX_EDGES - 1)
        .map(|k| triangle(normal, [corners[0], corners[k], corners[k + 1]], depth))
        .sum()
}

// Midpoints of 4^7 triangles each; the error falls with their number, but along the horizon with its
// root. Measured: 3e-6 above the horizon, 2e-5 across it.
#[test]
fn polygons_have_the_integral_of_the_kernel() {
    let mut rng = random(2);
    let (mut clipped, mut whole) = (0, 0);
    for _ in 0..60 {
        let normal = direction(&mut rng);
        let centre = direction(&mut rng) * rng.random_range(0.8..2.0);
        let facing = (direction(&mut rng) - centre).normalize();
        let edges = rng.random_range(3..=MAX_EDGES);
        let corners = polygon(&mut rng, centre, facing, 0.7, edges);
        let wanted = integrated(normal, &corners, 7);
        // The receiver may lie behind the polygon's plane; the caller excludes that.
        if facing.dot(centre) > -0.1 {
            continue;
        }
        let above = corners.iter().filter(|c| c.dot(normal) > 0.0).count();
        clipped += u32::from(above > 0 && above < MAX_EDGES);
        whole += u32::from(above == MAX_EDGES);
        let found = polygon_form_factor::<f64>(normal, &corners);
        close(found, wanted, 1e-4, "polygon");
        if above == 0 {
            assert_eq!(found, 0.0);
        }
        let narrow = corners.map(|c| c.as_vec3());
        let narrow = polygon_form_factor::<f32>(normal.as_vec3(), &narrow);
        // Angles and cosines are rounded to 1e-7 each, for at most ten edges.
        close(f64::from(narrow), found, 3e-6, "f32");
    }
    assert!(clipped >= 10 && whole >= 5, "{clipped} {whole}");
}

/// A rectangle in z = `height`, seen from below: counter-clockwise seen from the tip of its normal,
/// which points down to the receiver.
fn rectangle(low: [f64; 2], high: [f64; 2], height: f64) -> [DVec3; MAX_EDGES] {
    let (a, b) = (low, high);
    let c = [[a[0], a[1]], [a[0], b[1]], [b[0], b[1]], [b[0], a[1]]];
    std::array::from_fn(|k| DVec3::new(c[k.min(3)][0], c[k.min(3)][1], height))
}

#[test]
fn rectangles_have_their_closed_forms() {
    // Howell B-3 (element parallel to a rectangle, under its corner) and B-4 (perpendicular).
    for (a, b, c) in [
        (1.0, 1.0, 1.0),
        (2.0, 0.5, 0.3),
        (0.1, 0.2, 5.0),
        (30.0, 40.0, 0.01),
    ] {
        let (x, y): (f64, f64) = (a / c, b / c);
        let (p, q) = ((1.0 + x * x).sqrt(), (1.0 + y * y).sqrt());
        let parallel = (x / p * (y / p).atan() + y / q * (x / q).atan()) / (2.0 * PI);
        let corners = rectangle([0.0; 2], [a, b], c);
        close(
            polygon_form_factor::<f64>(DVec3::Z, &corners),
            parallel,
            1e-12,
            "parallel",
        );
        // Four such corners.
        let around = rectangle([-a, -b], [a, b], c);
        close(
            polygon_form_factor::<f64>(DVec3::Z, &around),
            4.0 * parallel,
            1e-12,
            "around",
        );
        // Receiver turned by a right angle: the part of the rectangle with x < 0 lies below its
        // horizon, and counts for nothing.
        let side = |corners| polygon_form_factor::<f64>(DVec3::X, &corners);
        let upright = (y.atan() - (y / p).atan() / p) / (2.0 * PI);
        close(
            side(rectangle([0.0; 2], [a, b], c)),
            upright,
            1e-12,
            "perpendicular",
        );
        close(
            side(rectangle([-a, 0.0], [a, b], c)),
            upright,
            1e-12,
            "clipped",
        );
        close(
            side(rectangle([-a, 0.0], [-0.1 * a, b], c)),
            0.0,
            0.0,
            "below the horizon",
        );
        close(
            side(rectangle([-a, 0.0], [0.0, b], c)),
            0.0,
            1e-15,
            "up to the horizon",
        );
    }
    // Howell B-12, tilted receiver far inside: a half-space's worth of ceiling is seen by a wall.
    let ceiling = rectangle([-1e6; 2], [1e6; 2], 1.0);
    for angle in [0.0f64, 0.5, 1.0, PI / 2.0, 2.5] {
        let normal = DVec3::new(angle.sin(), 0.0, angle.cos());
        let wanted = 0.5 * (1.0 + angle.cos());
        close(
            polygon_form_factor::<f64>(normal, &ceiling),
            wanted,
            1e-5,
            "half space",
        );
    }
}

#[test]
fn repeated_corners_and_their_order_change_nothing() {
    let mut rng = random(3);
    for edges in 3..=MAX_EDGES {
        let corners = polygon(&mut rng, DVec3::Z, DVec3::NEG_Z, 0.5, edges);
        let wanted = polygon_form_factor::<f64>(DVec3::Z, &corners);
        assert!(wanted > 0.01);
        for shift in 1..MAX_EDGES {
            let rolled = std::array::from_fn(|k| corners[(k + shift) % MAX_EDGES]);
            close(
                polygon_form_factor::<f64>(DVec3::Z, &rolled),
                wanted,
                1e-14,
                "rolled",
            );
        }
        // Two triangles and what lies between them: cut along a diagonal.
        if edges == MAX_EDGES {
            let at = |ids: [usize; 5]| std::array::from_fn(|k| corners[ids[k.min(4)]]);
            let halves = [at([0, 1, 2, 3, 4]), at([4, 5, 6, 7, 0])];
            let sum: f64 = halves
                .iter()
                .map(|h| polygon_form_factor::<f64>(DVec3::Z, h))
                .sum();
            close(sum, wanted, 1e-14, "halves");
        }
        assert_eq!(
            polygon_form_factor::<f64>(DVec3::Z, &[DVec3::Z; MAX_EDGES]),
            0.0
        );
    }
}

/// Close to the polygon's plane: beside it nothing arrives, above it everything, for f32 too. Where
/// receiver and polygon lie in one plane, heights are noise.
#[test]
fn receivers_close_to_the_plane() {
    let mut rng = random(4);
    for _ in 0..2000 {
        let turn = DQuat::from_axis_angle(direction(&mut rng), rng.random_range(0.0..3.0));
        let normal = turn * DVec3::Z;
        let height = 10f64.powf(rng.random_range(-9.0..-3.0));
        let edges = rng.random_range(3..=MAX_EDGES);
        let beside = turn * DVec3::X * rng.random_range(1.05..1.5);
        let corners = polygon(&mut rng, beside - normal * height, normal, 1.0, edges);
        // The same orientation: the polygon lies below the horizon.
        let narrow = corners.map(|c| c.as_vec3());
        let found = f64::from(polygon_form_factor::<f32>(normal.as_vec3(), &narrow));
        close(found, 0.0, 1e-6, "in its plane, f32");
        // A receiver that leans towards it sees a sliver, of an angle of about height / distance.
        let leaning = (normal + beside.normalize()).normalize();
        let exact = polygon_form_factor::<f64>(leaning, &corners);
        close(exact, 0.0, 20.0 * height, "sliver");
        let found = f64::from(polygon_form_factor::<f32>(leaning.as_vec3(), &narrow));
        close(found, exact, 3e-6, "sliver, f32");
        // Right above it: all that it sees; f32 cannot tell a height of less than its rounding.
        let over = polygon(&mut rng, -normal * height, normal, 1.0, MAX_EDGES);
        close(
            polygon_form_factor::<f64>(-normal, &over),
            1.0,
            20.0 * height,
            "above",
        );
        if height > 1e-6 {
            let narrow = over.map(|c| c.as_vec3());
            let found = polygon_form_factor::<f32>(-normal.as_vec3(), &narrow);
            close(f64::from(found), 1.0, 20.0 * height + 1e-5, "above, f32");
        }
    }
}

#[test]
fn small_polygons_are_points() {
    // Relative difference to area times the kernel at the centroid: of second order in size.
    let mut rng = random(5);
    let mut last = f64::INFINITY;
    for size in [0.1, 0.05, 0.025, 0.0125] {
        let mut worst = 0.0_f64;
        for _ in 0..200 {
            let centre = direction(&mut rng);
            let normal = (centre + 0.8 * direction(&mut rng)).normalize();
            let facing = (-centre + 0.8 * direction(&mut rng)).normalize();
            let corners = polygon(&mut rng, centre, facing, size, 6);
            let twice: DVec3 = (0..MAX_EDGES)
                .map(|k| (corners[k] - centre).cross(corners[(k + 1) % MAX_EDGES] - centre))
                .sum();
            let centroid = (0..MAX_EDGES)
                .map(|k| {
                    let (a, b) = (corners[k] - centre, corners[(k + 1) % MAX_EDGES] - centre);
                    (a + b) / 3.0 * a.cross(b).dot(twice.normalize()) / twice.length()
                })
                .sum::<DVec3>()
                + centre;
            let point =
                0.5 * twice.length() * point_kernel::<f64>(DVec3::ZERO, normal, centroid, facing);
            let found = polygon_form_factor::<f64>(normal, &corners);
            if point > 0.0 && normal.dot(centre) > 0.3 && facing.dot(centre) < -0.3 {
                worst = worst.max((found / point - 1.0).abs());
            }
        }
        assert!(worst < 10.0 * size * size, "{size}: {worst}");
        assert!(worst < 0.35 * last, "{size}: {worst} after {last}");
        last = worst;
    }
}

/// Form factors of the surfels of a room: A_i F_ij = A_j F_ji exactly for far pairs, and within the
/// cells' shapes for near ones; none negative, f32 as f64.
#[test]
fn surfels_exchange_light_both_ways() {
    let s = clouds::surfels(&clouds::cube(12, 0.5, true, 1));
    let (wide, narrow) = (Surface::<f64>::new(&s), Surface::<f32>::new(&s));
    let (mut near, mut sums) = ((0.0, 0.0), [0.0, 0.0]);
    for i in 0..s.len() {
        let mut row = 0.0;
        for j in 0..s.len() {
            let (a, b) = (wide.form_factor(i, j), wide.form_factor(j, i));
            let (a, b) = (a * wide.areas[i], b * wide.areas[j]);
            assert!(a >= 0.0);
            if !wide.is_near(i, j) {
                assert!((a - b).abs() <= 1e-12 * a, "reciprocity");
            } else {
                near.0 += (a - b).abs();
                near.1 += a;
            }
            let both = f64::from(narrow.form_factor(i, j));
            assert!((both - wide.form_factor(i, j)).abs() < 1e-6);
            row += wide.form_factor(i, j);
        }
        sums = [sums[0] + row, sums[1] + (row - 1.0).abs()];
    }
    // Near pairs treat the receiver as a point and the source as a cell, so that they are not
    // reciprocal. Measured: 27% of their light; rows sum up to 1.002 with deviations of 0.4%.
    println!("{} {:?}", near.0 / near.1, sums.map(|x| x / s.len() as f64));
    assert!(near.0 < 0.4 * near.1);
    assert!((sums[0] / s.len() as f64 - 1.0).abs() < 0.005);
    assert!(sums[1] / (s.len() as f64) < 0.01);
}
