//! Reading LAS and LAZ: every point format, every way to store colours, and files that lie.

mod damage;

use std::io::Cursor;
use std::sync::LazyLock;

use damage::{Noting, damaged, error, largest_allocation, panics, read, read_scan};
use fmmgi_gpu::points::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan::{ReadOptions, Scan};
use glam::{DVec3, Vec3};
use las::point::Format;
use las::{Builder, Color, Point, Transform, Vector, Vlr, Writer};
use proptest::prelude::*;

#[global_allocator]
static ALLOCATOR: Noting = Noting;

/// Map coordinates in steps of a millimetre.
fn transforms() -> Vector<Transform> {
    let axis = |offset| Transform {
        scale: 0.001,
        offset,
    };
    Vector {
        x: axis(244_398.0),
        y: axis(6_010_935.0),
        z: axis(18.0),
    }
}

fn integers(i: usize) -> [i32; 3] {
    let i = i as i32;
    [i % 1013, -(i % 911), i / 64]
}

fn colour(i: usize) -> [u16; 3] {
    [65535, (i * 257) as u16, (i % 7 * 1001) as u16]
}

/// A file of some points, as the crate `las` writes it; later versions as the format needs.
fn written(
    format: u8,
    compressed: bool,
    points: usize,
    colour: impl Fn(usize) -> [u16; 3],
) -> Vec<u8> {
    let mut builder = Builder::from((1, if format < 4 { 2 } else { 4 }));
    builder.point_format = Format::new(format).unwrap();
    builder.point_format.is_compressed = compressed;
    builder.transforms = transforms();
    builder.vlrs.push(Vlr {
        user_id: "LASF_Projection".into(),
        record_id: 34735,
        description: String::new(),
        data: vec![1, 0, 1, 0],
    });
    let format = builder.point_format;
    let mut writer = Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
    let transforms = transforms();
    for i in 0..points {
        let [x, y, z] = integers(i);
        let [red, green, blue] = colour(i);
        writer
            .write_point(Point {
                x: transforms.x.direct(x),
                y: transforms.y.direct(y),
                z: transforms.z.direct(z),
                intensity: i as u16,
                return_number: 1,
                number_of_returns: 1,
                gps_time: format.has_gps_time.then_some(i as f64),
                color: format.has_color.then_some(Color { red, green, blue }),
                nir: format.has_nir.then_some(7),
                waveform: format.has_waveform.then(Default::default),
                ..Point::default()
            })
            .unwrap();
    }
    writer.into_inner().unwrap().into_inner()
}

fn place(i: usize) -> DVec3 {
    let integers = DVec3::from(integers(i).map(f64::from));
    integers * 0.001 + DVec3::new(244_398.0, 6_010_935.0, 18.0)
}

#[test]
fn every_point_format_is_read() {
    for format in 0..=10 {
        for compressed in [false, true] {
            let scan = read_scan(&written(format, compressed, 300, colour));
            let cloud = scan.cloud;
            let what = format!("format {format}, compressed: {compressed}, {}", scan.format);
            assert_eq!(cloud.len(), 300, "{what}");
            for (i, &p) in cloud.positions.iter().enumerate() {
                assert_eq!(p, place(i), "{what}");
            }
            let coloured = [2, 3, 5, 7, 8, 10].contains(&format);
            for (i, &r) in cloud.reflectance.iter().enumerate() {
                let expected = match coloured {
                    false => Vec3::splat(DEFAULT_REFLECTANCE),
                    true => Vec3::from(colour(i).map(linear)),
                };
                assert!((r - expected).abs().max_element() < 1e-6, "{what}: {r}");
            }
            assert!(cloud.repairs.is_empty(), "{what}: {:?}", cloud.repairs);
            let grid = cloud.grid.unwrap();
            assert_eq!(grid.scale, DVec3::splat(0.001));
            assert_eq!(grid.offset, DVec3::new(244_398.0, 6_010_935.0, 18.0));
            assert_eq!(grid.reference, [(34735, vec![1, 0, 1, 0])]);
            assert_eq!(scan.fields.contains(&"red".to_owned()), coloured);
        }
    }
}

