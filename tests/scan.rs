//! Reading scans: what is understood, and that nothing else does harm.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use fmmgi_gpu::progress::{Progress, Silent};
use fmmgi_gpu::{Error, PointCloud, scan};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use tempfile::NamedTempFile;

fn file(bytes: &[u8]) -> NamedTempFile {
    let mut file = NamedTempFile::new().unwrap();
    file.write_all(bytes).unwrap();
    file
}

fn read(bytes: &[u8]) -> Result<PointCloud, Error> {
    scan::read(file(bytes).path(), &Silent)
}

/// The message of the error that reading gives; it must name the file.
fn error(bytes: &[u8]) -> String {
    let file = file(bytes);
    let error = scan::read(file.path(), &Silent).expect_err("bad input was read");
    let message = error.to_string();
    assert!(
        message.starts_with(file.path().to_str().unwrap()),
        "{message}"
    );
    assert_eq!(error.exit_code(), 1);
    message
}

fn ascii(body: &str) -> Vec<u8> {
    format!("ply\nformat ascii 1.0\n{body}").into_bytes()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

/// Header with `extra` properties and two points, whose values are given as ascii words.
fn two_points(extra: &str, first: &str, second: &str) -> Vec<u8> {
    ascii(&format!(
        "element vertex 2\n{XYZ}{extra}end_header\n1 2 3 {first}\n4 5 6 {second}\n"
    ))
}

/// A binary file that has everything: an element with lists before the vertices, a list among
/// their properties, an element after them.
fn rich_binary(big_endian: bool) -> Vec<u8> {
    let name = if big_endian { "big" } else { "little" };
    let mut bytes = format!(
        "ply\nformat binary_{name}_endian 1.0\ncomment caf\u{e9}\nobj_info 7\n\
         element camera 2\nproperty list uchar int ids\nproperty double fov\n\
         element empty 1000\n\
         element fixed 3\nproperty short a\nproperty uint b\n\
         element vertex 2\nproperty double x\nproperty list ushort float weights\n\
         property float y\nproperty short z\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nproperty float scalar_Scalar_field_#2\nproperty float radius\n\
         element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    bytes.retain(|&byte| byte != 0xc3); // comments may be in any encoding: here Latin-1
    macro_rules! put {
        ($($value:expr),*) => {
            $(bytes.extend(if big_endian { $value.to_be_bytes() } else { $value.to_le_bytes() });)*
        };
    }
    put!(2u8, 7i32, 8i32, 60.0f64);
    put!(0u8, 70.0f64);
    put!(1i16, 2u32, 1i16, 2u32, 1i16, 2u32);
    put!(
        1.5f64, 3u16, 0.1f32, 0.2f32, 0.3f32, -2.5f32, -300i16, 255u8, 0u8, 188u8, 9f32, 2f32
    );
    put!(6e6f64, 0u16, 0.25f32, 7i16, 0u8, 1u8, 2u8, 9f32, 1f32);
    put!(3u8, 0i32, 1i32, 0i32);
    bytes
}

#[test]
fn both_byte_orders_and_ascii_give_the_same_cloud() {
    let ascii = "ply\r\nformat ascii 1.0\r\ncomment x\r\n\
         element camera 2\r\nproperty list uchar int ids\r\nproperty double fov\r\n\
         element vertex 2\r\nproperty double x\r\nproperty list ushort float weights\r\n\
         property float y\r\nproperty short z\r\nproperty uchar red\r\nproperty uchar green\r\n\
         property uchar blue\r\nproperty float radius\r\n\
         element face 1\r\nproperty list uchar int vertex_indices\r\nend_header\r\n\
         2 7 8 60\r\n0 70\r\n\r\n\
         1.5 3 0.1 0.2 0.3 -2.5 -300 255 0 188 2 \r\n  6e6 0 .25 +7 0 1 2 1e0\r\n3 0 1 0";
    for bytes in [
        rich_binary(false),
        rich_binary(true),
        ascii.as_bytes().to_vec(),
        ascii.replace("\r\n", "\n").into_bytes(),
        ascii.replace("\r\n", "\r").into_bytes(),
        ascii.replacen("ply\r\n", "ply  \r\n", 1).into_bytes(),
    ] {
        let cloud = read(&bytes).unwrap();
        assert_eq!(
            cloud.positions,
            [DVec3::new(1.5, -2.5, -300.0), DVec3::new(6e6, 0.25, 7.0)]
        );
        assert!(cloud.normals.is_empty());
        assert_eq!(
            cloud.areas,
            [4.0 * std::f32::consts::PI, std::f32::consts::PI]
        );
        let [red, green, blue] = cloud.reflectance[0].to_array();
        assert_eq!([red, green], [0.9, 0.0], "white is capped at 0.9");
        // 188 is half of the light: ((188 / 255 + 0.055) / 1.055)^2.4.
        assert!((blue - 0.502_886).abs() < 1e-5);
        assert_eq!(cloud.emission, [Vec3::ZERO; 2]);
        assert!(cloud.repairs.is_empty());
    }
}

#[test]
fn properties_are_understood_with_and_without_prefix() {
    for prefix in ["", "scalar_"] {
        let properties: String = [
            "reflectance_red",
            "reflectance_green",
            "reflectance_blue",
            "emission_red",
            "emission_green",
            "emission_blue",
            "nx",
            "ny",
            "nz",
            "area",
            "radius",
        ]
        .map(|name| format!("property float {prefix}{name}\n"))
        .concat();
        // The exact reflectance goes before the colour, the area before the radius.
        let colour = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
        let cloud = read(&two_points(
            &(properties + colour),
            "0.25 0.5 1 0 7 1e4 0 0 2 0.125 5 1 2 3",
            "0 0 0 0 0 0 1 0 0 1 5 1 2 3",
        ))
        .unwrap();
        assert_eq!(cloud.reflectance[0], Vec3::new(0.25, 0.5, 1.0));
        assert_eq!(cloud.emission[0], Vec3::new(0.0, 7.0, 1e4));
        assert_eq!(cloud.normals, [Vec3::Z * 2.0, Vec3::X]);
        assert_eq!(cloud.areas, [0.125, 1.0]);
        assert!(cloud.repairs.is_empty());
    }
}

#[test]
fn colours_follow_their_type() {
    let colour = |kind: &str, values: &str| {
        let extra = ["red", "green", "blue"].map(|name| format!("property {kind} {name}\n"));
        let cloud = read(&two_points(&extra.concat(), values, values)).unwrap();
        (cloud.reflectance[0], cloud.repairs)
    };
    let (ushort, _) = colour("ushort", "65535 0 48316");
    assert!((ushort - Vec3::new(0.9, 0.0, 0.502_886)).length() < 1e-4);
    let (float, _) = colour("float", "1 0 0.5");
    assert_eq!(
        float,
        Vec3::new(1.0, 0.0, 0.5),
        "float colours are linear and not capped"
    );
    let (int, repairs) = colour("int", "1 2 3");
    assert_eq!(int, Vec3::splat(0.5));
    assert!(repairs[0].contains("only uchar, ushort and float"));
    let none = read(&two_points("", "", "")).unwrap();
    assert_eq!(none.reflectance, [Vec3::splat(0.5); 2]);
}

#[test]
fn repairs_are_made_and_counted() {
    let properties = [
        "reflectance_red",
        "reflectance_green",
        "reflectance_blue",
        "emission_red",
        "emission_green",
        "emission_blue",
        "radius",
    ]
    .map(|name| format!("property float {name}\n"))
    .concat();
    let cloud = read(&two_points(
        &properties,
        "nan 2 -1 -3 nan 1 -2",
        "0 0 0 inf 0 0 nan",
    ))
    .unwrap();
    assert_eq!(cloud.reflectance[0], Vec3::new(0.5, 1.0, 0.0));
    assert_eq!(cloud.emission, [Vec3::Z, Vec3::ZERO]);
    assert_eq!(cloud.areas, [0.0; 2]);
    assert_eq!(
        cloud.repairs,
        [
            "1 reflectances that are no number set to 0.5",
            "1 reflectances outside [0, 1] clamped",
            "2 emissions that are negative or no number set to 0",
            "2 areas that are no positive number estimated anew",
        ]
    );

    // Points without a place stay: every point of the input is in the output.
    let cloud = read(&ascii(&format!(
        "element vertex 2\n{XYZ}end_header\nnan 0 0\n0 inf 0"
    )))
    .unwrap();
    assert_eq!(cloud.len(), 2);
    assert!(cloud.positions[0].x.is_nan() && cloud.repairs.is_empty());

    let half = read(&two_points("property float nx\n", "1", "1")).unwrap();
    assert_eq!(half.repairs, ["nx ny nz left out: not all three are there"]);
}

#[test]
fn bad_input_is_told_in_words() {
    let vertices =
        |count: &str| ascii(&format!("element vertex {count}\n{XYZ}end_header\n1 2 3\n"));
    let header = |line: &str| {
        ascii(&format!(
            "{line}\nelement vertex 1\n{XYZ}end_header\n1 2 3\n"
        ))
    };
    let long_header = [b"ply\n".to_vec(), b"comment a line\n".repeat(100_000)].concat();
    let long_word = [
        ascii(&format!("element vertex 1\n{XYZ}end_header\n")),
        vec![b'1'; 5 << 20],
    ];
    let mut not_utf8 = header("element caf\u{e9} 1");
    not_utf8.retain(|&byte| byte != 0xc3);
    let cases: &[(&[u8], &str)] = &[
        (b"", "the file is empty"),
        (b"plyx", "not a scan in a format that is understood: PLY"),
        (
            b"LASF\0\0\0",
            "not a scan in a format that is understood: PLY",
        ),
        (b"ply x\n", "not a PLY file"),
        (b"ply\n", "ends inside the header"),
        (b"ply\nformat ascii 1.0", "ends inside the header"),
        (&long_header, "no end_header within 1048576 bytes"),
        (b"ply\nend_header\n", "no format line"),
        (
            b"ply\nformat ascii 2.0\n",
            "header line 2 (\"format ascii 2.0\"): only version 1.0",
        ),
        (b"ply\nformat ebcdic 1.0\n", "must be ascii"),
        (
            &header("format binary_big_endian 1.0"),
            "a second, different format",
        ),
        (
            &header("property float x"),
            "header line 3 (\"property float x\"): a property before",
        ),
        (
            &header("element a 1\nproperty flaot x"),
            "unknown type \"flaot\"",
        ),
        (
            &header("element a 1\nproperty list float int x"),
            "count of a list must be of an integer",
        ),
        (
            &header("element a 1\nproperty list int x"),
            "must be \"property TYPE NAME\"",
        ),
        (
            &header("element vertex 1"),
            "an element of this name came before",
        ),
        (
            &header("elephant"),
            "header line 3 (\"elephant\"): not understood",
        ),
        (&not_utf8, "not UTF-8"),
        (&ascii("end_header\n"), "no element \"vertex\""),
        (&vertices("0"), "empty cloud"),
        (&vertices("-1"), "must be a whole number"),
        (&vertices("1e3"), "must be a whole number"),
        (
            &vertices("99999999999999999999999"),
            "must be a whole number",
        ),
        (&vertices("18446744073709551615"), "cut short"),
        (
            &vertices("1000000000"),
            "promises 1000000000 vertices, and there is room for at most 1",
        ),
        (
            &ascii("element vertex 1\nproperty float x\nend_header\n1\n"),
            "lacks x, y or z",
        ),
        (
            &two_points("", "", "7"),
            "line 9: more values than the header has",
        ),
        (
            &two_points("property float nx\n", "1", ""),
            "line 10: the line ends before the value of \"nx\"",
        ),
        (
            &two_points(
                "property float nx\nproperty float ny\nproperty float nz\n",
                "0 0 1",
                "0 1,5 0",
            ),
            "line 12: \"1,5\" is no number (property \"ny\")",
        ),
        (
            &two_points("property list int int l\n", "-1", "0"),
            "\"-1\" is no number (property \"l\")",
        ),
        (
            &two_points("property list int int l\n", "999999999999 1", "0"),
            "ends before the value",
        ),
        (&long_word.concat(), "line 8 is longer than"),
    ];
    for (bytes, expected) in cases {
        let message = error(bytes);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
}

#[test]
fn truncated_bodies_say_how_far_they_go() {
    let whole = rich_binary(false);
    // Without the face and a byte of the last vertex.
    let message = error(&whole[..whole.len() - 13 - 1]);
    assert!(message.contains("ends after 1 of 2 vertices"), "{message}");

    let mut plain =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex 3\n{XYZ}end_header\n")
            .into_bytes();
    plain.extend([0; 35]);
    let message = error(&plain);
    assert!(
        message.contains("promises 3 vertices, and there is room for at most 2"),
        "{message}"
    );

    // Lines that are long enough for the check by length.
    let lines = format!(
        "element vertex 3\n{XYZ}end_header\n{}",
        "1.00000 2.00000 3.00000\n".repeat(2)
    );
    let message = error(&ascii(&lines));
    assert!(message.contains("ends after 2 of 3 vertices"), "{message}");
}

#[test]
fn what_is_no_file_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let message = |path: &Path| scan::read(path, &Silent).unwrap_err().to_string();
    assert!(message(directory.path()).contains("is a directory"));
    let missing = directory.path().join("missing.ply");
    assert!(message(&missing).contains("missing.ply: cannot be opened: No such file"));
    #[cfg(unix)]
    {
        let pipe = directory.path().join("pipe.ply");
        let made = std::process::Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap();
        assert!(made.success());
        for path in [&pipe, Path::new("/dev/zero")] {
            assert!(message(path).contains("not a regular file"));
        }
    }
}

#[test]
fn reading_stops_when_told() {
    struct Stop;
    impl Progress for Stop {
        fn cancelled(&self) -> bool {
            true
        }
    }
    for bytes in [rich_binary(true), two_points("", "", "")] {
        let result = scan::read(file(&bytes).path(), &Stop);
        assert!(matches!(result, Err(Error::Interrupted)));
    }
}

#[test]
fn blocks_join_without_a_seam() {
    // Several blocks of 4 MiB, whose ends fall inside rows.
    let n = 700_000;
    let place = |i: usize| DVec3::new(i as f64, 0.5 * i as f64, -(i as f64));
    let header = |encoding: &str| {
        format!(
            "ply\nformat {encoding} 1.0\nelement vertex {n}\n{XYZ}property uchar pad\nend_header\n"
        )
    };
    let mut text = header("ascii");
    let mut binary = header("binary_little_endian").into_bytes();
    for p in (0..n).map(place) {
        text += &format!("{} {} {} 0\n", p.x, p.y, p.z);
        for x in p.to_array() {
            binary.extend((x as f32).to_le_bytes());
        }
        binary.push(0);
    }
    let expected: Vec<DVec3> = (0..n).map(place).collect();
    assert!(read(&binary).unwrap().positions == expected);
    assert!(read(text.as_bytes()).unwrap().positions == expected);
    let broken = text.replace("\n650000 ", "\nx ");
    assert!(error(broken.as_bytes()).contains("line 650009: \"x\" is no number"));
}

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

proptest! {
    #[test]
    fn random_bytes_do_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = read(&[b"ply\n".to_vec(), bytes].concat());
    }

    #[test]
    fn random_headers_do_no_harm(
        lines in prop::collection::vec("(element|property|format|comment|list| |\n|vertex|x|y|z|uchar|float|double|ascii|binary_little_endian|1\\.0|[0-9]{1,22}|-1|end_header\n){1,8}", 0..12),
        body in prop::collection::vec(any::<u8>(), 0..64),
    ) {
        let header = format!("ply\nformat ascii 1.0\n{}\n", lines.join("\n"));
        let _ = read(&[header.into_bytes(), body].concat());
    }

    #[test]
    fn mutated_files_do_no_harm(
        kind in 0..3,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        length in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let mut bytes = match kind {
            0 => rich_binary(false),
            1 => rich_binary(true),
            _ => two_points("property list uchar float l\nproperty float nx\n", "2 3 4 5", "0 6"),
        };
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        if cut {
            bytes.truncate(length.index(bytes.len()));
        }
        // Whatever comes out fits together.
        if let Ok(cloud) = read(&bytes) {
            let n = cloud.len();
            prop_assert!(n > 0 && cloud.reflectance.len() == n && cloud.emission.len() == n);
            let zero_to_one = |r: &Vec3| r.cmpge(Vec3::ZERO).all() && r.cmple(Vec3::ONE).all();
            prop_assert!(cloud.reflectance.iter().all(zero_to_one));
        }
    }
}
