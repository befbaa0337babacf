//! Cells: do they tile the surface, whatever its shape and however it is sampled?

mod clouds;

use std::f64::consts::PI;

use clouds::*;
use fmmgi_gpu::points::MAX_EDGES;
use fmmgi_gpu::{PointCloud, Surfels};
use glam::{DQuat, DVec2, DVec3, Vec2};
use proptest::prelude::*;
use rand::RngExt;

fn area_sum(surfels: &Surfels) -> f64 {
    surfels.areas.iter().map(|&a| f64::from(a)).sum()
}

/// Signed area of a polygon.
fn polygon_area(corners: &[Vec2; MAX_EDGES]) -> f64 {
    let c = corners.map(|c| c.as_dvec2());
    0.5 * (0..MAX_EDGES)
        .map(|k| c[k].perp_dot(c[(k + 1) % MAX_EDGES]))
        .sum::<f64>()
}

/// r(d) = 1 + 0.15 sin(3 x) sin(3 y + 1) + 0.1 z: a bumpy sphere around the origin.
fn bumpy(d: DVec3) -> f64 {
    1.0 + 0.15 * (3.0 * d.x).sin() * (3.0 * d.y + 1.0).sin() + 0.1 * d.z
}

fn bumpy_normal(d: DVec3) -> DVec3 {
    let step = 1e-5;
    let a = d.any_orthonormal_vector();
    let b = d.cross(a);
    let at = |v: DVec3| v.normalize() * bumpy(v.normalize());
    (at(d + a * step) - at(d - a * step))
        .cross(at(d + b * step) - at(d - b * step))
        .normalize()
}

fn bumpy_sphere(n: usize, jitter: f64, seed: u64) -> PointCloud {
    cloud(
        on_sphere(n, jitter, seed)
            .into_iter()
            .map(|d| (d * bumpy(d), bumpy_normal(d))),
    )
}

/// ∫ r² / (n · d) over the unit sphere.
fn bumpy_area() -> f64 {
    let places = on_sphere(100_000, 0.0, 0);
    let sum: f64 = places
        .iter()
        .map(|&d| bumpy(d).powi(2) / bumpy_normal(d).dot(d))
        .sum();
    4.0 * PI * sum / places.len() as f64
}

/// Corners in space.
fn corners(s: &Surfels, i: usize) -> [DVec3; MAX_EDGES] {
    let (normal, tangent) = (s.normals[i].as_dvec3(), s.cells.tangents[i].as_dvec3());
    let across = normal.cross(tangent);
    s.cells.corners[i].map(|c| {
        let c = c.as_dvec2();
        s.positions[i].as_dvec3() + tangent * c.x + across * c.y
    })
}

/// Whether the line through `from` along `way` meets cell i, and how far from its plane's point.
fn on_cell(s: &Surfels, i: usize, from: DVec3, way: DVec3) -> bool {
    let (normal, tangent) = (s.normals[i].as_dvec3(), s.cells.tangents[i].as_dvec3());
    let to = s.positions[i].as_dvec3() - from;
    let t = to.dot(normal) / way.dot(normal);
    let hit = way * t - to;
    let reach = 3.0 * f64::from(s.areas[i]).sqrt();
    if !t.is_finite() || t < 0.0 || hit.length() > reach {
        return false;
    }
    let p = DVec2::new(hit.dot(tangent), hit.dot(normal.cross(tangent)));
    let c = s.cells.corners[i].map(|c| c.as_dvec2());
    (0..MAX_EDGES).all(|k| (c[(k + 1) % MAX_EDGES] - c[k]).perp_dot(p - c[k]) >= 0.0)
}

/// Shares of lines that meet no cell, and more than one, of surfels whose normal is along them.
fn leak_and_overlap(s: &Surfels, lines: impl Iterator<Item = (DVec3, DVec3)>) -> [f64; 2] {
    let (mut all, mut none, mut many) = (0, 0, 0);
    for (from, way) in lines {
        let met = (0..s.len())
            .filter(|&i| s.normals[i].as_dvec3().dot(way).abs() > 0.3 && on_cell(s, i, from, way))
            .count();
        all += 1;
        none += usize::from(met == 0);
        many += usize::from(met > 1);
    }
    [none, many].map(|n| f64::from(n as u32) / f64::from(all))
}

