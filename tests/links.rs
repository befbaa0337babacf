//! Links: every pair of surfels exactly once, and as accurate as asked for.

mod clouds;

use clouds::*;
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::links::{self, Accuracy, Facing, Links, Rows};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Direct, Fields, Fmm, TransportOperator};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::visibility::{CpuVisibility, NothingInTheWay, Occluders, Visibility};
use fmmgi_gpu::{PointCloud, Surfels};
use glam::DVec3;
use rand::RngExt;

/// The same error everywhere, for radiosities up to 1.
fn accuracy(octree: &Octree, error: f32) -> Accuracy {
    Accuracy {
        order: 1,
        error,
        radiosity: vec![1.0; octree.facets.len()],
        target_factor: vec![1.0; octree.facets.len()],
        seed: 1,
    }
}

fn build(s: &Surfels, octree: &Octree, error: f32, visibility: &dyn Visibility) -> Links {
    links::build(s, octree, &accuracy(octree, error), visibility, &Silent).expect("links")
}

/// The clouds that the lists are counted on.
fn clouds() -> Vec<(&'static str, PointCloud)> {
    let mut rng = random(9);
    let mut clusters = Vec::new();
    for c in 0..6 {
        let centre = direction(&mut rng) * (c as f64);
        clusters
            .extend((0..50).map(|_| (centre + direction(&mut rng) * 0.02, direction(&mut rng))));
    }
    let line = (0..120).map(|i| {
        let n = if i % 2 == 0 { DVec3::X } else { DVec3::NEG_X };
        (DVec3::X * (i as f64 + 0.3 * rng.random::<f64>()), n)
    });
    let line = cloud(line.collect::<Vec<_>>());
    // Points closer together than a float of the room's size can tell, and twice at one place.
    let room = cube(6, 0.5, true, 1);
    let doubled = joined([
        room.clone(),
        moved(&room, glam::DQuat::IDENTITY, 1.0 + 1e-7, DVec3::ZERO),
    ]);
    let mut one = cloud([(DVec3::ONE, DVec3::Z)]);
    one.areas = vec![1.0];
    vec![
        (
            "random",
            cloud((0..400).map(|_| (direction(&mut rng), direction(&mut rng)))),
        ),
        ("clusters", cloud(clusters)),
        ("room", cube(10, 0.5, true, 1)),
        (
            "turned room",
            moved(&cube(8, 0.5, true, 1), rotation(1), 1.0, DVec3::ZERO),
        ),
        ("noisy room", noisy(&cube(8, 0.5, true, 1), 0.1, 0.01, 1)),
        (
            "small sphere",
            moved(&sphere(600, 1.0, true, 1), rotation(4), 1e-4, DVec3::ZERO),
        ),
        (
            "large sphere",
            moved(&sphere(600, 1.0, true, 1), rotation(4), 1e4, DVec3::ONE),
        ),
        ("plane", quad(DVec3::ZERO, DVec3::X, DVec3::Y, 15, 1.0, 1)),
        ("line", line),
        ("doubled", doubled),
        ("single", one),
    ]
}

fn check_rows(rows: &Rows, targets: usize, sources: usize) {
    assert_eq!(rows.offsets.len(), targets + 1);
    assert_eq!(rows.offsets[0], 0);
    assert_eq!(rows.offsets[targets] as usize, rows.len());
    assert_eq!(rows.weights.len(), rows.len());
    assert!(rows.offsets.windows(2).all(|w| w[0] <= w[1]));
    assert!(rows.sources.iter().all(|&s| (s as usize) < sources));
    assert!(rows.weights.iter().all(|w| w.is_finite() && *w > 0.0));
}

fn check_well_formed(links: &Links, octree: &Octree, s: &Surfels) {
    let facets = octree.facets.len();
    for rows in &links.m2l {
        check_rows(rows, facets, facets);
        // Relative to the expansion: twice at most.
        assert!(rows.weights.iter().all(|&w| w <= 2.0));
    }
    check_rows(&links.mixed, facets, facets);
    check_rows(&links.sampled, facets, facets);
    check_rows(&links.near, s.len(), s.len());
}

/// How often each ordered pair (target, source) of surfels is linked.
fn coverage(links: &Links, octree: &Octree, surface: &Surface<f32>) -> Vec<u8> {
    let n = surface.len();
    let mut count = vec![0u8; n * n];
    for rows in links.m2l.iter().chain([&links.mixed, &links.sampled]) {
        for t in 0..octree.facets.len() {
            for (source, _) in rows.row(t) {
                for i in octree.facets[t].surfels() {
                    for j in octree.facets[source].surfels() {
                        count[i * n + j] += 1;
                    }
                }
            }
        }
    }
    for (t, target) in octree.facets.iter().enumerate() {
        for (source, _) in links.p2p.row(t) {
            for i in target.surfels() {
                for j in octree.facets[source].surfels() {
                    count[i * n + j] += u8::from(!surface.is_near(i, j));
                }
            }
        }
    }
    for i in 0..n {
        for (j, _) in links.near.row(i) {
            count[i * n + j] += 1;
        }
    }
    count
}

