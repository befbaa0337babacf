//! Below the methods: orders of the expansions and sizes of the leaves, at any unit of length.

use fmmgi_gpu::expansion::expected_error;
use fmmgi_gpu::links::{self, Accuracy, Cosines, Links, Mac, THETA};
use fmmgi_gpu::math::Real;
use fmmgi_gpu::octree::Octree;
use fmmgi_gpu::operator::{Direct, Fields, Fmm, GpuFmm, TransportOperator};
use fmmgi_gpu::passes::gpu;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::visibility::{CpuVisibility, NothingInTheWay, Occluders, Visibility};
use fmmgi_gpu::{PointCloud, Surfels};
use glam::{DQuat, DVec3};
use rand::RngExt;

use crate::clouds::{cloud, direction, joined, moved, random, sphere, surfels};
use crate::common::gpu;

/// Of f32, over a thousand summands.
const ROUNDING: f64 = 2e-6;

/// A cloud in its octree, the light that it sends and what arrives of it by exact sums.
struct Sent {
    octree: Octree,
    surfels: Surfels,
    radiosity: Vec<DVec3>,
    exact: Vec<DVec3>,
}

impl Sent {
    fn new(cloud: &PointCloud, leaf_size: usize, open: bool) -> Sent {
        let (octree, surfels) = Octree::build(&surfels(cloud), leaf_size);
        let mut rng = random(1);
        let mut colour = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(0.5..1.5)));
        let radiosity: Vec<DVec3> = (0..surfels.len()).map(|_| colour()).collect();
        let occluders = Occluders::build(&surfels);
        let tested = CpuVisibility::<f64>::new(&occluders);
        let visibility: &dyn Visibility = if open { &NothingInTheWay } else { &tested };
        let exact = Direct::new(&surfels, visibility, &Silent).unwrap();
        let exact = exact.apply(&radiosity).unwrap();
        Sent {
            octree,
            surfels,
            radiosity,
            exact,
        }
    }

    fn error<O: TransportOperator>(&self, operator: &O) -> f64 {
        let fields = operator.fields();
        let sent = fields.upload(&self.radiosity).unwrap();
        let found = fields.download(&operator.apply(&sent).unwrap()).unwrap();
        let (error, whole) = found
            .iter()
            .zip(&self.exact)
            .fold((0.0, 0.0), |(e, n), (a, b)| {
                (e + (*a - *b).length_squared(), n + b.length_squared())
            });
        (error / whole).sqrt()
    }

    fn on_cpu<T: Real>(&self, links: &Links) -> f64 {
        self.error(&Fmm::<T>::new(&self.surfels, &self.octree, links))
    }

    fn on_device(&self, links: &Links) -> f64 {
        self.error(&GpuFmm::new(gpu(), &self.surfels, &self.octree, links).unwrap())
    }

    fn dual(&self, order: usize) -> Links {
        let mac = Mac {
            theta: THETA,
            order,
            cosines: Cosines::Clamped { tolerance: 0.0 },
        };
        let facets = &self.octree.facets;
        let judge = |t: u32, s: u32| mac.judge(&facets[t as usize], &facets[s as usize]);
        links::dual(&self.octree, &self.surfels, order, judge, &Silent).unwrap()
    }

    /// As the fmm method links it, with what may be in the way.
    fn linked(&self, error: f32, open: bool) -> Links {
        let facets = self.octree.facets.len();
        let accuracy = Accuracy {
            order: if open { 6 } else { 1 },
            error,
            radiosity: vec![1.5; facets],
            target_factor: vec![1.0; facets],
            seed: 1,
        };
        match open {
            true => links::build_open(&self.surfels, &self.octree, &accuracy, &Silent).unwrap(),
            false => {
                let occluders = Occluders::build(&self.surfels);
                let visibility = CpuVisibility::<f32>::new(&occluders);
                links::build(&self.surfels, &self.octree, &accuracy, &visibility, &Silent).unwrap()
            }
        }
    }
}