/// IEC 61966-2-1, and white is 0.9.
fn linear(value: u16) -> f32 {
    let x = f64::from(value) / 65535.0;
    let linear = if x <= 0.04045 {
        x / 12.92
    } else {
        ((x + 0.055) / 1.055).powf(2.4)
    };
    (linear as f32).min(MAX_COLOUR_REFLECTANCE)
}

#[test]
fn chunks_stay_in_order() {
    // More chunks of 50,000 than are decompressed at once on a few threads.
    for format in [2, 7] {
        let cloud = read(&written(format, true, 420_000, colour)).unwrap();
        assert_eq!(cloud.len(), 420_000);
        assert!((0..420_000).all(|i| cloud.positions[i] == place(i)));
    }
}

#[test]
fn equal_points_are_no_lie() {
    // Nothing compresses better.
    for format in [0, 3, 6, 7] {
        let mut bytes = written(format, true, 0, colour);
        assert!(error(&bytes).contains("empty cloud"));
        let mut builder = Builder::from((1, 4));
        builder.point_format = Format::new(format).unwrap();
        builder.point_format.is_compressed = true;
        let format = builder.point_format;
        let mut writer =
            Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
        for _ in 0..200_000 {
            writer
                .write_point(Point {
                    gps_time: format.has_gps_time.then_some(0.0),
                    color: format.has_color.then(Color::default),
                    ..Point::default()
                })
                .unwrap();
        }
        bytes = writer.into_inner().unwrap().into_inner();
        println!("{format:?}: {} points a byte", 200_000 / bytes.len());
        assert_eq!(read(&bytes).unwrap().len(), 200_000);
    }
}

#[test]
fn colours_are_recognised_however_they_are_stored() {
    let cases = [
        (0x8080, linear(0x8080), ""),
        (
            0x80,
            linear(0x8080),
            "10 colours of 8 bit found in wider numbers",
        ),
        (
            0x8000,
            linear(0x8080),
            "10 colours of 8 bit found in the upper half",
        ),
        (0, DEFAULT_REFLECTANCE, "10 colours left out: all are black"),
    ];
    for (level, expected, repair) in cases {
        let cloud = read(&written(3, false, 10, |_| [level; 3])).unwrap();
        for r in &cloud.reflectance {
            assert!(
                (r - Vec3::splat(expected)).abs().max_element() < 1e-6,
                "{r} {expected}"
            );
        }
        assert_eq!(cloud.repairs.len(), usize::from(!repair.is_empty()));
        assert!(
            cloud.repairs.concat().contains(repair),
            "{:?}",
            cloud.repairs
        );
    }
}

/// A file of points of these classes, of which every third is withheld.
fn flagged(format: u8, compressed: bool) -> Vec<u8> {
    let mut builder = Builder::from((1, if format < 4 { 2 } else { 4 }));
    builder.point_format = Format::new(format).unwrap();
    builder.point_format.is_compressed = compressed;
    builder.point_format.extra_bytes = 12;
    let mut names = Vec::new();
    for name in ["NormalX", "NormalY", "NormalZ"] {
        let mut description = vec![0; 192];
        description[2] = 9;
        description[4..4 + name.len()].copy_from_slice(name.as_bytes());
        names.extend(description);
    }
    builder.vlrs.push(Vlr {
        user_id: "LASF_Spec".into(),
        record_id: 4,
        description: String::new(),
        data: names,
    });
    let mut writer = Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
    for i in 0..12 {
        let class = [2, 7, 1, 18][i % 4];
        let has_time = ![0, 2].contains(&format);
        writer
            .write_point(Point {
                x: i as f64,
                classification: las::point::Classification::new(class).unwrap(),
                is_withheld: i % 3 == 0,
                gps_time: has_time.then_some(0.0),
                color: [2, 7].contains(&format).then(Color::default),
                extra_bytes: [0f32, 0.6, 0.8].map(f32::to_le_bytes).concat(),
                ..Point::default()
            })
            .unwrap();
    }
    writer.into_inner().unwrap().into_inner()
}

