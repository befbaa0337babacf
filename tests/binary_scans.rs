//! Real scans in LAS, LAZ and E57, whole and cut short, and odd files.

use std::fs;
use std::path::PathBuf;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Error, PointCloud, scan};
use glam::{DVec3, dvec3};

/// The folder of real scans, which is not part of this repository.
fn scans() -> Option<PathBuf> {
    let folder = std::env::var_os("FMMGI_SCANS").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/scans")),
        PathBuf::from,
    );
    if !folder.is_dir() {
        eprintln!(
            "NOT RUN: there is no folder of scans at {}",
            folder.display()
        );
        return None;
    }
    Some(folder)
}

fn bounds(cloud: &PointCloud) -> (DVec3, DVec3) {
    let positions = || cloud.positions.iter().copied();
    (
        positions().reduce(DVec3::min).unwrap(),
        positions().reduce(DVec3::max).unwrap(),
    )
}

#[test]
fn real_scans_are_read() {
    let Some(folder) = scans() else { return };
    let room = (dvec3(-2.742, -4.637, -0.094), dvec3(1.344, 3.149, 3.641));
    let cases = [
        ("room_lamps_1m.laz", 1_331_807, room),
        ("room_lamps_10m.laz", 10_011_395, room),
        (
            "outcrop_utm.laz",
            268_035,
            (
                dvec3(244398.864, 6010935.736, 18.145),
                dvec3(244412.920, 6010946.562, 20.510),
            ),
        ),
        (
            "lone_star_geyser.copc.laz",
            518_862,
            (
                dvec3(515368.602, 4918340.364, 2322.896),
                dvec3(515401.043, 4918381.124, 2338.576),
            ),
        ),
        (
            "pump.e57",
            155_201,
            (dvec3(-2.904, -5.301, -1.900), dvec3(1.722, -0.793, 1.843)),
        ),
        (
            "bunny_int32.e57",
            30_571,
            (
                dvec3(-0.0947, 0.0400, -0.0619),
                dvec3(0.0610, 0.1873, 0.0588),
            ),
        ),
        (
            "odd/bad_vlr_count.las",
            10,
            (
                dvec3(289814.15, 4320978.61, 170.58),
                dvec3(289818.50, 4320980.59, 170.76),
            ),
        ),
        ("odd/gps-time-nan.las", 1, (DVec3::ZERO, DVec3::ZERO)),
        (
            "odd/cartesian_invalid_state_single.e57",
            1,
            (dvec3(-1.0, -2.0, -3.0), dvec3(-1.0, -2.0, -3.0)),
        ),
        ("odd/testWithNormals.e57", 2, (DVec3::X, 2.0 * DVec3::X)),
        // Of its 360 directions 180 are marked as without a range.
        (
            "odd/tiny_spherical.e57",
            180,
            (dvec3(0.0, -0.5, 0.0), dvec3(1.0, 0.5, 1.0)),
        ),
    ];
    for (name, points, (min, max)) in cases {
        let cloud = scan::read(&folder.join(name), &Silent).unwrap();
        assert_eq!(cloud.len(), points, "{name}");
        let (low, high) = bounds(&cloud);
        let near = |p: DVec3, q: DVec3| (p - q).abs().max_element() < 2.1e-3;
        assert!(near(low, min) && near(high, max), "{name}: {low} .. {high}");
    }
    for (name, expected) in [
        ("odd/no-points.las", "empty cloud"),
        (
            "odd/garbage_nVariableLength.las",
            "promises 719 points, and there is room for 718",
        ),
        ("odd/ZeroPoints.e57", "empty cloud"),
        ("odd/InvalidCVHeader.e57", "empty cloud"),
        (
            "odd/read_error.e57",
            "none of 2651 points has valid coordinates",
        ),
        ("odd/corrupt_crc.e57", "invalid checksum"),
    ] {
        let error = scan::read(&folder.join(name), &Silent).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn the_pump_is_the_same_as_text() {
    let Some(folder) = scans() else { return };
    let [a, b] =
        ["pump.e57", "pump.pts"].map(|name| scan::read(&folder.join(name), &Silent).unwrap());
    assert_eq!(a.len(), b.len());
    for i in 0..a.len() {
        // The text has the digits of f32.
        assert!((a.positions[i] - b.positions[i]).length() < 2e-6, "{i}");
        assert!((a.reflectance[i] - b.reflectance[i]).length() < 1e-6, "{i}");
    }
}

#[test]
fn real_scans_can_be_cut_anywhere() {
    let Some(folder) = scans() else { return };
    let directory = tempfile::tempdir().unwrap();
    let mut cut = 12_345usize;
    for name in [
        "room_lamps_1m.laz",
        "outcrop_utm.laz",
        "lone_star_geyser.copc.laz",
        "pump.e57",
        "bunny_int32.e57",
        "odd/bad_vlr_count.las",
        "odd/tiny_spherical.e57",
    ] {
        let path = folder.join(name);
        let bytes = fs::read(&path).unwrap();
        let whole = scan::read(&path, &Silent).unwrap();
        let part = directory
            .path()
            .join("cut")
            .with_extension(path.extension().unwrap());
        for _ in 0..20 {
            cut = cut
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            fs::write(&part, &bytes[..(cut >> 20) % bytes.len()]).unwrap();
            // Either all points are there, or the error says so.
            match scan::read(&part, &Silent) {
                Ok(cloud) => assert_eq!(cloud.len(), whole.len(), "{name}"),
                Err(Error::Input { .. }) => {}
                Err(other) => panic!("{name}: {other}"),
            }
        }
    }
}
