//! Reading E57: poses, angles, states, limits, normals, and files that lie.

mod damage;

use std::io::Cursor;
use std::sync::LazyLock;

use damage::{Noting, damaged, error, largest_allocation, panics, read, read_scan};
use e57::{
    ColorLimits, E57Writer, Extension, PointCloudWriter, Quaternion, Record, RecordDataType,
    RecordName, RecordValue, Result, Transform, Translation,
};
use fmmgi_gpu::points::DEFAULT_REFLECTANCE;
use glam::{DVec3, Vec3, dvec3, vec3};
use proptest::prelude::*;

#[global_allocator]
static ALLOCATOR: Noting = Noting;

type Out<'a> = E57Writer<&'a mut Cursor<Vec<u8>>>;

/// A file with the scans that `fill` adds, its description changed by `edit`.
fn file_edited(fill: impl Fn(&mut Out) -> Result<()>, edit: impl Fn(String) -> String) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = E57Writer::new(&mut bytes, "file").unwrap();
    let url = "http://www.libe57.org/E57_NOR_surface_normals.txt";
    writer
        .register_extension(Extension::new("nor", url))
        .unwrap();
    fill(&mut writer).unwrap();
    writer.finalize_customized_xml(|xml| Ok(edit(xml))).unwrap();
    drop(writer);
    bytes.into_inner()
}

fn file(fill: impl Fn(&mut Out) -> Result<()>) -> Vec<u8> {
    file_edited(fill, |xml| xml)
}

/// Adds a scan with points of the given fields.
fn add(
    out: &mut Out,
    fields: &[Record],
    points: &[&[RecordValue]],
    set: impl Fn(&mut PointCloudWriter<&mut Cursor<Vec<u8>>>),
) -> Result<()> {
    let mut scan = out.add_pointcloud("scan", fields.to_vec())?;
    set(&mut scan);
    for point in points {
        scan.add_point(point.to_vec())?;
    }
    scan.finalize()
}

fn field(name: RecordName, data_type: RecordDataType) -> Record {
    Record { name, data_type }
}

fn normals() -> [Record; 3] {
    ["normalX", "normalY", "normalZ"].map(|name| {
        let name = RecordName::Unknown {
            namespace: "nor".into(),
            name: name.into(),
        };
        field(name, RecordDataType::F32)
    })
}

const XYZ: [Record; 3] = [
    Record::CARTESIAN_X_F64,
    Record::CARTESIAN_Y_F64,
    Record::CARTESIAN_Z_F64,
];
const ANGLES: [Record; 3] = [
    Record::SPHERICAL_RANGE_F64,
    Record::SPHERICAL_AZIMUTH_F64,
    Record::SPHERICAL_ELEVATION_F64,
];
const RGB: [Record; 3] = [
    Record::COLOR_RED_U8,
    Record::COLOR_GREEN_U8,
    Record::COLOR_BLUE_U8,
];

fn doubles<const N: usize>(values: [f64; N]) -> [RecordValue; N] {
    values.map(RecordValue::Double)
}

fn integers<const N: usize>(values: [i64; N]) -> [RecordValue; N] {
    values.map(RecordValue::Integer)
}

fn near(a: DVec3, b: DVec3) -> bool {
    (a - b).length() < 1e-9
}

/// A quarter turn about z, and far away; the quaternion is not of length 1.
fn pose() -> Transform {
    Transform {
        rotation: Quaternion {
            w: 2.0,
            x: 0.0,
            y: 0.0,
            z: 2.0,
        },
        translation: Translation {
            x: 5e5,
            y: 6e6,
            z: 7.0,
        },
    }
}

