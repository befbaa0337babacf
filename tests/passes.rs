//! The passes on whole trees: links of every kind and order between two patches that face each
//! other, against sums over all pairs.

mod clouds;
mod clusters;

use clouds::*;
use clusters::difference;
use fmmgi_gpu::Surfels;
use fmmgi_gpu::expansion::{Surface, expected_error};
use fmmgi_gpu::links::{Entry, Links, Rows};
use fmmgi_gpu::math::Real;
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::operator::{Fields, Fmm, TransportOperator};
use glam::DVec3;
use rand::RngExt;

/// Two bumpy patches of 15 by 15 surfels each, half as wide as their distance of 1; `tilt` in
/// radians turns normals at random.
fn patches(tilt: f64) -> Surfels {
    let mut rng = random(1);
    let mut points = Vec::new();
    for (z, side) in [(0.0, 1.0), (1.0, -1.0)] {
        for k in 0..225 {
            let at = |i: usize| (i as f64 / 14.0 - 0.5) * 0.35;
            let (x, y) = (at(k % 15), at(k / 15));
            let bump = 0.05 * (9.0 * x).sin() * (7.0 * y).cos();
            let normal = DVec3::Z + 0.2 * direction(&mut rng);
            let turn =
                glam::DQuat::from_axis_angle(direction(&mut rng), tilt * rng.random::<f64>());
            points.push((DVec3::new(x, y, z + bump), turn * normal.normalize() * side));
        }
    }
    surfels(&cloud(points))
}

fn colours(n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = random(seed);
    (0..n)
        .map(|_| DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.2..1.0))))
        .collect()
}

/// Which kind of link leads to a facet.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    M2l(usize),
    M2p,
    P2l,
}

/// Entries from the facets of the one patch to those of the other, both ways; the kinds take turns.
/// `depth` is how far below the patches' own facets the targets are.
fn links(octree: &Octree, surfels: &Surfels, order: usize, depth: usize, kinds: &[Kind]) -> Links {
    let facets = &octree.facets;
    let below = |f: u32| {
        let mut level = vec![f];
        for _ in 0..depth {
            let inner = |&f: &u32| match facets[f as usize].is_leaf() {
                true => vec![f],
                false => facets[f as usize].children().collect(),
            };
            level = level.iter().flat_map(inner).collect();
        }
        level
    };
    let patches: Vec<u32> = facets[0].children().collect();
    assert_eq!(patches.len(), 2, "one facet each");
    let mut m2l = vec![Vec::new(); order + 1];
    let (mut m2p, mut p2l) = (Vec::new(), Vec::new());
    let mut count = 0;
    for (a, b) in [(patches[0], patches[1]), (patches[1], patches[0])] {
        for target in below(a) {
            for source in facets[b as usize].children() {
                let entry = Entry {
                    target,
                    source,
                    weight: 0.75,
                };
                match kinds[count % kinds.len()] {
                    Kind::M2l(p) => m2l[p].push(entry),
                    Kind::M2p => m2p.push(entry),
                    Kind::P2l => p2l.push(entry),
                }
                count += 1;
            }
        }
    }
    let rows = |entries| Rows::new(facets.len(), entries);
    Links {
        m2l: m2l.into_iter().map(rows).collect(),
        m2p: rows(m2p),
        p2l: rows(p2l),
        ..Links::none(facets.len(), surfels.len())
    }
}

fn apply<T: Real>(
    surfels: &Surfels,
    octree: &Octree,
    links: &Links,
    radiosity: &[DVec3],
) -> Vec<DVec3> {
    let operator = Fmm::<T>::new(surfels, octree, links);
    let field = operator.fields().upload(radiosity).unwrap();
    operator
        .fields()
        .download(&operator.apply(&field).unwrap())
        .unwrap()
}

/// Three quarters of the light between the patches.
fn exact(surfels: &Surfels, radiosity: &[DVec3]) -> Vec<DVec3> {
    let s = Surface::<f64>::new(surfels);
    let middle = surfels.positions.iter().map(|p| p.z).sum::<f32>() / s.len() as f32;
    let upper = |i: usize| surfels.positions[i].z > middle;
    let light = |i: usize| {
        let others = (0..s.len()).filter(|&j| upper(i) != upper(j));
        others
            .map(|j| radiosity[j] * (0.75 * s.point_form_factor(i, j)))
            .sum()
    };
    (0..s.len()).map(light).collect()
}

/// Every kind of link, alone and mixed, to leaves and to inner facets: the error falls with the
/// order as its bound does.
#[test]
fn links_of_every_kind_bring_the_same_light() {
    let surfels = patches(0.0);
    let (octree, surfels) = Octree::build(&surfels, 6);
    let radiosity = colours(surfels.len(), 2);
    let wanted = exact(&surfels, &radiosity);
    // Radii of sources (children of a patch) are up to 0.18, of targets as given.
    for (depth, radius) in [(0, 0.25), (1, 0.18), (9, 0.05)] {
        for order in [1, 3, 6] {
            let m2l = [Kind::M2l(order)];
            let mixed = [Kind::M2l(order), Kind::M2p, Kind::P2l, Kind::M2p];
            for kinds in [&m2l[..], &[Kind::M2p], &[Kind::P2l], &mixed] {
                let links = links(&octree, &surfels, order, depth, kinds);
                let found = apply::<f64>(&surfels, &octree, &links, &radiosity);
                let off = difference(&found, &wanted);
                println!("{depth} {order} {kinds:?}: {off:.1e}");
                assert!(
                    off < expected_error(order, 0.18, radius),
                    "{depth} {order} {kinds:?}: {off}"
                );
                let narrow = apply::<f32>(&surfels, &octree, &links, &radiosity);
                let rounding = difference(&narrow, &found);
                assert!(rounding < 1e-6, "{depth} {order} {kinds:?}: {rounding:e}");
            }
        }
    }
}

