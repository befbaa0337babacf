//! Scenes made by hand, with numbers that mean nothing.

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{Backend, Error, Options, PointCloud, Result, Scene, illuminate};
use glam::{DVec3, Vec3};

/// A floor of 4 by 4 points.
fn floor() -> Scene {
    let positions = (0..16).map(|k| DVec3::new(f64::from(k % 4), f64::from(k / 4), 0.0));
    Scene {
        cloud: PointCloud {
            positions: positions.collect(),
            normals: vec![Vec3::Z; 16],
            reflectance: vec![Vec3::splat(0.5); 16],
            emission: vec![Vec3::ZERO; 16],
            ..PointCloud::default()
        },
        ..Scene::default()
    }
}

fn solve(scene: &Scene) -> Result<()> {
    illuminate(scene, &Options::default(), Backend::Cpu, &Silent).map(|_| ())
}

#[test]
fn lights_at_no_place_or_of_no_light_are_refused() {
    let light = |position, intensity| {
        let light = PointLight {
            position,
            intensity,
        };
        solve(&Scene {
            lights: vec![light],
            ..floor()
        })
    };
    assert!(light(DVec3::ONE, Vec3::ONE).is_ok());
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let place = DVec3::select(axis.cmpeq(DVec3::ONE), DVec3::splat(bad), DVec3::ONE);
            let refused = light(place, Vec3::ONE);
            assert!(matches!(refused, Err(Error::Invalid(_))), "{place}");
        }
    }
    for bad in [f32::NAN, f32::INFINITY, -1.0] {
        let refused = light(DVec3::ONE, Vec3::new(1.0, bad, 1.0));
        assert!(matches!(refused, Err(Error::Invalid(_))), "{bad}");
        let refused = solve(&Scene {
            sky: Vec3::new(1.0, 1.0, bad),
            ..floor()
        });
        assert!(matches!(refused, Err(Error::Invalid(_))), "sky {bad}");
    }
}

#[test]
fn points_at_no_place_get_no_light() {
    for bad in [f64::NAN, f64::NEG_INFINITY, 1e300] {
        let mut scene = Scene {
            sky: Vec3::ONE,
            ..floor()
        };
        scene.cloud.positions[5].y = bad;
        let lit = illuminate(&scene, &Options::default(), Backend::Cpu, &Silent).unwrap();
        assert_eq!((lit.stats.points, lit.stats.surfels), (16, 15));
        assert!(!lit.map.in_transport[5]);
        assert_eq!(lit.map.irradiance[5], Vec3::ZERO);
        assert!(lit.map.irradiance.iter().all(|h| h.is_finite()));
    }
}