#[test]
fn flagged_points_and_noise_are_marked_and_extra_normals_read() {
    for format in [0, 1, 2, 6, 7] {
        for compressed in [false, true] {
            let bytes = flagged(format, compressed);
            let scan = read_scan(&bytes);
            let expected: Vec<bool> = (0..12).map(|i| i % 2 == 1 || i % 3 == 0).collect();
            assert_eq!(scan.cloud.flagged, expected, "{format} {compressed}");
            assert!(
                scan.cloud
                    .normals
                    .iter()
                    .all(|n| *n == Vec3::new(0.0, 0.6, 0.8))
            );
            assert!(
                scan.taken.contains("normals NormalX NormalY NormalZ"),
                "{}",
                scan.taken
            );
            let options = ReadOptions {
                keep_flagged: true,
                ..ReadOptions::default()
            };
            let file = damage::file(&bytes);
            let kept = Scan::read(file.path(), &options, &Silent).unwrap();
            assert!(kept.cloud.flagged.is_empty());
        }
    }
}

#[test]
fn counts_of_64_bits_rule_and_late_coordinate_systems_are_kept() {
    // The count of 32 bits is at 107, that of 64 at 247.
    let fewer = with(written(7, false, 300, colour), 107, &200u32.to_le_bytes());
    let cloud = read(&fewer).unwrap();
    assert_eq!(cloud.len(), 300);
    assert!(cloud.repairs[0].contains("300 points, as the header counts in 64 bits"));
    // A record after the points: its place is at 235, the number of records at 243.
    let mut late = written(7, false, 300, colour);
    let begin = late.len() as u64;
    late.extend([0, 0]);
    late.extend(b"LASF_Projection\0");
    late.extend(2112u16.to_le_bytes());
    late.extend(5u64.to_le_bytes());
    late.extend([0; 32]);
    late.extend(b"WKT\0\0");
    let late = with(
        with(late, 235, &begin.to_le_bytes()),
        243,
        &1u32.to_le_bytes(),
    );
    let reference = read(&late).unwrap().grid.unwrap().reference;
    assert_eq!(reference[1], (2112, b"WKT\0\0".to_vec()));
    // One that is not there is told.
    let cut = read(&late[..late.len() - 1]).unwrap();
    assert!(cut.repairs[0].contains("1 records promised after the points, but only 0"));
}

/// A file with a number in its header replaced.
fn with(mut bytes: Vec<u8>, at: usize, number: &[u8]) -> Vec<u8> {
    bytes[at..at + number.len()].copy_from_slice(number);
    bytes
}