/// What holds for every cell, of whatever cloud.
fn check_structure(s: &Surfels) {
    for i in 0..s.len() {
        let (n, t) = (s.normals[i], s.cells.tangents[i]);
        let c = s.cells.corners[i].map(|c| c.as_dvec2());
        assert!((n.length() - 1.0).abs() < 1e-6 && (t.length() - 1.0).abs() < 1e-6);
        assert!(n.dot(t).abs() < 1e-6, "tangent {t} of normal {n}");
        let size = c.iter().fold(0.0, |m: f64, c| m.max(c.length()));
        assert!(size.is_finite() && size > 0.0, "cell {i}: {c:?}");
        // Corners are rounded to f32.
        let slack = 1e-6 * size * size;
        for k in 0..MAX_EDGES {
            let edge = |k: usize| c[(k + 1) % MAX_EDGES] - c[k % MAX_EDGES];
            assert!(
                edge(k).perp_dot(-c[k]) >= -slack,
                "cell {i} misses its point: {c:?}"
            );
            let next = (k + 1..k + MAX_EDGES).map(edge).find(|e| *e != DVec2::ZERO);
            let turn = edge(k).perp_dot(next.expect("a polygon"));
            assert!(turn >= -slack, "cell {i} is not convex: {c:?}");
        }
        let distinct = (0..MAX_EDGES)
            .filter(|&k| c[k] != c[(k + 1) % MAX_EDGES])
            .count();
        assert!(distinct >= 3, "cell {i}: {c:?}");
        // Every edge that has a length bounds the whole cell: a stray direction of a short one would
        // cut a hole.
        for (a, b) in (0..MAX_EDGES).map(|k| (c[k], c[(k + 1) % MAX_EDGES])) {
            for &p in c.iter().filter(|_| a != b) {
                let inside = (b - a).normalize().perp_dot(p - a);
                assert!(inside >= -1e-3 * size, "cell {i}: edge {a} {b}: {c:?}");
            }
        }
        assert!(s.areas[i] > 0.0 && s.areas[i].is_finite());
        assert!(s.offsets[i] > 0.0 && s.offsets[i].is_finite());
    }
    assert!((1.0..1.2).contains(&s.occluder_scale));
}

// Area sums, without given areas. The bound is what the cells are asked for, 3%; measured: grids
// and the middle half of strata within 1%, whole strata within 2%, random points within 1%.
#[test]
fn areas_add_up_to_the_surface() {
    let square = |k, jitter| quad(DVec3::ZERO, DVec3::X, DVec3::Y, k, jitter, 1);
    let strip = quad(DVec3::ZERO, DVec3::X * 4.0, DVec3::Y, 25, 0.5, 2);
    let mut known = vec![
        ("strip, stretched points", strip, 4.0),
        ("random square", random_square(1000, 1), 1.0),
        ("random square", random_square(10_000, 1), 1.0),
    ];
    for jitter in [0.0, 0.5, 1.0] {
        for k in [10, 32, 100] {
            known.push(("square", square(k, jitter), 1.0));
            known.push(("box", cube(k, jitter, true, 1), 6.0));
            known.push(("box from outside", cube(k, jitter, false, 1), 6.0));
        }
        for n in [300, 1000, 10_000] {
            known.push(("sphere", sphere(n, jitter, true, 1), 4.0 * PI));
            known.push(("bumpy sphere", bumpy_sphere(n, jitter, 1), bumpy_area()));
        }
        known.push(("open cylinder", cylinder(60, 20, jitter), 4.0 * PI));
    }
    for (name, cloud, area) in known {
        let s = surfels(&cloud);
        let ratio = area_sum(&s) / area;
        assert!(
            (ratio - 1.0).abs() < 0.03,
            "{name} of {} points: {ratio}",
            cloud.len()
        );
        check_structure(&s);
    }
}

/// The lateral surface of the cylinder of radius 1 and height 2, seen from inside.
fn cylinder(around: usize, up: usize, jitter: f64) -> PointCloud {
    let unrolled = quad(DVec3::ZERO, DVec3::X, DVec3::Y, 1, 0.0, 0);
    assert_eq!(unrolled.len(), 1);
    let mut rng = random(4);
    cloud((0..around * up).map(|k| {
        let mut at =
            |q: usize, n: usize| (q as f64 + 0.5 + jitter * (rng.random::<f64>() - 0.5)) / n as f64;
        let n = DVec2::from_angle(2.0 * PI * at(k % around, around)).extend(0.0);
        (n + DVec3::Z * (2.0 * at(k / around, up)), -n)
    }))
}

