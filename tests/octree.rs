//! The octree of facets: a partition whose bounds hold.

mod clouds;

use clouds::*;
use fmmgi_gpu::Surfels;
use fmmgi_gpu::octree::{Cell, Facet, LEAF_SIZE, MAX_HALF_ANGLE, Octree};
use fmmgi_gpu::progress::Silent;
use glam::DVec3;
use proptest::prelude::*;

fn built(cloud: &fmmgi_gpu::PointCloud) -> (Octree, Surfels) {
    Octree::build(&surfels(cloud), LEAF_SIZE)
}

/// What holds for every octree.
fn check(octree: &Octree, s: &Surfels, given: &Surfels) {
    let facets = &octree.facets;
    // The surfels are the given ones in another order.
    let mut order = s.points.clone();
    order.sort_unstable();
    let mut all = given.points.clone();
    all.sort_unstable();
    assert_eq!(order, all);

    // Levels follow one another; the root is alone and its own parent.
    assert_eq!(octree.level(0), 0..1);
    assert_eq!(facets[0].surfels(), 0..s.len());
    assert_eq!(facets[0].parent, 0);
    assert_eq!(octree.level(octree.depth() - 1).end, facets.len());
    let mut next_child = 1;
    for level in 0..octree.depth() {
        let range = octree.level(level);
        assert!(!range.is_empty());
        for f in range.clone() {
            let facet = &facets[f];
            if level > 0 {
                assert!(octree.level(level - 1).contains(&(facet.parent as usize)));
            }
            // Children lie side by side on the next level and part the parent.
            if facet.is_leaf() {
                continue;
            }
            assert!(facet.child_count >= 2, "a facet with one child is no split");
            assert_eq!(facet.first_child, next_child);
            next_child += facet.child_count;
            let mut at = facet.begin;
            for c in facet.children() {
                let child = &facets[c as usize];
                assert_eq!((child.parent as usize, child.begin), (f, at));
                assert!(!child.is_empty());
                at = child.end;
            }
            assert_eq!(at, facet.end);
        }
    }
    assert_eq!(next_child as usize, facets.len());
    let mut covered = vec![0; s.len()];
    for leaf in facets.iter().filter(|f| f.is_leaf()) {
        leaf.surfels().for_each(|i| covered[i] += 1);
    }
    assert!(
        covered.iter().all(|&n| n == 1),
        "every surfel is in one leaf"
    );

    for facet in facets {
        check_bounds(facet, s);
    }
    check_cells(octree, s);
    // Splits by place begin below a facet whose normals keep to the cone.
    let narrow = |f: usize| f64::from(facets[f].spread) <= MAX_HALF_ANGLE.sin();
    for leaf in (0..facets.len()).filter(|&f| facets[f].is_leaf()) {
        let mut f = leaf;
        while !narrow(f) && f != 0 {
            f = facets[f].parent as usize;
        }
        assert!(narrow(f), "leaf {leaf} belongs to no cone");
    }
}

/// Bounds are measured in f64, for centre and axis as they are stored, and rounded up.
fn check_bounds(facet: &Facet, s: &Surfels) {
    let centre = facet.centre.as_dvec3();
    let axis = facet.axis.as_dvec3();
    assert!((axis.length() - 1.0).abs() < 1e-6);
    let [mut low, mut high] = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let (mut radius, mut slab, mut spread) = (0.0_f64, [f64::INFINITY, f64::NEG_INFINITY], 0.0_f64);
    let (mut area, mut spacing, mut reach) = (0.0, 0.0_f32, 0.0_f32);
    for i in facet.surfels() {
        let p = s.positions[i].as_dvec3();
        [low, high] = [low.min(p), high.max(p)];
        radius = radius.max(p.distance(centre));
        let height = axis.dot(p - centre);
        slab = [slab[0].min(height), slab[1].max(height)];
        let n = s.normals[i].as_dvec3();
        spread = spread.max(if axis.dot(n) > 0.0 {
            axis.cross(n).length().min(1.0)
        } else {
            1.0
        });
        area += f64::from(s.areas[i]);
        spacing = spacing.max(s.areas[i].sqrt());
        let corners = s.cells.corners[i].iter();
        reach = corners.fold(reach, |reach, c| reach.max(c.length()));
    }
    assert_eq!((facet.low, facet.high), (low.as_vec3(), high.as_vec3()));
    // They hold, and are no larger than the next f32 (in f64 to a few units in the last place).
    let bounds = |f: f32, exact: f64| {
        let slack = 1e-15 * exact.abs();
        f64::from(f) >= exact - slack && f64::from(f.next_down()) <= exact + slack
    };
    assert!(bounds(facet.radius, radius), "{} {radius}", facet.radius);
    assert!(bounds(facet.spread, spread), "{} {spread}", facet.spread);
    let slack = 1e-15 * radius;
    assert!(f64::from(facet.slab[0]) <= slab[0] + slack);
    assert!(f64::from(facet.slab[1]) >= slab[1] - slack);
    // Normals are of unit length to f32 only.
    assert!(
        facet
            .slab
            .iter()
            .all(|h| h.abs() <= 1.000001 * facet.radius)
    );
    assert!((f64::from(facet.area) / area - 1.0).abs() < 1e-6);
    assert_eq!(facet.spacing, spacing);
    assert!((facet.reach / reach - 1.0).abs() < 1e-6);
    assert!(facet.spread <= 1.0 && facet.radius >= 0.0 && facet.scale() > 0.0);
}