#[test]
fn lies_are_refused_in_words() {
    let las = || written(3, false, 100, colour);
    let laz = || written(3, true, 100, colour);
    let layered = || written(7, true, 100, colour);
    // Where the header says where the points begin.
    let begin = |bytes: &[u8]| u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    let table = |bytes: &[u8]| {
        let at = begin(bytes);
        i64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize
    };
    let record = |bytes: &[u8]| {
        let id = b"laszip encoded";
        bytes.windows(id.len()).position(|w| w == id).unwrap() + 52
    };
    let (begin_laz, table_laz, record_laz) = (begin(&laz()), table(&laz()), record(&laz()));
    let begin_layered = begin(&layered());
    let cases = [
        (las()[..100].to_vec(), "ends inside the header"),
        (with(las(), 25, &[5]), "LAS version 1.5"),
        (with(las(), 104, &[11]), "point format 11"),
        (
            with(las(), 105, &[33, 0]),
            "points of 33 bytes, but format 3 takes 34",
        ),
        (with(las(), 96, &[100, 0, 0, 0]), "begin inside the header"),
        (with(las(), 96, &[255; 4]), "its points begin at 4294967295"),
        (
            with(las(), 107, &[101, 0, 0, 0]),
            "promises 101 points, and there is room for 100",
        ),
        (
            with(las(), 107, &[255; 4]),
            "promises 4294967295 points, and there is room for 100",
        ),
        (with(las(), 107, &[0; 4]), "empty cloud"),
        (
            with(las(), 131, &0f64.to_le_bytes()),
            "in steps of [0, 0.001, 0.001]",
        ),
        (with(las(), 139, &f64::NAN.to_le_bytes()), "in steps of"),
        (
            with(las(), 163, &f64::INFINITY.to_le_bytes()),
            "from [244398, inf, 18]",
        ),
        (
            with(las(), 104, &[0x83]),
            "without the record that says how",
        ),
        (
            with(laz(), 107, &[101, 0, 0, 0]),
            "are damaged, after 0 of them",
        ),
        (with(laz(), 107, &[255; 4]), "and the chunks hold 50000"),
        (
            with(
                with(laz(), 107, &[255; 4]),
                record_laz + 12,
                &[254, 255, 255, 255],
            ),
            "chunks hold 4294967294",
        ),
        (
            with(
                with(laz(), 107, &[0, 0, 16, 0]),
                record_laz + 12,
                &[254, 255, 255, 255],
            ),
            "1048576 points are said to be in",
        ),
        (with(laz(), begin_laz, &[255; 8]), "table of chunks"),
        (
            with(laz(), begin_laz, &[0, 0, 1, 0, 0, 0, 0, 0]),
            "table of chunks at its end is not there",
        ),
        (
            with(laz(), table_laz + 4, &[255; 4]),
            "no room for 4294967295 chunks",
        ),
        (with(laz(), table_laz + 4, &[0; 4]), "the chunks hold 0"),
        (
            with(laz(), table_laz + 8, &[255; 4]),
            "table of chunks does not fit",
        ),
        (with(laz(), record_laz, &[3, 0]), "compression of kind 3"),
        (
            with(laz(), record_laz + 12, &[1, 0, 0, 0]),
            "the chunks hold 1",
        ),
        (
            with(laz(), record_laz + 32, &[1, 0]),
            "is not point format 3",
        ),
        (
            with(laz(), record_laz + 32, &[0, 0]),
            "is not point format 3",
        ),
        (
            with(layered(), begin_layered + 8 + 36 + 4, &[255; 4]),
            "damaged",
        ),
        (laz()[..laz().len() - 1].to_vec(), "table of chunks"),
        (
            laz()[..begin_laz + 50].to_vec(),
            "table of chunks at its end is not there",
        ),
    ];
    for (bytes, expected) in &cases {
        let message = error(bytes);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
    // Larger chunks than there are points are no lie.
    let one_chunk = with(laz(), record_laz + 12, &[254, 255, 255, 255]);
    assert_eq!(read(&one_chunk).unwrap().len(), 100);
    let more_records = with(las(), 100, &[255; 4]);
    let cloud = read(&more_records).unwrap();
    assert_eq!(cloud.len(), 100);
    assert!(cloud.repairs[0].contains("4294967295 records promised after the header, but only 1"));
    // None of this took memory for what is not there; chunks of 420,000 points take the most.
    assert!(largest_allocation() < 100 << 20, "{}", largest_allocation());
}

static FILES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let file = |format, compressed| written(format, compressed, 200, colour);
    vec![
        file(0, false),
        file(3, true),
        file(2, true),
        file(7, true),
        file(10, true),
    ]
});

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn damaged_files_do_no_harm(bytes in damaged(&FILES)) {
        let before = panics();
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(!cloud.is_empty());
            prop_assert_eq!(cloud.reflectance.len(), cloud.len());
            prop_assert_eq!(cloud.emission.len(), cloud.len());
        }
        prop_assert_eq!(panics(), before);
        prop_assert!(largest_allocation() < 100 << 20, "{}", largest_allocation());
    }
}