/// The polygon's own area is the area, but for corners beyond the eighth.
#[test]
fn a_polygon_has_its_area() {
    for (cloud, most) in [
        (quad(DVec3::ZERO, DVec3::X, DVec3::Y, 32, 0.5, 1), 0.001),
        (random_square(3000, 1), 0.002),
        (sphere(3000, 1.0, true, 1), 0.001),
    ] {
        let s = surfels(&cloud);
        let polygons: f64 = s.cells.corners.iter().map(polygon_area).sum();
        let lost = 1.0 - polygons / area_sum(&s);
        // Measured: 0.0001, 0.0006, 0.0002.
        println!("cut off: {lost}");
        assert!((-1e-6..most).contains(&lost), "{lost}");
    }
}

// Lines that cross the surface meet one cell. Exactly one on a plane (but for corners beyond the
// eighth); on a curved surface tangent planes of neighbours part by about curvature * h² / 2, which
// opens seams of width ~ h³: shares fall with n. Bounds are three times what was measured.
#[test]
fn cells_tile_the_surface() {
    let mut rng = random(5);
    let mut lines = |n: usize| -> Vec<DVec3> { (0..n).map(|_| direction(&mut rng)).collect() };
    // Downwards on a square, off its border.
    let on_square: Vec<_> = lines(3000)
        .iter()
        .map(|d| (DVec3::new(0.5 + 0.4 * d.x, 0.5 + 0.4 * d.y, 1.0), -DVec3::Z))
        .collect();
    // From the middle of the box and the sphere.
    let from_centre: Vec<_> = lines(3000).iter().map(|&d| (DVec3::ZERO, d)).collect();
    let cases = [
        (
            "grid",
            quad(DVec3::ZERO, DVec3::X, DVec3::Y, 30, 0.0, 1),
            [0.0, 0.0],
        ),
        (
            "strata",
            quad(DVec3::ZERO, DVec3::X, DVec3::Y, 30, 1.0, 1),
            [0.002, 0.0],
        ),
        ("random", random_square(1000, 1), [0.015, 0.0]),
        ("sphere", sphere(1000, 1.0, true, 1), [0.01, 0.01]),
        ("fine sphere", sphere(4000, 1.0, true, 1), [0.005, 0.005]),
        ("bumpy", bumpy_sphere(2000, 0.5, 1), [0.01, 0.01]),
        ("box", cube(20, 0.5, true, 1), [0.005, 0.005]),
    ];
    for (name, cloud, [most_leak, most_overlap]) in cases {
        let s = surfels(&cloud);
        let flat = cloud.positions.iter().all(|p| p.z == 0.0);
        let lines = if flat { &on_square } else { &from_centre };
        let shifted = lines.iter().map(|&(from, way)| match flat {
            true => (from - s.origin, way),
            false => (from, way),
        });
        let [leak, overlap] = leak_and_overlap(&s, shifted);
        println!("{name}: leak {leak}, overlap {overlap}");
        assert!(
            leak <= most_leak && overlap <= most_overlap,
            "{name}: {leak} {overlap}"
        );
    }
}

/// Largest distance of a corner of one polygon from the border of the other.
fn corners_apart(a: [DVec3; MAX_EDGES], b: [DVec3; MAX_EDGES]) -> f64 {
    let to_edge = |p: DVec3, q: DVec3, r: DVec3| {
        let along = (p - q).dot(r - q) / (r - q).length_squared().max(f64::MIN_POSITIVE);
        p.distance(q.lerp(r, along.clamp(0.0, 1.0)))
    };
    let one_way = |a: [DVec3; MAX_EDGES], b: [DVec3; MAX_EDGES]| {
        let nearest = |p: DVec3| {
            (0..MAX_EDGES)
                .map(|k| to_edge(p, b[k], b[(k + 1) % MAX_EDGES]))
                .fold(f64::INFINITY, f64::min)
        };
        a.into_iter().map(nearest).fold(0.0, f64::max)
    };
    one_way(a, b).max(one_way(b, a))
}