#[test]
fn scans_are_placed_by_their_poses() {
    let bytes = file(|out| {
        let fields = [&XYZ[..], &normals(), &RGB].concat();
        let normal = [1.0, 0.0, 0.0].map(RecordValue::Single);
        let point = |position: [f64; 3]| {
            [&doubles(position)[..], &normal, &integers([255, 0, 188])].concat()
        };
        let (a, b) = (point([1.0, 2.0, 3.0]), point([4.0, 5.0, 6.0]));
        add(out, &fields, &[&a, &b], |scan| {
            scan.set_transform(Some(pose()))
        })?;
        let angles = |values| doubles(values).to_vec();
        let half = std::f64::consts::FRAC_PI_2;
        let (up, back) = (angles([2.0, 0.3, half]), angles([3.0, -2.0 * half, 0.0]));
        add(out, &ANGLES, &[&up, &back], |_| {})?;
        add(out, &XYZ, &[&doubles([7.0, 8.0, 9.0])], |_| {})
    });
    let scan = read_scan(&bytes);
    assert_eq!(scan.format, "E57, 3 scans");
    for name in [
        "cartesianX",
        "sphericalElevation",
        "nor:normalZ",
        "colorBlue",
    ] {
        assert!(
            scan.fields.iter().any(|field| field == name),
            "{:?}",
            scan.fields
        );
    }
    let cloud = scan.cloud;
    let expected = [
        dvec3(5e5 - 2.0, 6e6 + 1.0, 10.0),
        dvec3(5e5 - 5.0, 6e6 + 4.0, 13.0),
        dvec3(0.0, 0.0, 2.0),
        dvec3(-3.0, 0.0, 0.0),
        dvec3(7.0, 8.0, 9.0),
    ];
    assert_eq!(cloud.len(), 5);
    for (p, q) in cloud.positions.iter().zip(expected) {
        assert!(near(*p, q), "{p} is not {q}");
    }
    for (k, normal) in cloud.normals.iter().enumerate() {
        let expected = if k < 2 { Vec3::Y } else { Vec3::ZERO };
        assert!((normal - expected).length() < 1e-6, "{k}: {normal}");
    }
    // sRGB 188 is 0.5029; white is 0.9.
    assert!((cloud.reflectance[0] - vec3(0.9, 0.0, 0.5029)).length() < 1e-4);
    assert_eq!(cloud.reflectance[4], Vec3::splat(DEFAULT_REFLECTANCE));
    // Of the last scan nobody knows where it was measured from.
    let scanners: Vec<_> = cloud
        .scanners
        .iter()
        .map(|scanner| (scanner.position, scanner.points.clone()))
        .collect();
    assert_eq!(
        scanners,
        [(dvec3(5e5, 6e6, 7.0), 0..2), (DVec3::ZERO, 2..4)]
    );
    assert!(cloud.repairs.is_empty(), "{:?}", cloud.repairs);
    assert_eq!(cloud.grid, None);
}

#[test]
fn invalid_values_are_left_out() {
    let bytes = file(|out| {
        let fields = [
            &XYZ[..],
            &[Record::CARTESIAN_INVALID_STATE],
            &ANGLES,
            &[Record::SPHERICAL_INVALID_STATE],
            &RGB,
            &[field(
                RecordName::IsColorInvalid,
                RecordDataType::Integer { min: 0, max: 1 },
            )],
        ]
        .concat();
        let point = |x: f64, [cartesian, spherical, colour]: [i64; 3]| {
            [
                &doubles([x, 0.0, 0.0])[..],
                &integers([cartesian]),
                &doubles([10.0 * x, 0.0, 0.0]),
                &integers([spherical]),
                &integers([255, 0, 0, colour]),
            ]
            .concat()
        };
        let points = [
            point(1.0, [0, 0, 0]),
            point(2.0, [1, 0, 1]),
            point(3.0, [2, 1, 0]),
            point(4.0, [2, 2, 0]),
            point(-5.0, [2, 0, 0]),
        ];
        let points: Vec<&[RecordValue]> = points.iter().map(Vec::as_slice).collect();
        add(out, &fields, &points, |_| {})
    });
    let cloud = read(&bytes).unwrap();
    // Angles stand in for coordinates, but not with a range that is negative.
    assert_eq!(
        cloud.positions,
        [dvec3(1.0, 0.0, 0.0), dvec3(20.0, 0.0, 0.0)]
    );
    assert_eq!(
        cloud.repairs,
        ["3 points left out: without valid coordinates"]
    );
    assert_eq!(
        cloud.reflectance,
        [Vec3::new(0.9, 0.0, 0.0), Vec3::splat(DEFAULT_REFLECTANCE)]
    );
}