// With nothing in the way. No pair is linked twice. A pair that is not linked has no form factor,
// or is dropped: as negligible (at most half of the allowed error), or because none of at least four
// samples of a link face each other, for a link that can bring the allowed error / 0.3; or its cosine
// is rounding noise (1e-5: clusters are small against their distance).
#[test]
fn every_pair_is_linked_once() {
    for (name, cloud) in clouds() {
        let (octree, s) = Octree::build(&surfels(&cloud), LEAF_SIZE);
        let surface = Surface::<f32>::new(&s);
        let n = s.len();
        for error in [1e-9, 0.003, 0.03, 0.3] {
            let links = build(&s, &octree, error, &NothingInTheWay);
            check_well_formed(&links, &octree, &s);
            let count = coverage(&links, &octree, &surface);
            assert!(
                count.iter().all(|&c| c <= 1),
                "{name}, {error}: a pair is linked twice"
            );
            let (mut dropped, mut all) = (0.0, 0.0);
            for i in 0..n {
                for j in 0..n {
                    let form_factor = surface.form_factor(i, j);
                    all += f64::from(form_factor);
                    if count[i * n + j] == 0 {
                        dropped += f64::from(form_factor);
                        assert!(
                            form_factor <= (error / 0.3).max(1e-5),
                            "{name}, {error}: {i} {j} {form_factor}"
                        );
                    }
                }
            }
            // Measured: at most 0.2% for 0.03.
            println!(
                "{name}, {error}: {:.1e} of the light dropped",
                dropped / all
            );
            assert!(
                dropped <= 0.005 * all || error > 0.03,
                "{name}, {error}: {dropped} {all}"
            );
        }
    }
}

fn apply<O: TransportOperator>(operator: &O, radiosity: &[DVec3]) -> Vec<DVec3> {
    let fields = operator.fields();
    let applied = operator.apply(&fields.upload(radiosity).expect("upload"));
    fields
        .download(&applied.expect("applied"))
        .expect("download")
}

fn radiosity(n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = random(seed);
    (0..n)
        .map(|_| DVec3::new(rng.random(), rng.random(), rng.random()))
        .collect()
}

fn relative(a: &[DVec3], b: &[DVec3]) -> f64 {
    let square = |v: &mut dyn Iterator<Item = DVec3>| v.map(|x| x.length_squared()).sum::<f64>();
    let difference = square(&mut a.iter().zip(b).map(|(a, b)| *a - *b));
    (difference / square(&mut b.iter().copied())).sqrt()
}

/// Asked for next to no error, links are near pairs only and the operator is the direct sum, but for
/// the form factors' rounding to f32.
#[test]
fn without_allowed_error_the_operator_is_the_direct_sum() {
    for (name, cloud) in clouds() {
        let (octree, s) = Octree::build(&surfels(&cloud), LEAF_SIZE);
        let occluders = Occluders::build(&s);
        let visibility = CpuVisibility::<f32>::new(&occluders);
        let b = radiosity(s.len(), 2);
        for visibility in [&NothingInTheWay as &dyn Visibility, &visibility] {
            let links = build(&s, &octree, 1e-12, visibility);
            let direct = Direct::new(&s, visibility, &Silent).expect("small");
            let exact = apply(&direct, &b);
            if exact.iter().all(|h| *h == DVec3::ZERO) {
                continue;
            }
            let found = apply(&Fmm::<f64>::new(&s, &octree, &links), &b);
            let error = relative(&found, &exact);
            println!("{name}: {error:.1e}");
            assert!(error < 1e-5, "{name}: {error}");
        }
    }
}

/// The unit cube with a thin wall across, in it a door.
fn two_rooms() -> PointCloud {
    let wall = |x: f64, u: DVec3, v: DVec3| quad(DVec3::new(x, 0.0, 0.0), u, v, 12, 0.5, 3);
    let around_door = |c: PointCloud| {
        let keep: Vec<usize> = (0..c.len())
            .filter(|&i| c.positions[i].y > 0.4 || c.positions[i].z > 0.7)
            .collect();
        permuted(&c, &keep)
    };
    joined([
        cube(12, 0.5, true, 2),
        around_door(wall(0.49, DVec3::Z, DVec3::Y)),
        around_door(wall(0.51, DVec3::Y, DVec3::Z)),
    ])
}

