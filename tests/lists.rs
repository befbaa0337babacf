//! Lists without occlusion: every pair of surfels exactly once, expansions only where they converge.

mod clouds;

use std::f64::consts::PI;

use clouds::*;
use fmmgi_gpu::Surfels;
use fmmgi_gpu::expansion::Surface;
use fmmgi_gpu::links::{Cosines, Links, Mac, Rows, THETA, adaptive, dual};
use fmmgi_gpu::octree::{Facet, Octree};
use fmmgi_gpu::progress::Silent;
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use rand::RngExt;

/// Both kinds of lists, with expansions of this order.
fn lists(
    octree: &Octree,
    s: &Surfels,
    cosines: Cosines,
    order: usize,
) -> [(&'static str, Links); 2] {
    let mac = Mac {
        theta: THETA,
        order,
        cosines,
    };
    let facets = &octree.facets;
    let judge = |t: u32, s: u32| mac.judge(&facets[t as usize], &facets[s as usize]);
    [
        (
            "adaptive",
            adaptive(octree, s, cosines, order, &Silent).expect("lists"),
        ),
        (
            "dual",
            dual(octree, s, order, judge, &Silent).expect("lists"),
        ),
    ]
}

/// Lists of facets.
fn of_facets(links: &Links) -> impl Iterator<Item = &Rows> {
    links
        .m2l
        .iter()
        .chain([&links.m2p, &links.p2l, &links.p2p, &links.sampled])
}

/// Pairs of facets in a list.
fn pairs<'a>(rows: &'a Rows, octree: &'a Octree) -> impl Iterator<Item = (&'a Facet, &'a Facet)> {
    let facets = &octree.facets;
    (0..facets.len()).flat_map(move |t| rows.row(t).map(move |(s, _)| (&facets[t], &facets[s])))
}

fn clouds_of_all_kinds() -> Vec<(&'static str, Surfels)> {
    let mut rng = random(9);
    let mut place =
        |size: f64| DVec3::from_array(std::array::from_fn(|_| size * rng.random::<f64>()));
    let volume: Vec<_> = (0..800).map(|_| place(1.0)).collect();
    // Clusters of sizes from 0.3 to 3e-6: leaves of all levels beside each other.
    let clusters: Vec<_> = (0..12)
        .flat_map(|c| {
            let (centre, size) = (place(1.0), 0.3 * 0.35_f64.powi(c));
            (0..60).map(|_| centre + place(size)).collect::<Vec<_>>()
        })
        .collect();
    let plane = (0..900).map(|k| DVec3::new(f64::from(k % 30), f64::from(k / 30), 0.0));
    let line = (0..300).map(|k| DVec3::X * f64::from(k * k));
    // Sixty surfels at each of five places, and some around.
    let heaps = (0..400).map(|k| match k {
        ..300 => DVec3::splat(f64::from(k % 5)),
        _ => DVec3::new(f64::from(k % 10), f64::from(k % 7), 0.5),
    });
    // So dense that it is one cell of the finest level.
    let clump = (0..200).map(|k| match k {
        0 => DVec3::splat(1e3),
        _ => DVec3::new(f64::from(k % 20), f64::from(k / 20), 0.0) * 1e-6,
    });
    let room = cube(9, 0.5, true, 1);
    let normals = |places: Vec<DVec3>| {
        let mut rng = random(4);
        let turned = places.into_iter().map(|p| (p, direction(&mut rng)));
        bare(turned.collect::<Vec<_>>(), 1e-3)
    };
    let upward = |places: Vec<DVec3>| bare(places.into_iter().map(|p| (p, DVec3::Z)), 1e-3);
    vec![
        ("volume", normals(volume.clone())),
        ("volume of one normal", upward(volume)),
        ("clusters", normals(clusters.clone())),
        ("clusters of one normal", upward(clusters)),
        ("plane", upward(plane.collect())),
        ("line", upward(line.collect())),
        ("heaps", normals(heaps.clone().collect())),
        ("heaps of one normal", upward(heaps.collect())),
        ("clump", upward(clump.collect())),
        ("room", surfels(&room)),
        ("bowl", surfels(&sphere(800, 0.5, true, 1))),
        ("ball", surfels(&sphere(800, 0.5, false, 1))),
        ("one surfel", upward(vec![DVec3::ONE])),
    ]
}