#[test]
fn limits_say_what_is_white() {
    let some = |value| Some(RecordValue::Integer(value));
    let limits = |max| ColorLimits {
        red_min: some(0),
        red_max: some(max),
        green_min: some(0),
        green_max: some(max),
        blue_min: some(0),
        blue_max: some(max),
    };
    let wide = |name| field(name, RecordDataType::U16);
    let colours = [
        wide(RecordName::ColorRed),
        wide(RecordName::ColorGreen),
        wide(RecordName::ColorBlue),
    ];
    let grey = field(
        RecordName::Intensity,
        RecordDataType::Integer {
            min: -2048,
            max: 2047,
        },
    );
    let unlimited = field(
        RecordName::Intensity,
        RecordDataType::Integer {
            min: i64::MIN,
            max: i64::MAX,
        },
    );
    let xyz = doubles([1.0; 3]);
    let bytes = file(|out| {
        let colour = |value| [&xyz[..], &integers([value, value, value])].concat();
        let fields = [&XYZ[..], &colours].concat();
        add(out, &fields, &[&colour(502)], |scan| {
            scan.set_color_limits(Some(limits(1000)))
        })?;
        add(out, &fields, &[&colour(32896)], |_| {})?;
        let point = |value| [&xyz[..], &integers([value])].concat();
        let fields = [&XYZ[..], std::slice::from_ref(&grey)].concat();
        add(out, &fields, &[&point(-1024), &point(2047)], |_| {})?;
        let fields = [&XYZ[..], std::slice::from_ref(&unlimited)].concat();
        add(out, &fields, &[&point(7)], |_| {})
    });
    let cloud = read(&bytes).unwrap();
    let reflectance: Vec<f32> = cloud.reflectance.iter().map(|r| r.x).collect();
    // sRGB 0.502 is 0.2159; intensity is linear.
    let expected = [0.2159, 0.2159, 1024.0 / 4095.0, 0.9, DEFAULT_REFLECTANCE];
    for (r, e) in reflectance.iter().zip(expected) {
        assert!((r - e).abs() < 2e-4, "{reflectance:?}");
    }
    assert_eq!(cloud.repairs, ["2 colours made of intensities"]);
}

#[test]
fn limits_that_lie_are_left_out() {
    let wide = |name| field(name, RecordDataType::U16);
    let colours = [
        wide(RecordName::ColorRed),
        wide(RecordName::ColorGreen),
        wide(RecordName::ColorBlue),
    ];
    let fields = [&XYZ[..], &colours].concat();
    let read = |limit: i64, brightest: i64| {
        let limit = || Some(RecordValue::Integer(limit));
        let bytes = file(|out| {
            let point = |value| [&doubles([1.0; 3])[..], &integers([value; 3])].concat();
            let (dark, bright) = (point(0), point(brightest));
            add(out, &fields, &[&dark, &bright], |scan| {
                scan.set_color_limits(Some(ColorLimits {
                    red_min: Some(RecordValue::Integer(0)),
                    red_max: limit(),
                    green_min: Some(RecordValue::Integer(0)),
                    green_max: limit(),
                    blue_min: Some(RecordValue::Integer(0)),
                    blue_max: limit(),
                }));
            })
        });
        let cloud = read(&bytes).unwrap();
        (cloud.reflectance[1].x, cloud.repairs)
    };
    for (limit, brightest) in [(65535, 188), (255, 188 * 257), (100, 188)] {
        let (reflectance, repairs) = read(limit, brightest);
        assert!(
            (reflectance - 0.502_886).abs() < 1e-4,
            "{limit}: {reflectance}"
        );
        assert!(
            repairs[0].contains("limits of the colours, 0 to"),
            "{repairs:?}"
        );
    }
    assert!(read(1000, 737).1.is_empty());
}