#[test]
fn cells_move_with_the_cloud() {
    let clouds = [
        ("box", cube(12, 0.5, true, 3)),
        ("random", random_square(800, 3)),
        ("bumpy", bumpy_sphere(1000, 0.5, 3)),
    ];
    for (name, cloud) in clouds {
        let before = surfels(&cloud);
        let spacing = before.areas.iter().sum::<f32>() / before.len() as f32;
        let spacing = f64::from(spacing).sqrt();
        for (turn, scale, shift) in [
            (DQuat::IDENTITY, 1.0, DVec3::new(3e5, -6e6, 40.0)),
            (DQuat::IDENTITY, 1e4, DVec3::ZERO),
            (DQuat::IDENTITY, 1e-4, DVec3::ZERO),
            (rotation(1), 1.0, DVec3::ZERO),
            (rotation(2), 0.01, DVec3::new(1.0, 2.0, 3.0)),
        ] {
            let after = surfels(&moved(&cloud, turn, scale, shift));
            assert_eq!(after.len(), before.len());
            // Positions and normals are rounded to 1e-7 of the cloud's size, 1e-5 of a spacing;
            // corners where two edges almost agree magnify that.
            let mut apart: Vec<f64> = (0..before.len())
                .map(|i| {
                    let origin = turn * before.origin * scale + shift - after.origin;
                    let there = corners(&before, i).map(|c| turn * c * scale + origin);
                    corners_apart(there, corners(&after, i)) / (scale * spacing)
                })
                .collect();
            apart.sort_by(f64::total_cmp);
            let p99 = apart[apart.len() * 99 / 100];
            assert!(
                p99 < 3e-3,
                "{name}, {turn} {scale} {shift}: corners move by {p99}"
            );
            let differ = (0..before.len())
                .filter(|&i| {
                    let ratio = f64::from(after.areas[i] / before.areas[i]) / (scale * scale);
                    (ratio - 1.0).abs() > 1e-3
                })
                .count();
            assert!(
                differ <= before.len() / 500,
                "{name}: {differ} areas change"
            );
        }
    }
}

#[test]
fn the_order_of_points_does_not_matter() {
    for cloud in [cube(12, 0.5, true, 3), bumpy_sphere(1000, 0.5, 3)] {
        let order = shuffled(cloud.len(), 7);
        let before = surfels(&cloud);
        let after = surfels(&permuted(&cloud, &order));
        assert_eq!(before.occluder_scale, after.occluder_scale);
        for (k, &i) in order.iter().enumerate() {
            assert_eq!(after.positions[k], before.positions[i]);
            assert_eq!(after.areas[k], before.areas[i]);
            assert_eq!(after.offsets[k], before.offsets[i]);
            assert_eq!(after.cells.corners[k], before.cells.corners[i]);
        }
    }
}

#[test]
fn duplicates_are_merged() {
    let one = quad(DVec3::ZERO, DVec3::X, DVec3::Y, 20, 0.5, 1);
    let mut twice = joined([one.clone(), one.clone()]);
    let merged = prepare(&twice);
    let alone = surfels(&one);
    assert_eq!(merged.surfels.len(), one.len());
    assert_eq!(merged.surfels.areas, alone.areas);
    for i in 0..one.len() {
        assert_eq!(
            merged.surfel_of_point[i],
            merged.surfel_of_point[i + one.len()]
        );
    }
    assert!(
        merged
            .repairs
            .iter()
            .any(|r| r.starts_with("400 points at the place"))
    );
    // Given areas add up.
    twice.areas = vec![0.5; twice.len()];
    assert!(surfels(&twice).areas.iter().all(|&a| a == 1.0));
    // Back to back at one place: two sides of a sheet, not duplicates.
    let mut back = one.clone();
    back.normals.iter_mut().for_each(|n| *n = -*n);
    let sheet = surfels(&joined([one, back]));
    assert_eq!(sheet.len(), 800);
    check_structure(&sheet);
    let ratio = area_sum(&sheet) / 2.0;
    assert!((ratio - 1.0).abs() < 0.03, "both sides of a sheet: {ratio}");
}

// Two sides a tenth of a spacing apart: the back is no crease and no neighbour.
#[test]
fn thin_walls_keep_both_sides() {
    for gap in [0.1, 0.5, 1.0, 2.0] {
        let h = gap / 30.0;
        let front = quad(DVec3::ZERO, DVec3::X, DVec3::Y, 30, 0.5, 1);
        let back = quad(DVec3::Z * -h, DVec3::Y, DVec3::X, 30, 0.5, 2);
        let s = surfels(&joined([front, back]));
        check_structure(&s);
        let ratio = area_sum(&s) / 2.0;
        assert!((ratio - 1.0).abs() < 0.03, "gap {gap}: {ratio}");
    }
}