/// How often each ordered pair (target, source) of surfels is linked. P2P leaves out those for which
/// `is_near` holds.
fn coverage(
    links: &Links,
    octree: &Octree,
    n: usize,
    is_near: impl Fn(usize, usize) -> bool,
) -> Vec<u8> {
    let mut count = vec![0u8; n * n];
    for rows in of_facets(links) {
        let p2p = std::ptr::eq(rows, &links.p2p);
        for (target, source) in pairs(rows, octree) {
            for i in target.surfels() {
                for j in source.surfels() {
                    count[i * n + j] += u8::from(!p2p || !is_near(i, j));
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

#[test]
fn with_a_kernel_of_one_every_pair_counts_once() {
    for (name, given) in clouds_of_all_kinds() {
        for leaf_size in [1, 5, 32] {
            let (octree, s) = Octree::build(&given, leaf_size);
            for (kind, links) in lists(&octree, &s, Cosines::Signed, 3) {
                let count = coverage(&links, &octree, s.len(), |_, _| false);
                let wrong = count.iter().filter(|&&c| c != 1).count();
                assert_eq!(wrong, 0, "{name}, {kind}, leaves of {leaf_size}");
                assert!(links.near.is_empty());
            }
        }
    }
}

/// A kernel of 1 applied to random numbers, modulo 2⁶⁴: a pair that is missing or comes twice shows
/// at its target, but for one chance in 2⁶⁴.
#[test]
fn with_a_kernel_of_one_large_clouds_sum_up() {
    let mut rng = random(5);
    let mut given = Vec::new();
    for k in 0..60_000 {
        let size = if k % 3 == 0 { 1e-3 } else { 1.0 };
        let p = DVec3::from_array(std::array::from_fn(|_| size * rng.random::<f64>()));
        given.push((p, direction(&mut rng)));
    }
    let (octree, s) = Octree::build(&bare(given, 1e-5), 24);
    let charge: Vec<u64> = (0..s.len()).map(|_| rng.random()).collect();
    let total = charge.iter().fold(0u64, |sum, c| sum.wrapping_add(*c));
    let moment = |f: &Facet| {
        charge[f.surfels()]
            .iter()
            .fold(0u64, |m, c| m.wrapping_add(*c))
    };
    let moments: Vec<u64> = octree.facets.iter().map(moment).collect();
    for (kind, links) in lists(&octree, &s, Cosines::Signed, 2) {
        let mut locals = vec![0u64; octree.facets.len()];
        for rows in of_facets(&links) {
            for (t, local) in locals.iter_mut().enumerate() {
                *local = rows
                    .row(t)
                    .fold(*local, |l, (s, _)| l.wrapping_add(moments[s]));
            }
        }
        for f in 1..octree.facets.len() {
            locals[f] = locals[f].wrapping_add(locals[octree.facets[f].parent as usize]);
        }
        for (f, facet) in octree
            .facets
            .iter()
            .enumerate()
            .filter(|(_, f)| f.is_leaf())
        {
            assert_eq!(
                locals[f],
                total,
                "{kind}: leaf of surfels {:?}",
                facet.surfels()
            );
        }
    }
}

/// With clamped cosines no pair is linked twice, and all are that exchange light, unless the cosine
/// is rounding noise (1e-5). Expansions bring no more light from below the horizon than is allowed.
#[test]
fn every_pair_that_exchanges_light_is_linked_once() {
    for (name, given) in clouds_of_all_kinds() {
        for (leaf_size, tolerance) in [(1, 0.0), (5, 0.0), (32, 0.0), (5, 1e-4), (5, 1e-3)] {
            let (octree, s) = Octree::build(&given, leaf_size);
            let (n, surface) = (s.len(), Surface::<f32>::new(&s));
            for (kind, links) in lists(&octree, &s, Cosines::Clamped { tolerance }, 3) {
                let at = format!("{name}, {kind}, leaves of {leaf_size}");
                let count = coverage(&links, &octree, n, |i, j| surface.is_near(i, j));
                assert!(
                    count.iter().all(|&c| c <= 1),
                    "{at}: a pair is linked twice"
                );
                for (k, _) in count.iter().enumerate().filter(|&(_, &c)| c == 0) {
                    let (i, j) = (k / n, k % n);
                    let way = (s.positions[j] - s.positions[i]).normalize_or_zero();
                    let cosines = [s.normals[i].dot(way), -s.normals[j].dot(way)];
                    let lit = surface.form_factor(i, j) > 0.0 && cosines[0].min(cosines[1]) > 1e-5;
                    assert!(!lit, "{at}: {i} {j} {cosines:?}");
                }
                for i in 0..n {
                    for (j, weight) in links.near.row(i) {
                        assert_eq!(weight, surface.form_factor(i, j), "{at}");
                    }
                }
                let expanded = links.m2l.iter().chain([&links.m2p, &links.p2l]);
                for (target, source) in expanded.flat_map(|rows| pairs(rows, &octree)) {
                    let largest = target.surfels().map(|i| below_horizon(&s, i, source));
                    let largest = largest.fold(0.0, f64::max);
                    assert!(largest <= 1.0001 * f64::from(tolerance), "{at}: {largest}");
                }
            }
        }
    }
}

/// How far the form factor with signed cosines is from that with clamped ones, which is that of
/// points out of the near range. Cosines that are rounding noise (1e-5) count as none.
fn below_horizon(s: &Surfels, i: usize, source: &Facet) -> f64 {
    let pair = |j: usize| {
        let way = (s.positions[j] - s.positions[i]).as_dvec3();
        let spacing = f64::from(s.areas[i].max(s.areas[j]).sqrt());
        assert!(way.length() >= 2.0 * spacing * (1.0 - 1e-5));
        let [u, v] = [s.normals[i], -s.normals[j]].map(|n| n.as_dvec3().dot(way) / way.length());
        let clamped = match u.min(v) < -1e-5 {
            true => u.max(0.0) * v.max(0.0),
            false => u * v,
        };
        f64::from(s.areas[j]) * (u * v - clamped) / (PI * way.length_squared())
    };
    source.surfels().map(pair).sum::<f64>().abs()
}

/// The largest radius of a facet's sphere that holds none of another facet's surfels, in units of
/// its own radius.
fn clearance(sphere: &Facet, others: &Facet, s: &Surfels) -> f32 {
    let places = s.positions[others.surfels()].iter();
    let nearest = places.fold(f32::INFINITY, |d, p| d.min(p.distance(sphere.centre)));
    nearest / sphere.radius
}

/// Whether the cubes of this level, or the smaller ones of the facets, touch; halves do not count.
fn touch(a: &Facet, b: &Facet, level: u32) -> bool {
    let cube = |f: &Facet| {
        let side = 1 << 21_u32.saturating_sub(level.min(f.cell.level));
        let low = f.cell.corner / side * side;
        (low.as_ivec3(), low.as_ivec3() + side as i32)
    };
    let (a, b) = (cube(a), cube(b));
    level <= 21 && (b.0 - a.1).max(a.0 - b.1).max_element() <= 0
}

#[test]
fn adaptive_lists_are_separated() {
    for (name, given) in clouds_of_all_kinds() {
        for leaf_size in [1, 5, 32] {
            let (octree, s) = Octree::build(&given, leaf_size);
            let at = format!("{name}, leaves of {leaf_size}");
            let [(_, links), _] = lists(&octree, &s, Cosines::Signed, 3);
            let cone = |f: &Facet| {
                octree
                    .cones
                    .iter()
                    .any(|&c| std::ptr::eq(&octree.facets[c as usize], f))
            };
            for (a, b) in links.m2l.iter().flat_map(|rows| pairs(rows, &octree)) {
                let opening = (a.radius + b.radius) / a.centre.distance(b.centre);
                assert!(opening <= 0.5 * 3f32.sqrt(), "{at}: {opening}");
                // At some level of both, their cells do not touch.
                let level = a.cell.level.min(b.cell.level);
                assert!(!touch(a, b, level), "{at}");
                // Their parents were not separated. (Cones have none.)
                if !cone(a) && !cone(b) {
                    let parent = |f: &Facet| &octree.facets[f.parent as usize];
                    let level = parent(a).cell.level.min(parent(b).cell.level);
                    let (p, q) = (parent(a), parent(b));
                    let opening = (p.radius + q.radius) / p.centre.distance(q.centre);
                    assert!(touch(p, q, level) || opening >= 0.866, "{at}: {opening}");
                }
            }
            for (target, source) in pairs(&links.m2p, &octree) {
                assert!(target.is_leaf(), "{at}");
                let finest = target.cell.level.max(source.cell.level);
                assert!(finest > 21 || !touch(target, source, finest), "{at}");
                assert!(clearance(source, target, &s) > 1.732, "{at}");
            }
            for (target, source) in pairs(&links.p2l, &octree) {
                assert!(source.is_leaf(), "{at}");
                let finest = target.cell.level.max(source.cell.level);
                assert!(finest > 21 || !touch(target, source, finest), "{at}");
                assert!(clearance(target, source, &s) > 1.732, "{at}");
            }
            for (target, source) in pairs(&links.p2p, &octree) {
                assert!(target.is_leaf() && source.is_leaf(), "{at}");
            }
        }
    }
}

#[test]
fn dual_lists_keep_to_the_opening() {
    let mut kinds = [0; 4];
    for (name, given) in clouds_of_all_kinds() {
        for (leaf_size, order) in [(1, 4), (5, 0), (32, 2), (32, 5)] {
            let (octree, s) = Octree::build(&given, leaf_size);
            let at = format!("{name}, leaves of {leaf_size}, order {order}");
            let [_, (_, links)] = lists(&octree, &s, Cosines::Signed, order);
            assert_eq!(links.m2l.len(), order + 1, "{at}");
            assert!(links.m2l.iter().take(order).all(Rows::is_empty), "{at}");
            let expanded = links.m2l.iter().chain([&links.m2p, &links.p2l]);
            for (a, b) in expanded.flat_map(|rows| pairs(rows, &octree)) {
                let opening = (a.radius + b.radius) / a.centre.distance(b.centre);
                assert!(opening <= 1.00001 * THETA, "{at}: {opening}");
                assert!(a.len() * b.len() > 1, "{at}: one surfel from one, expanded");
            }
            let m2l = links.m2l.iter().map(Rows::len).sum();
            for (count, list) in
                kinds
                    .iter_mut()
                    .zip([m2l, links.m2p.len(), links.p2l.len(), links.p2p.len()])
            {
                *count += list;
            }
        }
    }
    println!("m2l, m2p, p2l, p2p: {kinds:?}");
    assert!(kinds.iter().all(|&k| k > 0), "{kinds:?}");
}

// Bytes that stay: 8 a link and facet records. Measured, with leaves of 32: 31 dual, 55 adaptive.
#[test]
fn memory_is_a_fraction_of_the_surfels() {
    let rows = |r: &Rows| 4 * (r.offsets.len() + r.sources.len() + r.weights.len());
    let given = surfels(&cube(130, 0.5, true, 1));
    let (octree, s) = Octree::build(&given, 32);
    for (kind, links) in lists(&octree, &s, Cosines::Clamped { tolerance: 1e-4 }, 3) {
        let lists: usize = of_facets(&links).chain([&links.near]).map(rows).sum();
        let bytes = lists + size_of::<Facet>() * octree.facets.len();
        let each = bytes as f64 / s.len() as f64;
        println!("{kind}: {each:.0} bytes a surfel of {}", s.len());
        assert!(each < 100.0, "{kind}: {each}");
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let given = surfels(&sphere(12_000, 1.0, true, 1));
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("a pool").install(|| {
            let (octree, s) = Octree::build(&given, 8);
            lists(&octree, &s, Cosines::Clamped { tolerance: 1e-4 }, 3)
        })
    };
    let (one, four) = (run(1), run(4));
    assert_eq!(one, four);
    assert!(one.iter().all(|(_, links)| !links.near.is_empty()));
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 100,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]
    #[test]
    fn any_cloud_is_covered(
        points in prop::collection::vec(
            (prop::array::uniform3(-4i8..=4), prop::array::uniform3(-2i8..=2)),
            1..120,
        ),
        leaf_size in 1usize..10,
        order in 0usize..5,
        strays in prop::sample::select(vec![0.0, 1e2, 1e8]),
    ) {
        let points: Vec<_> = points
            .iter()
            .enumerate()
            .map(|(k, (p, n))| {
                let [p, n] = [p, n].map(|v| Vec3::from_array(v.map(f32::from)).as_dvec3());
                let stray = if k % 10 == 0 { strays } else { 0.0 };
                (p + DVec3::X * stray, n.try_normalize().unwrap_or(DVec3::Z))
            })
            .collect();
        let (octree, s) = Octree::build(&bare(points, 0.1), leaf_size);
        for (kind, links) in lists(&octree, &s, Cosines::Signed, order) {
            let count = coverage(&links, &octree, s.len(), |_, _| false);
            prop_assert!(count.iter().all(|&c| c == 1), "{}", kind);
        }
    }
}