#[test]
fn poses_that_say_nothing_are_none() {
    let turned = |w, x| Transform {
        rotation: Quaternion {
            w,
            x,
            y: 0.0,
            z: 0.0,
        },
        translation: Translation {
            x: 0.0,
            y: 0.0,
            z: x,
        },
    };
    let read = |pose: Transform| {
        let bytes = file(|out| {
            let points = [[1.0, 2.0, 3.0], [0.0; 3], [-1.0, 0.0, 2.0], [0.0; 3]].map(doubles);
            let points: Vec<&[RecordValue]> = points.iter().map(|p| &p[..]).collect();
            add(out, &XYZ, &points, |scan| {
                scan.set_transform(Some(pose.clone()))
            })
        });
        read(&bytes).unwrap()
    };
    let left_out =
        "2 points left out: at the place of the scanner, as directions without a return are";
    let zero = read(turned(0.0, 0.0));
    assert_eq!(
        zero.positions,
        [dvec3(1.0, 2.0, 3.0), dvec3(-1.0, 0.0, 2.0)]
    );
    assert_eq!(
        zero.repairs,
        [
            "1 pose whose rotation is all zeros: taken as not turned",
            left_out
        ]
    );
    // The default is no evidence for a scanner, another turn or place is.
    assert!(zero.scanners.is_empty() && read(turned(1.0, 0.0)).scanners.is_empty());
    assert_eq!(read(turned(1.0, 1.0)).scanners.len(), 1);
}

#[test]
fn scaled_integers_keep_their_grid() {
    let scaled = |name, offset| {
        field(
            name,
            RecordDataType::ScaledInteger {
                min: -100_000,
                max: 100_000,
                scale: 1e-3,
                offset,
            },
        )
    };
    let fields = [
        scaled(RecordName::CartesianX, 5e5),
        scaled(RecordName::CartesianY, 6e6),
        scaled(RecordName::CartesianZ, 0.0),
    ];
    let point = [-99_999, 12_345, 7].map(RecordValue::ScaledInteger);
    let bytes = file(|out| add(out, &fields, &[&point], |_| {}));
    let cloud = read(&bytes).unwrap();
    assert_eq!(cloud.positions, [dvec3(499_900.001, 6_000_012.345, 0.007)]);
    let grid = cloud.grid.unwrap();
    assert_eq!(
        (grid.scale, grid.offset),
        (DVec3::splat(1e-3), dvec3(5e5, 6e6, 0.0))
    );
}

fn hundred_points(out: &mut Out) -> Result<()> {
    let points: Vec<_> = (0..100).map(|i| doubles([f64::from(i); 3])).collect();
    let points: Vec<&[RecordValue]> = points.iter().map(|p| &p[..]).collect();
    add(out, &XYZ, &points, |scan| scan.set_transform(Some(pose())))
}