/// Orders differ from link to link: each brings what it brings alone.
#[test]
fn orders_add_up() {
    let surfels = patches(0.0);
    let (octree, surfels) = Octree::build(&surfels, 6);
    let radiosity = colours(surfels.len(), 3);
    let kinds = [0, 1, 2, 3, 6].map(Kind::M2l);
    let mixed = links(&octree, &surfels, 6, 2, &kinds);
    let mut sum = vec![DVec3::ZERO; surfels.len()];
    for order in 0..=6 {
        // The lists up to this order, of which the last alone has links.
        let mut alone = Links::none(octree.facets.len(), surfels.len());
        alone.m2l = vec![Rows::none(octree.facets.len()); order];
        alone.m2l.push(mixed.m2l[order].clone());
        for (sum, h) in sum
            .iter_mut()
            .zip(apply::<f64>(&surfels, &octree, &alone, &radiosity))
        {
            *sum += h;
        }
    }
    let found = apply::<f64>(&surfels, &octree, &mixed, &radiosity);
    assert!(difference(&found, &sum) < 1e-14);
}

/// A surfel that turns away from the source's centre gets nothing by M2P, one that turns away from
/// the target's centre gives nothing by P2L; both whatever the light is, so that they stay linear.
#[test]
fn what_turns_away_is_left_out() {
    let surfels = patches(0.0);
    let (octree, mut surfels) = Octree::build(&surfels, 6);
    let facets = &octree.facets;
    let turned = |i: usize| i.is_multiple_of(5);
    for i in (0..surfels.len()).filter(|&i| turned(i)) {
        surfels.normals[i] = -surfels.normals[i];
    }
    let n = surfels.len();
    let radiosity = colours(n, 4);
    let [m2p, p2l] = [Kind::M2p, Kind::P2l].map(|k| links(&octree, &surfels, 6, 0, &[k]));

    let found = apply::<f64>(&surfels, &octree, &m2p, &radiosity);
    for i in 0..n {
        assert_eq!(found[i] == DVec3::ZERO, turned(i), "M2P {i}");
    }
    // Those that turn away could as well be dark.
    let mut dark = radiosity.clone();
    (0..n)
        .filter(|&i| turned(i))
        .for_each(|i| dark[i] = DVec3::ZERO);
    let all = apply::<f64>(&surfels, &octree, &p2l, &radiosity);
    assert_eq!(all, apply::<f64>(&surfels, &octree, &p2l, &dark));
    assert!(facets.iter().any(|f| f.is_leaf() && f.len() > 1));

    for links in [&m2p, &p2l] {
        let (x, y) = (colours(n, 5), colours(n, 6));
        let sum: Vec<DVec3> = x.iter().zip(&y).map(|(x, y)| *x - *y * 3.0).collect();
        let [a, b, both] = [&x, &y, &sum].map(|f| apply::<f64>(&surfels, &octree, links, f));
        let wanted: Vec<DVec3> = a.iter().zip(&b).map(|(a, b)| *a - *b * 3.0).collect();
        assert!(difference(&both, &wanted) < 1e-13);
    }
}

#[test]
fn threads_change_nothing() {
    let surfels = patches(0.3);
    let (octree, surfels) = Octree::build(&surfels, 4);
    let radiosity = colours(surfels.len(), 7);
    let links = links(
        &octree,
        &surfels,
        3,
        3,
        &[Kind::M2l(3), Kind::M2p, Kind::P2l, Kind::M2l(1)],
    );
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| apply::<f32>(&surfels, &octree, &links, &radiosity))
    };
    assert_eq!(run(1), run(3));
}

/// Light does not depend on the unit of the scan nor on where it lies on the map, also with leaves
/// of one surfel, which have no radius.
#[test]
fn units_and_offsets_change_nothing() {
    let light = |unit: f64, shift: DVec3| {
        let mut rng = random(8);
        let mut points = Vec::new();
        for (z, side) in [(-0.5, 1.0), (0.5, -1.0)] {
            for _ in 0..200 {
                let [x, y] = [(); 2].map(|_| rng.random_range(-0.2..0.2));
                points.push((DVec3::new(x, y, z) * unit + shift, DVec3::Z * side));
            }
        }
        let mut cloud = cloud(points);
        cloud.areas = vec![(1e-4 * unit * unit) as f32; 400];
        let (octree, surfels) = Octree::build(&surfels(&cloud), 1);
        let links = links(
            &octree,
            &surfels,
            6,
            9,
            &[Kind::M2l(6), Kind::M2p, Kind::P2l],
        );
        let radiosity = vec![DVec3::ONE; surfels.len()];
        let sorted = apply::<f32>(&surfels, &octree, &links, &radiosity);
        let mut found = vec![DVec3::ZERO; 400];
        for (h, &p) in sorted.iter().zip(&surfels.points) {
            found[p as usize] = *h;
        }
        found
    };
    let wanted = light(1.0, DVec3::ZERO);
    let map = DVec3::new(4e5, 5.4e6, 300.0);
    for (unit, shift) in [
        (1e-7, DVec3::ZERO),
        (1e-4, DVec3::ZERO),
        (1e5, DVec3::ZERO),
        (1.0, map),
        (30.0, map),
    ] {
        let off = difference(&light(unit, shift), &wanted);
        println!("{unit} {shift}: {off:.1e}");
        // Measured: 3e-7.
        assert!(off < 2e-6, "{unit} {shift}: {off:e}");
    }
}