/// Cubes of facets: common above the cones, below them octants, each in its parent's.
fn check_cells(octree: &Octree, s: &Surfels) {
    let facets = &octree.facets;
    let [low, high] = [facets[0].low, facets[0].high];
    let finest = f64::from((high - low).max_element()) / f64::from(1 << 21);
    for facet in facets {
        let side = f64::from(1 << 21_u32.saturating_sub(facet.cell.level));
        let corner = facet.cell.corner.as_dvec3();
        for i in facet.surfels() {
            let place = (s.positions[i] - low).as_dvec3() / finest.max(f64::MIN_POSITIVE) - corner;
            assert!(place.min_element() > -1e-3 && place.max_element() < side + 1e-3);
        }
    }
    let mut below_cone = vec![false; facets.len()];
    for &c in &octree.cones {
        below_cone[c as usize] = true;
    }
    assert!(octree.cones.is_sorted());
    let surfels: usize = octree.cones.iter().map(|&c| facets[c as usize].len()).sum();
    assert_eq!(surfels, facets[0].len(), "cones part the surfels");
    for (f, facet) in facets.iter().enumerate() {
        let cell = facet.cell;
        if !below_cone[f] {
            assert_eq!(cell, Cell::default());
            continue;
        }
        let children = &facets[facet.first_child as usize..][..facet.child_count as usize];
        for (k, child) in children.iter().enumerate() {
            below_cone[facet.first_child as usize + k] = true;
            assert!(child.cell.level > cell.level);
            assert_eq!(child.cell.ancestor(cell.level), cell);
            assert!(!child.is_leaf() || child.cell.level == cell.level + 1);
            // Octants touch, and are not the same; halves are.
            let octants = children.iter().map(|c| c.cell.ancestor(cell.level + 1));
            let same = octants.filter(|&c| c == child.cell.ancestor(cell.level + 1));
            let halves = cell.level >= 21;
            assert_eq!(same.count(), if halves { children.len() } else { 1 });
            assert!(cell.touches(child.cell) == (cell.level <= 21));
        }
    }
}

#[test]
fn facets_part_and_bound_their_surfels() {
    for (name, cloud) in [
        ("room", cube(15, 0.5, true, 1)),
        (
            "turned room",
            moved(&cube(15, 0.5, true, 1), rotation(1), 1.0, DVec3::ZERO),
        ),
        ("sphere", sphere(3000, 1.0, true, 1)),
        (
            "small sphere",
            moved(&sphere(500, 1.0, true, 1), rotation(2), 1e-4, DVec3::ZERO),
        ),
        (
            "far sphere",
            moved(
                &sphere(500, 1.0, false, 1),
                rotation(3),
                1e4,
                DVec3::splat(1e6),
            ),
        ),
        ("random normals", {
            let mut rng = random(1);
            cloud((0..1000).map(|_| (direction(&mut rng), direction(&mut rng))))
        }),
        ("plane", quad(DVec3::ZERO, DVec3::X, DVec3::Y, 30, 1.0, 1)),
    ] {
        println!("{name}");
        let given = surfels(&cloud);
        let (octree, s) = Octree::build(&given, LEAF_SIZE);
        check(&octree, &s, &given);
        let largest = octree
            .facets
            .iter()
            .filter(|f| f.is_leaf())
            .map(Facet::len)
            .max();
        assert!(largest <= Some(LEAF_SIZE), "{largest:?}");
        // A facet that is large enough to be worth its links: leaves are not all singletons.
        let leaves = octree.facets.iter().filter(|f| f.is_leaf()).count();
        assert!(leaves * 3 < s.len() * 2, "{leaves} leaves");
    }
}