/// Two spheres seen from outside, and clutter between them.
fn clutter(n: usize) -> PointCloud {
    let mut rng = random(3);
    let ball = sphere(n, 0.3, false, 1);
    let shift = |c: &PointCloud, x: f64| moved(c, DQuat::IDENTITY, 1.0, DVec3::X * x);
    let loose = cloud((0..n).map(|_| {
        let place = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        (place + DVec3::Z * 2.5, direction(&mut rng))
    }));
    joined([shift(&ball, -1.5), shift(&ball, 1.5), loose])
}

/// Relative L2 errors of one application in f64, in f32 and on a device, which has no high orders.
type Row = (String, [Option<f64>; 3]);

/// The dual traversal with expansions of each order, in three units of length.
fn orders() -> Vec<(usize, Row)> {
    let base = clutter(3000);
    let mut rows = Vec::new();
    for unit in [1e-6, 1.0, 1e6] {
        let sent = Sent::new(&moved(&base, DQuat::IDENTITY, unit, DVec3::ZERO), 64, true);
        for order in 0..=12 {
            let links = sent.dual(order);
            let errors = [
                Some(sent.on_cpu::<f64>(&links)),
                Some(sent.on_cpu::<f32>(&links)),
                (order <= gpu::MAX_ORDER).then(|| sent.on_device(&links)),
            ];
            rows.push((
                order,
                (format!("order {order}, lengths times {unit:e}"), errors),
            ));
        }
    }
    rows
}

/// Links as the fmm method makes them for an error of 1%, over leaves of all sizes, down to one point a leaf
/// and up to one leaf.
fn leaves() -> Vec<Row> {
    let base = clutter(300);
    let mut rows = Vec::new();
    for size in [1, 2, 8, 32, 200, 100_000] {
        for open in [true, false] {
            let sent = Sent::new(&base, size, open);
            let links = sent.linked(0.01, open);
            let errors = [
                Some(sent.on_cpu::<f64>(&links)),
                Some(sent.on_cpu::<f32>(&links)),
                Some(sent.on_device(&links)),
            ];
            let occlusion = if open { "without" } else { "with" };
            rows.push((format!("leaves of {size}, {occlusion} occlusion"), errors));
        }
    }
    rows
}

/// What the page says of them.
pub fn table() -> String {
    let mut table = String::from(
        "\n## Orders and leaves\n\nTwo spheres beside a cloud of clutter: relative L2 error of one application \
         against exact sums. At high orders no expansion of so few points is cheaper than their sum.\n\n| links | f64 | f32 | device |\n|---|---|---|---|",
    );
    for (name, errors) in orders().into_iter().map(|(_, row)| row).chain(leaves()) {
        let [double, single, device] =
            errors.map(|e| e.map_or(String::new(), |e| format!("{e:.1e}")));
        println!("{name}: f64 {double}, f32 {single}, device {device}");
        table += &format!("\n| {name} | {double} | {single} | {device} |");
    }
    table + "\n"
}

/// Up to the sixth, each order has less than half the error of the one before (measured: a third at most), in
/// all units.
#[test]
fn all_orders_in_all_units() {
    let rows = orders();
    for [(_, (_, before)), (order, (name, errors))] in rows.array_windows() {
        let fell = before
            .iter()
            .zip(errors)
            .all(|(a, b)| *b < a.map(|a| 0.5 * a));
        assert!(!(1..=6).contains(order) || fell, "{name}: {errors:?}");
    }
    for (order, (name, errors)) in rows {
        println!("{name}: {errors:?}");
        let opening = 0.5 * f64::from(THETA);
        let expected = expected_error(order, opening, opening);
        for error in errors.into_iter().flatten() {
            assert!(error <= 0.4 * expected + ROUNDING, "{name}: {error:.1e}");
        }
    }
}

/// Each link may be off by 1% of the light, and many are. (Measured: at most 1.2% without occlusion, 3.3%
/// with it.)
#[test]
fn one_point_a_leaf_to_one_leaf() {
    for (name, errors) in leaves() {
        println!("{name}: {errors:?}");
        let most = if name.contains("without") { 0.02 } else { 0.05 };
        let found = errors.into_iter().flatten();
        assert!(found.clone().all(|e| e < most), "{name}: {errors:?}");
    }
}
