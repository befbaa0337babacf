//! Physical checks: next to nothing to find in a good operator, and each fault in the check that is
//! meant for it.

mod clouds;

use clouds::{cube, permuted, sphere, surfels};
use fmmgi_gpu::illuminate::checks::{Bounce, Checks, check};
use fmmgi_gpu::illuminate::stats::RowSum;
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Direct, HostFields, TransportOperator};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::visibility::{CpuVisibility, NothingInTheWay, Occluders, Visibility};
use fmmgi_gpu::{
    Backend, Illumination, Method, Occlusion, Options, PointCloud, Result, Scene, Surfels,
    illuminate,
};
use glam::DVec3;

/// What goes wrong: radiosity, and irradiance to spoil.
type Fault = fn(&[DVec3], &mut [DVec3]);

struct Faulty<'a> {
    good: &'a Direct,
    fault: Fault,
}

impl TransportOperator for Faulty<'_> {
    type Fields = HostFields<f64>;

    fn fields(&self) -> &HostFields<f64> {
        self.good.fields()
    }

    fn apply(&self, radiosity: &Vec<DVec3>) -> Result<Vec<DVec3>> {
        let mut irradiance = self.good.apply(radiosity)?;
        (self.fault)(radiosity, &mut irradiance);
        Ok(irradiance)
    }
}

fn checked(
    operator: &Direct,
    surfels: &Surfels,
    visibility: &dyn Visibility,
    fault: Fault,
) -> (RowSum, Checks) {
    let operator = Faulty {
        good: operator,
        fault,
    };
    // Light that is strong on one side.
    let radiosity: Vec<DVec3> = surfels
        .positions
        .iter()
        .map(|p| DVec3::new(2.0, 1.0, 0.5) * f64::from(2.0 + p.x).max(0.1))
        .collect();
    let last = Bounce {
        irradiance: &operator.apply(&radiosity).unwrap(),
        radiosity: &radiosity,
    };
    let found = check(&operator, surfels, &last, visibility, 1, &Silent).unwrap();
    (found.row_sum, found.checks)
}

fn none(_: &[DVec3], _: &mut [DVec3]) {}

/// Surfels in the octree's order with what tests their visibility, handed to `test`.
fn with(cloud: &PointCloud, test: impl FnOnce(&Direct, &Surfels, &dyn Visibility)) {
    let (_, surfels) = Octree::build(&surfels(cloud), LEAF_SIZE);
    let occluders = Occluders::build(&surfels);
    let visibility = CpuVisibility::<f64>::new(&occluders);
    let operator = Direct::new(&surfels, &visibility, &Silent).unwrap();
    test(&operator, &surfels, &visibility);
}

#[test]
fn a_good_operator_has_little_to_find() {
    let room = cube(12, 0.5, true, 1);
    let ceiling = |i: &usize| room.normals[*i].z < -0.5;
    let rest: Vec<usize> = (0..room.len()).filter(|i| !ceiling(i)).collect();
    let open = permuted(&room, &rest);
    for (name, cloud) in [
        ("sphere", sphere(1000, 0.3, true, 1)),
        ("cube", room),
        ("open cube", open),
    ] {
        with(&cloud, |operator, surfels, visibility| {
            let (row_sum, checks) = checked(operator, surfels, visibility, none);
            println!("{name}: {row_sum:?} {checks:?}");
            // Measured: 0.9939 to 1.0016; 0.935 beside the opening, of a hundred directions.
            let both = checks.row_sum_and_sky.unwrap();
            assert!((both.mean - 1.0).abs() < 0.01, "{name}: {both:?}");
            assert!((both.worst - 1.0).abs() < 0.1, "{name}: {both:?}");
            assert!(checks.least >= 0.0, "{name}: {checks:?}");
            // Up to 0.0017 and 0.006: the form factors of near cells, and the few points.
            assert!(checks.reciprocity < 4e-3, "{name}: {checks:?}");
            assert!(checks.energy.unwrap().abs() < 0.01, "{name}: {checks:?}");
            // Its own rows, in f32.
            assert!(checks.excess < 1e-5, "{name}: {checks:?}");
        });
    }
}

