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

#[test]
fn real_scans_are_read() {
    let Some(folder) = scans() else { return };
    let cases = [
        ("cave_banba.ply", 43_810, true),
        ("lion_statue_normals.ply", 341_989, true),
        ("bunny.ply", 35_947, false),
        ("horse.ply", 48_485, false),
        ("igea.ply", 134_345, false),
        ("odd/points_ascii_with_lists.ply", 5, false),
    ];
    for (name, points, normals) in cases {
        let cloud = scan::read(&folder.join(name), &Silent).unwrap();
        assert_eq!(cloud.len(), points, "{name}");
        assert_eq!(
            cloud.normals.len(),
            if normals { points } else { 0 },
            "{name}"
        );
        assert!(cloud.repairs.is_empty(), "{name}: {:?}", cloud.repairs);
    }
    let cave = scan::read(&folder.join("cave_banba.ply"), &Silent).unwrap();
    let (min, max) = cave
        .positions
        .iter()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), &p| {
            (min.min(p), max.max(p))
        });
    assert!((min - DVec3::new(-14.90, -4.67, -25.98)).length() < 0.01);
    assert!((max - DVec3::new(8.46, 11.14, 83.17)).length() < 0.01);

    let error = scan::read(&folder.join("odd/no_vertex.ply"), &Silent).unwrap_err();
    assert!(error.to_string().contains("no element \"vertex\""));
}

#[test]
fn real_scans_can_be_cut_anywhere() {
    let Some(folder) = scans() else { return };
    let mut cut = 12_345usize;
    for name in [
        "cave_banba.ply",
        "bunny.ply",
        "horse.ply",
        "odd/points_ascii_with_lists.ply",
    ] {
        let bytes = fs::read(folder.join(name)).unwrap();
        let whole = scan::read(&folder.join(name), &Silent).unwrap();
        for _ in 0..40 {
            cut = cut
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            // Either all vertices are there, or the error says so.
            match read(&bytes[..(cut >> 20) % bytes.len()]) {
                Ok(cloud) => assert_eq!(cloud.len(), whole.len(), "{name}"),
                Err(Error::Input { .. }) => {}
                Err(other) => panic!("{name}: {other}"),
            }
        }
    }
}