#[test]
fn equal_normals_have_no_spread() {
    // Whatever the rounding of a normal's length: links decide by the spread whether two parts of
    // one wall can see each other.
    for seed in 0..20 {
        let cloud = moved(
            &quad(DVec3::ZERO, DVec3::X, DVec3::Y, 6, 0.5, 1),
            rotation(seed),
            1.0,
            DVec3::ZERO,
        );
        let (octree, _) = built(&cloud);
        for f in &octree.facets {
            assert!(f.spread < 1e-6, "{}", f.spread);
        }
    }
}

/// Leaves of one part follow a space-filling curve: neighbours in order are neighbours in space.
/// Along a Morton curve on a plane the mean step is about 1.6 spacings; in no order it would be half
/// the square.
#[test]
fn order_keeps_neighbours_together() {
    let (_, s) = built(&quad(DVec3::ZERO, DVec3::X, DVec3::Y, 64, 0.5, 1));
    let steps: f32 = s.positions.windows(2).map(|p| p[0].distance(p[1])).sum();
    let mean = 64.0 * steps / (s.len() - 1) as f32;
    assert!((1.0..2.5).contains(&mean), "{mean}");
}

#[test]
fn degenerate_clouds() {
    let line = |k: usize, n: DVec3| cloud((0..k).map(|i| (DVec3::X * (i * i) as f64, n)));
    let mut one = cloud([(DVec3::ONE, DVec3::Z)]);
    one.areas = vec![2.0];
    // A dense clump and a point so far away that the clump is one cell of the finest level.
    let clump = quad(DVec3::ZERO, DVec3::X * 1e-6, DVec3::Y * 1e-6, 10, 1.0, 1);
    let far = cloud([(DVec3::splat(10.0), DVec3::Z)]);
    let back_to_back = {
        let front = quad(DVec3::ZERO, DVec3::X, DVec3::Y, 10, 0.5, 1);
        let mut back = front.clone();
        back.normals.iter_mut().for_each(|n| *n = -*n);
        joined([front, back])
    };
    for (name, cloud) in [
        ("one point", one),
        ("two points", line(2, DVec3::Z)),
        ("a line", line(40, DVec3::Z)),
        ("a line along its normals", line(40, DVec3::X)),
        ("clump", joined([clump, far])),
        ("sheet", back_to_back),
    ] {
        println!("{name}");
        let given = surfels(&cloud);
        let (octree, s) = Octree::build(&given, LEAF_SIZE);
        check(&octree, &s, &given);
    }
}

/// What a facet says, without where it lies in the arrays.
fn content(f: &Facet, s: &Surfels) -> (Vec<u32>, Vec<u32>) {
    let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let mut members: Vec<u32> = f
        .surfels()
        .flat_map(|i| bits(&s.positions[i].to_array()))
        .collect();
    members.sort_unstable();
    let low = f.low.to_array();
    let high = f.high.to_array();
    (members, bits(&[low, high].concat()))
}

#[test]
fn the_order_of_points_does_not_matter() {
    for cloud in [cube(10, 0.5, true, 1), sphere(2000, 0.5, true, 1)] {
        let order = shuffled(cloud.len(), 3);
        let (a, sa) = built(&cloud);
        let (b, sb) = built(&permuted(&cloud, &order));
        assert_eq!(a.levels, b.levels);
        for (f, g) in a.facets.iter().zip(&b.facets) {
            assert_eq!(content(f, &sa), content(g, &sb));
            // Sums in another order round differently.
            assert!(f.centre.distance(g.centre) < 1e-6);
        }
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let cloud = sphere(5000, 1.0, true, 1);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let (octree, s) = pool.expect("a pool").install(|| built(&cloud));
        (format!("{octree:?}"), format!("{s:?}"))
    };
    assert_eq!(run(1), run(4));
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 150,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]
    #[test]
    fn any_cloud_has_a_sound_octree(
        points in prop::collection::vec(
            (prop::array::uniform3(-3i8..=3), prop::array::uniform3(-2i8..=2)),
            2..150,
        ),
        scale in prop::sample::select(vec![1e-6, 1.0, 1e6]),
    ) {
        let cloud = cloud(points.iter().map(|(p, n)| {
            let [p, n] = [p, n].map(|v| DVec3::from_array(v.map(f64::from)));
            (p * scale, n)
        }));
        if let Ok(prepared) = Surfels::prepare(&cloud, &Silent) {
            let (octree, s) = Octree::build(&prepared.surfels, LEAF_SIZE);
            check(&octree, &s, &prepared.surfels);
        }
    }
}