/// All the power is in one surfel, which looks for the sky again and again, in new directions.
#[test]
fn one_sender_has_its_balance() {
    let room = cube(6, 0.5, true, 4);
    let ceiling = |i: &usize| room.normals[*i].z < -0.5;
    let rest: Vec<usize> = (0..room.len()).filter(|i| !ceiling(i)).collect();
    with(&permuted(&room, &rest), |operator, surfels, visibility| {
        let mut radiosity = vec![DVec3::ZERO; surfels.len()];
        radiosity[90] = DVec3::ONE;
        let last = Bounce {
            irradiance: &operator.apply(&radiosity).unwrap(),
            radiosity: &radiosity,
        };
        let energy = |seed| {
            let found = check(operator, surfels, &last, visibility, seed, &Silent).unwrap();
            found.checks.energy.unwrap()
        };
        // Its own column is off by 0.15, with so few points; what escapes is known from 9,216
        // directions, to 0.005.
        let [a, b, c] = [1, 2, 3].map(energy);
        println!("one sender: {a:+.4} {b:+.4} {c:+.4}");
        assert!((a - b).abs() < 0.02 && (b - c).abs() < 0.02);
    });
}

#[test]
fn each_fault_shows_in_its_check() {
    with(
        &sphere(1000, 0.3, true, 2),
        |operator, surfels, visibility| {
            let of = |fault| {
                let (row_sum, checks) = checked(operator, surfels, visibility, fault);
                println!("{row_sum:?} {checks:?}");
                (row_sum, checks)
            };
            let (good_sum, good) = of(none);
            // One entry is -2 instead of next to nothing.
            let (_, negative) = of(|b, h| h[3] -= 2.0 * b[700]);
            assert!(good.least > 0.5 && negative.least < -0.5);
            // A tenth of all light is lost.
            let (sum, lossy) = of(|_, h| h.iter_mut().for_each(|h| *h *= 0.9));
            let both = [good, lossy].map(|c| c.row_sum_and_sky.unwrap());
            assert!((sum.mean - 0.9 * good_sum.mean).abs() < 1e-6);
            assert!((both[1].mean - 0.9 * both[0].mean).abs() < 1e-6);
            assert!((both[1].worst - 1.0).abs() > 0.1);
            let lost = good.energy.unwrap() - lossy.energy.unwrap();
            assert!((lost - 0.1).abs() < 2e-3, "{lost}");
            // A tenth is added: more than there would be with nothing in the way.
            let (_, bright) = of(|_, h| h.iter_mut().for_each(|h| *h *= 1.1));
            assert!((bright.excess - 0.1).abs() < 0.02 && good.excess < 1e-5);
            assert!(bright.energy.unwrap() > 0.09);
            // One half gets twice what it should, and does not give it back.
            let (_, one_way) = of(|_, h| h[..500].iter_mut().for_each(|h| *h *= 2.0));
            assert!(one_way.reciprocity > 0.02 && good.reciprocity < 1e-4);
            // A few surfels get no light: the mean hardly tells.
            let (_, blind) = of(|_, h| h[..12].fill(DVec3::ZERO));
            let worst = blind.row_sum_and_sky.unwrap().worst;
            assert!(worst < 0.01, "{worst}");
        },
    );
}

#[test]
fn without_occlusion_there_is_no_sky() {
    with(&cube(8, 0.5, true, 3), |operator, surfels, _| {
        let (_, checks) = checked(operator, surfels, &NothingInTheWay, none);
        assert!(checks.row_sum_and_sky.is_none() && checks.energy.is_none());
        assert!(checks.excess < 1e-5 && checks.least >= 0.0);
    });
}

fn illuminated(name: &str, points: usize, method: Method) -> Illumination {
    let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    let options = SceneOptions {
        points: Some(points),
        seed: 1,
        ..SceneOptions::default()
    };
    let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
    let options = Options {
        method,
        occlusion: Occlusion::Surfels,
        ..Options::default()
    };
    illuminate(&scene, &options, Backend::Cpu, &Silent).unwrap()
}

/// A closed sphere, and a room with an opening.
#[test]
fn the_stats_tell_of_the_checks() {
    for (scene, method, points) in [
        ("furnace", Method::Fmm, 3000),
        ("cornell", Method::Fmm, 3000),
        ("cornell", Method::Direct, 2000),
    ] {
        let lit = illuminated(scene, points, method);
        let checks = lit.stats.checks.unwrap();
        println!("{scene} {method:?}: {:?} {checks:?}", lit.stats.row_sum);
        // Measured: up to 0.0043, 0.0042, 0.002, 0.029.
        let both = checks.row_sum_and_sky.unwrap();
        assert!((both.mean - 1.0).abs() < 0.02, "{scene}: {checks:?}");
        assert!(checks.energy.unwrap().abs() < 0.02, "{scene}: {checks:?}");
        assert!(checks.reciprocity < 0.01, "{scene}: {checks:?}");
        assert!(
            checks.excess < 0.1 && checks.least > -0.1,
            "{scene}: {checks:?}"
        );
    }
}