// Clean surfaces, flat or curved, keep the smallest offset; noise of normals and positions widens
// offset and cells and lowers the crease threshold, seen here by offset and scale alone.
#[test]
fn offset_and_scale_follow_noise() {
    let clean = [
        cube(20, 0.5, true, 1),
        sphere(4000, 0.5, true, 1),
        bumpy_sphere(4000, 0.5, 1),
        cylinder(100, 30, 0.5),
    ];
    let in_spacings = |s: &Surfels| {
        let mut ratios: Vec<f32> = (0..s.len())
            .map(|i| s.offsets[i] / s.areas[i].sqrt())
            .collect();
        ratios.sort_by(f32::total_cmp);
        ratios[s.len() / 2]
    };
    for cloud in clean {
        let s = surfels(&cloud);
        // 0.02 mean distances of neighbours, each about 1.1 to 1.2 times the square root of the area.
        assert!(
            (0.02..0.025).contains(&in_spacings(&s)),
            "{}",
            in_spacings(&s)
        );
        assert!(
            (s.occluder_scale - 1.02).abs() < 1e-3,
            "{}",
            s.occluder_scale
        );
        let (mut offset, mut scale) = (in_spacings(&s), s.occluder_scale);
        let spacing = f64::from(s.areas.iter().sum::<f32>() / s.len() as f32).sqrt();
        for (tilt, shift) in [(0.02, 0.02), (0.05, 0.05)] {
            let n = surfels(&noisy(&cloud, tilt, shift * spacing, 1));
            assert!(
                in_spacings(&n) > 1.5 * offset,
                "{} {offset}",
                in_spacings(&n)
            );
            assert!(n.occluder_scale > scale);
            (offset, scale) = (in_spacings(&n), n.occluder_scale);
            check_structure(&n);
        }
        assert!(offset < 0.25 && scale < 1.1);
    }
}

#[test]
fn odd_clouds_get_finite_cells() {
    let line = |k: usize, n: DVec3| cloud((0..k).map(|i| (DVec3::X * i as f64, n)));
    let flat = quad(DVec3::ZERO, DVec3::X, DVec3::Y, 10, 1.0, 1);
    let mut mixed = flat.clone();
    mixed.normals.iter_mut().step_by(2).for_each(|n| *n = -*n);
    let strays = cloud([(DVec3::X * 1e3, DVec3::Z), (DVec3::Y * -1e3, DVec3::X)]);
    let mut stacked: Vec<_> = (0..40).map(|i| (DVec3::Z * i as f64, DVec3::Z)).collect();
    stacked.push((DVec3::X, DVec3::Z));
    for (name, cloud) in [
        ("two points", line(2, DVec3::Z)),
        ("two points along their normal", line(2, DVec3::X)),
        ("a line", line(50, DVec3::Z)),
        ("a line along its normals", line(50, DVec3::X)),
        ("one plane with normals of both signs", mixed),
        ("strays", joined([flat.clone(), strays])),
        ("stacked", cloud(stacked)),
        ("random normals", {
            let mut rng = random(3);
            cloud((0..500).map(|_| (direction(&mut rng), direction(&mut rng))))
        }),
    ] {
        println!("{name}");
        check_structure(&surfels(&cloud));
    }
}

#[test]
fn a_single_point_takes_its_scale_from_its_area() {
    for area in [1e-8_f32, 1.0, 1e8] {
        let mut one = cloud([(DVec3::ONE, DVec3::Z)]);
        one.areas = vec![area];
        let s = surfels(&one);
        check_structure(&s);
        assert_eq!(s.areas[0], area);
        let cell = polygon_area(&s.cells.corners[0]) as f32;
        assert!((0.1..10.0).contains(&(cell / area)), "{cell} {area}");
    }
    let without = cloud([(DVec3::ONE, DVec3::Z)]);
    assert!(Surfels::prepare(&without, &fmmgi_gpu::progress::Silent).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 3000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]
    // Small whole numbers make duplicates, lines, planes, ties and opposite sides likely.
    #[test]
    fn any_cloud_has_sound_cells(
        points in prop::collection::vec(
            (prop::array::uniform3(-3i8..=3), prop::array::uniform3(-2i8..=2)),
            2..120,
        ),
        fine in any::<bool>(),
        scale in prop::sample::select(vec![1e-6, 1e-3, 1.0, 1e6]),
    ) {
        let mut rng = random(points.len() as u64);
        let cloud = cloud(points.iter().map(|(p, n)| {
            let p = DVec3::from_array(p.map(f64::from));
            let noise = if fine { direction(&mut rng) * 0.3 } else { DVec3::ZERO };
            ((p + noise) * scale, DVec3::from_array(n.map(f64::from)))
        }));
        if let Ok(prepared) = Surfels::prepare(&cloud, &fmmgi_gpu::progress::Silent) {
            check_structure(&prepared.surfels);
            prop_assert_eq!(prepared.surfel_of_point.len(), cloud.len());
        }
    }
}
