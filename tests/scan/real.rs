//! Scans of real things, whole and cut short.

use std::fs;
use std::path::PathBuf;

use glam::DVec3;

use super::*;

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

/// Names, points, and what is told of the points.
const SCANS: [(&str, usize, &str); 17] = [
    ("cave_banba.ply", 43_810, "normals colours"),
    ("lion_statue_normals.ply", 341_989, "normals colours"),
    ("bunny.ply", 35_947, "normals"), // of the faces
    ("horse.ply", 48_485, "normals colours"),
    ("igea.ply", 134_345, ""),
    ("pump.pts", 155_201, "colours"),
    ("kitten.xyz", 5_210, ""),
    ("oni.xyz", 1_435, "normals"),
    ("office1.pcd", 307_200, "colours scanner"),
    ("room_scan1.pcd", 112_586, ""), // its viewpoint is the default
    ("autzen_colour.ptx", 1_065, "colours"),
    ("spot.obj", 20_000, "normals"),
    ("odd/points_ascii_with_lists.ply", 5, ""),
    ("odd/points_cloudcompare.xyz", 101, "colours"),
    ("odd/multiple-and-transform.ptx", 8, "scanner"),
    ("odd/missingheader.pcd", 0, "header line 1"),
    ("odd/no_vertex.ply", 0, "no element \"vertex\""),
];

fn bounds(cloud: &PointCloud) -> [DVec3; 2] {
    let placed = cloud.positions.iter().filter(|p| p.is_finite());
    placed.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[min, max], &p| {
        [min.min(p), max.max(p)]
    })
}

#[test]
fn real_scans_are_read() {
    let Some(folder) = scans() else { return };
    for (name, points, told) in SCANS {
        let cloud = match scan::read(&folder.join(name), &Silent) {
            Ok(cloud) => cloud,
            Err(error) => {
                assert!(points == 0 && error.to_string().contains(told), "{error}");
                continue;
            }
        };
        assert_eq!(cloud.len(), points, "{name}");
        let has = |what: &str| told.contains(what);
        assert_eq!(!cloud.normals.is_empty(), has("normals"), "{name}");
        // Between the corners of a face colours are rounded.
        let is_grey = |r: &Vec3| r.abs_diff_eq(Vec3::splat(0.5), 1e-6);
        let grey = cloud.reflectance.iter().all(is_grey);
        assert_eq!(!grey, has("colours"), "{name}");
        assert_eq!(!cloud.scanners.is_empty(), has("scanner"), "{name}");
    }
    let boxes = [
        (
            "cave_banba.ply",
            [-14.90, -4.67, -25.98],
            [8.46, 11.14, 83.17],
        ),
        ("pump.pts", [-2.904, -5.301, -1.900], [1.722, -0.793, 1.843]),
        ("office1.pcd", [-2.65, -2.20, 1.83], [1.50, 1.58, 5.36]),
        (
            "room_scan1.pcd",
            [-13.80, -6.49, -1.35],
            [15.45, 7.98, 1.71],
        ),
        (
            "kitten.xyz",
            [-0.325, -0.500, -0.296],
            [0.326, 0.499, 0.295],
        ),
        ("oni.xyz", [-0.294, -0.500, -0.377], [0.294, 0.500, 0.377]),
        (
            "autzen_colour.ptx",
            [635_619.85, 848_899.70, 406.59],
            [638_982.55, 853_535.43, 586.38],
        ),
        (
            // Its first point is 37012.24 49028.31 15.83, with z doubled by the pose.
            "odd/multiple-and-transform.ptx",
            [636_699.38, 848_991.01, 425.39],
            [637_012.24, 849_106.66, 446.39],
        ),
    ];
    for (name, min, max) in boxes {
        let [low, high] = bounds(&scan::read(&folder.join(name), &Silent).unwrap());
        let apart = (low - DVec3::from(min)).length() + (high - DVec3::from(max)).length();
        assert!(apart < 0.02, "{name}: {low} {high}");
    }
    let office = scan::read(&folder.join("office1.pcd"), &Silent).unwrap();
    let finite = office.positions.iter().filter(|p| p.is_finite()).count();
    assert_eq!(finite, 254_456);
}

#[test]
fn real_scans_can_be_cut_anywhere() {
    let Some(folder) = scans() else { return };
    let mut cut = 12_345usize;
    for (name, ..) in SCANS {
        let bytes = fs::read(folder.join(name)).unwrap();
        let ending = name.rsplit('.').next().unwrap();
        let whole = scan::read(&folder.join(name), &Silent);
        for _ in 0..20 {
            cut = cut
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let part = &bytes[..(cut >> 20) % bytes.len()];
            let file = named(part, ending);
            match (scan::read(file.path(), &Silent), &whole) {
                // All points are there; or, in a text that nobody counted, the first ones are, and
                // doubt of the last is told. A mesh may end after any face.
                (Ok(cloud), Ok(whole)) if ending == "xyz" => {
                    let n = cloud.len() - 1;
                    assert!(cloud.positions[..n] == whole.positions[..n], "{name}");
                    let is_whole = cloud.positions[n] == whole.positions[n];
                    let is_told = cloud.repairs.iter().any(|r| r.contains("has no end"));
                    assert!(is_whole || is_told, "{name}");
                }
                (Ok(cloud), Ok(_)) if ending == "obj" => {
                    let is_told = cloud.repairs.iter().any(|r| r.contains("has no end"));
                    assert!(is_told || part.ends_with(b"\n"), "{name}");
                }
                (Ok(cloud), Ok(whole)) => assert_eq!(cloud.len(), whole.len(), "{name}"),
                (Ok(_), Err(_)) => panic!("{name}: a part was read, the whole was not"),
                (Err(Error::Input { .. }), _) => {}
                (Err(other), _) => panic!("{name}: {other}"),
            }
        }
    }
}