/// What is allowed a link bounds no sum, so that the trend is certain and the figures are measured;
/// bounds are 1.5 to 2 times those. Allowed 0.03 / 0.003 / 0.0001: room .019 .009 .002; bowl .014
/// .007 .001. Between two rooms a few surfels in the doorway see what all around them do not, and
/// samples of their facets may miss it: .029 .011; 0.000001: .00001.
#[test]
fn error_follows_what_is_allowed() {
    for (name, cloud, steps) in [
        (
            "room",
            cube(12, 0.5, true, 1),
            [(0.03, 0.03), (0.003, 0.015), (1e-4, 0.004)],
        ),
        (
            "bowl",
            sphere(1000, 1.0, true, 1),
            [(0.03, 0.025), (0.003, 0.012), (1e-4, 0.003)],
        ),
        (
            "two rooms",
            two_rooms(),
            [(0.03, 0.05), (0.003, 0.02), (1e-6, 1e-4)],
        ),
    ] {
        let (octree, s) = Octree::build(&surfels(&cloud), LEAF_SIZE);
        let occluders = Occluders::build(&s);
        let visibility = CpuVisibility::<f32>::new(&occluders);
        // Light that varies smoothly.
        let b: Vec<DVec3> = s
            .positions
            .iter()
            .map(|p| DVec3::new(0.5 + 0.5 * f64::from(p.x), f64::from(p.y).powi(2), 0.3))
            .map(|b| b.clamp(DVec3::ZERO, DVec3::ONE))
            .collect();
        let exact = apply(&Direct::new(&s, &visibility, &Silent).expect("small"), &b);
        let mut last = f64::INFINITY;
        for (error, most) in steps {
            let links = build(&s, &octree, error, &visibility);
            check_well_formed(&links, &octree, &s);
            let found = apply(&Fmm::<f32>::new(&s, &octree, &links), &b);
            let off = relative(&found, &exact);
            println!("{name}, {error}: {off:.1e} {:?}", links.counts());
            assert!(off < most && off < last, "{name}, {error}: {off}");
            last = off;
            // Expansions may undershoot, where little light arrives; nothing near the mean.
            let least = found.iter().map(|h| h.min_element()).fold(0.0, f64::min);
            assert!(least > -0.01, "{name}: {least}");
        }
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let (octree, s) = Octree::build(&surfels(&two_rooms()), LEAF_SIZE);
    let occluders = Occluders::build(&s);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("a pool").install(|| {
            let visibility = CpuVisibility::<f32>::new(&occluders);
            let links = build(&s, &octree, 0.01, &visibility);
            let b = radiosity(s.len(), 5);
            let applied = apply(&Fmm::<f32>::new(&s, &octree, &links), &b);
            (links, applied)
        })
    };
    assert_eq!(run(1), run(4));
}

/// Brute force: the bounds of two facets hold for all their surfels.
#[test]
fn bounds_of_facing_hold() {
    for (name, cloud) in clouds() {
        let (octree, s) = Octree::build(&surfels(&cloud), LEAF_SIZE);
        let mut rng = random(3);
        let n = octree.facets.len();
        for _ in 0..2000 {
            let a = &octree.facets[rng.random_range(0..n)];
            let b = &octree.facets[rng.random_range(0..n)];
            let facing = Facing::between(a, b);
            let slack =
                1e-5 * (facing.distance + a.radius + b.radius) + 1e-6 * s.positions[0].length();
            let mut faces = [0, 0];
            for i in a.surfels() {
                for j in b.surfels() {
                    let way = s.positions[j] - s.positions[i];
                    let up = [s.normals[i].dot(way), -s.normals[j].dot(way)];
                    assert!(way.length() >= facing.gap - slack, "{name}");
                    for (k, bounds) in [facing.target, facing.source].into_iter().enumerate() {
                        assert!(up[k] >= bounds[0] - slack, "{name}: {} {bounds:?}", up[k]);
                        assert!(up[k] <= bounds[1] + slack, "{name}: {} {bounds:?}", up[k]);
                        if facing.gap > 10.0 * slack && up[k] > 0.0 {
                            let cos = up[k] / way.length();
                            assert!(cos <= facing.cosines()[k] + 1e-3, "{name}: {cos}");
                        }
                        faces[k] += usize::from(up[k] > slack);
                    }
                }
            }
            assert!(
                !facing.averted() || faces[0] == 0 || faces[1] == 0,
                "{name}"
            );
        }
    }
}

#[test]
fn dark_sources_have_no_links() {
    let (octree, s) = Octree::build(&surfels(&cube(8, 0.5, true, 1)), LEAF_SIZE);
    let mut dark = accuracy(&octree, 0.01);
    dark.radiosity.fill(0.0);
    let links = links::build(&s, &octree, &dark, &NothingInTheWay, &Silent).expect("links");
    assert!(links.counts().iter().all(|&(_, n)| n == 0));
}