#[test]
fn lies_are_refused_in_words() {
    let whole = file(hundred_points);
    let edited = |from: &'static str, to: &str| {
        file_edited(hundred_points, |xml| {
            assert!(xml.contains(from), "{xml}");
            xml.replace(from, to)
        })
    };
    let with = |at: usize, number: [u8; 8]| {
        let mut bytes = whole.clone();
        bytes[at..at + 8].copy_from_slice(&number);
        bytes
    };
    let mut flipped = whole.clone();
    flipped[600] ^= 1;
    let constants = file_edited(hundred_points, |mut xml| {
        for name in ["cartesianX", "cartesianY", "cartesianZ"] {
            let constant = format!("<{name} type=\"Integer\" minimum=\"5\" maximum=\"5\"");
            xml = xml.replace(&format!("<{name} type=\"Float\""), &constant);
        }
        xml
    });
    let cases = [
        (whole[..40].to_vec(), "ends inside the header"),
        (
            whole[..1024].to_vec(),
            "cut short: its header promises a description",
        ),
        (
            whole[..whole.len() - 1].to_vec(),
            "are no whole pages of 1024",
        ),
        (
            with(24, [255; 8]),
            "cut short: its header promises a description",
        ),
        (
            with(32, [255; 8]),
            "cut short: its header promises a description",
        ),
        (with(40, [255; 8]), "age size"),
        (flipped, "invalid checksum"),
        (
            edited("recordCount=\"100\"", "recordCount=\"0\""),
            "empty cloud",
        ),
        (
            edited("recordCount=\"100\"", "recordCount=\"101\""),
            "scan 1: after 100 of 101 points",
        ),
        (
            edited("recordCount=\"100\"", "recordCount=\"1000000000000\""),
            "1000000000000 points are promised, and there is room for at most",
        ),
        (
            edited("fileOffset=\"48\"", "fileOffset=\"99999999\""),
            "scan 1",
        ),
        (edited("fileOffset=\"48\"", "fileOffset=\"52\""), "scan 1"),
        (
            edited("<data3D", &format!("{}<data3D", "<a>".repeat(100))),
            "nested more than",
        ),
        (
            edited("<data3D", &format!("<data3D {}", "a='' ".repeat(1000))),
            "has a tag of",
        ),
        (edited("cartesianX", "x"), "its points have no coordinates"),
        (
            edited("<w type=\"Float\">2", "<w type=\"Float\">NaN"),
            "pose is no rotation",
        ),
        (
            edited("<x type=\"Float\">500000", "<x type=\"Float\">inf"),
            "pose is no rotation",
        ),
        (
            edited(
                "</prototype>",
                &format!("{}</prototype>", "<a type='Float'/>".repeat(62)),
            ),
            "65 fields",
        ),
        (constants, "its 100 points are made of constants"),
    ];
    for (bytes, expected) in &cases {
        let message = error(bytes);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
    assert!(largest_allocation() < 20 << 20, "{}", largest_allocation());
}

static FILES: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let everything = file(|out| {
        hundred_points(out)?;
        let fields = [
            &ANGLES[..],
            &[Record::SPHERICAL_INVALID_STATE],
            &RGB,
            &normals(),
        ]
        .concat();
        let point = [
            &doubles([1.0, 2.0, 3.0])[..],
            &integers([0, 1, 2, 3]),
            &[1.0, 2.0, 3.0].map(RecordValue::Single),
        ]
        .concat();
        add(out, &fields, &[&point[..]; 50], |_| {})
    });
    vec![everything, file(hundred_points)]
});

/// Makes the checksums of all whole pages right, or else nothing but them would be tested.
fn seal(bytes: &mut [u8]) {
    for page in bytes.chunks_exact_mut(1024) {
        let (data, sum) = page.split_at_mut(1020);
        let crc = data.iter().fold(!0u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| {
                (crc >> 1) ^ if crc & 1 == 1 { 0x82f6_3b78 } else { 0 }
            })
        });
        sum.copy_from_slice(&(!crc).to_be_bytes());
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 1000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]
    #[test]
    fn damaged_files_do_no_harm(mut bytes in damaged(&FILES)) {
        let before = panics();
        seal(&mut bytes);
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(!cloud.is_empty());
            prop_assert_eq!(cloud.reflectance.len(), cloud.len());
            prop_assert_eq!(cloud.emission.len(), cloud.len());
            prop_assert!(cloud.normals.is_empty() || cloud.normals.len() == cloud.len());
        }
        prop_assert_eq!(panics(), before);
        prop_assert!(largest_allocation() < 20 << 20, "{}", largest_allocation());
    }
}
