//! PCD: the same points in all three encodings, and headers that lie.

use glam::{DVec3, Vec3};
use proptest::prelude::*;

use super::*;

#[derive(Clone, Debug)]
struct Point {
    place: [f32; 3],
    normal: [f32; 3],
    rgb: [u8; 3],
}

fn header(points: usize, data: &str) -> String {
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n\
         FIELDS label x y rgb z normal_x normal_y normal_z curvature\n\
         SIZE 2 8 4 4 4 4 4 4 4\nTYPE I F F F F F F F F\nCOUNT 3 1 1 1 1 1 1 1 1\n\
         WIDTH {points}\nHEIGHT 1\nVIEWPOINT 1 2 3 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
    )
}

/// The bytes of each field of a point.
fn fields(point: &Point) -> [Vec<u8>; 9] {
    let [red, green, blue] = point.rgb;
    let float = |x: f32| x.to_le_bytes().to_vec();
    let [x, y, z] = point.place;
    [
        vec![1, 0, 2, 0, 3, 0],
        f64::from(x).to_le_bytes().to_vec(),
        float(y),
        vec![blue, green, red, 0],
        float(z),
        float(point.normal[0]),
        float(point.normal[1]),
        float(point.normal[2]),
        float(0.5),
    ]
}

fn as_ascii(points: &[Point]) -> Vec<u8> {
    let mut text = header(points.len(), "ascii");
    for Point {
        place: [x, y, z],
        normal: [nx, ny, nz],
        rgb: [r, g, b],
    } in points
    {
        let packed = f32::from_le_bytes([*b, *g, *r, 0]);
        text += &format!(
            "1 2 3 {} {y} {packed:e} {z} {nx} {ny} {nz} 0.5\n",
            f64::from(*x)
        );
    }
    text.into_bytes()
}

fn as_binary(points: &[Point]) -> Vec<u8> {
    let mut bytes = header(points.len(), "binary").into_bytes();
    points.iter().for_each(|p| bytes.extend(fields(p).concat()));
    bytes
}

fn as_compressed(points: &[Point]) -> Vec<u8> {
    let all: Vec<_> = points.iter().map(fields).collect();
    let plain: Vec<u8> = (0..9)
        .flat_map(|field| all.iter().flat_map(move |point| point[field].clone()))
        .collect();
    let packed = compress(&plain);
    let mut bytes = header(points.len(), "binary_compressed").into_bytes();
    bytes.extend((packed.len() as u32).to_le_bytes());
    bytes.extend((plain.len() as u32).to_le_bytes());
    bytes.extend(packed);
    bytes
}

/// LZF by the longest repetition among a few, found by trying.
fn compress(plain: &[u8]) -> Vec<u8> {
    let mut packed = Vec::new();
    let mut literal: Vec<u8> = Vec::new();
    let flush = |packed: &mut Vec<u8>, literal: &mut Vec<u8>| {
        for part in literal.chunks(32) {
            packed.push(part.len() as u8 - 1);
            packed.extend(part);
        }
        literal.clear();
    };
    let mut at = 0;
    while at < plain.len() {
        let same = |distance: usize| {
            let pairs = plain[at..].iter().zip(&plain[at - distance..]);
            pairs.take(264).take_while(|(a, b)| a == b).count()
        };
        let distances = [1, 2, 3, 4, 8, 16, 31, 250, 256, 4096, 8192];
        let tried = distances.into_iter().filter(|&d| d <= at);
        let best = tried
            .map(|d| (same(d), d))
            .max()
            .filter(|&(length, _)| length >= 3);
        let Some((length, distance)) = best else {
            literal.push(plain[at]);
            at += 1;
            continue;
        };
        flush(&mut packed, &mut literal);
        let (code, far) = (length - 2, distance - 1);
        packed.push(((code.min(7) << 5) | (far >> 8)) as u8);
        if code >= 7 {
            packed.push((code - 7) as u8);
        }
        packed.push((far & 255) as u8);
        at += length;
    }
    flush(&mut packed, &mut literal);
    packed
}

fn points() -> impl Strategy<Value = Vec<Point>> {
    let float = prop_oneof![20 => -1e4f32..1e4, 1 => Just(f32::NAN), 1 => Just(0.0f32)];
    let point = (
        [float.clone(), float.clone(), float],
        [-1f32..1.0, -1f32..1.0, -1f32..1.0],
        any::<[u8; 3]>(),
    );
    let point = point.prop_map(|(place, normal, rgb)| Point { place, normal, rgb });
    prop::collection::vec(point, 1..200)
}

proptest! {
    #[test]
    fn all_encodings_give_the_points_that_were_written(points in points()) {
        for bytes in [as_ascii(&points), as_binary(&points), as_compressed(&points)] {
            let cloud = read(&bytes).unwrap();
            prop_assert_eq!(cloud.len(), points.len());
            for (i, point) in points.iter().enumerate() {
                let place = cloud.positions[i].to_array();
                let same = |(a, b): (f64, &f32)| a == f64::from(*b) || a.is_nan() && b.is_nan();
                prop_assert!(place.into_iter().zip(&point.place).all(same));
                prop_assert_eq!(cloud.normals[i], Vec3::from(point.normal));
                // Reflectance is capped from 244 on.
                let capped = cloud.reflectance[i].to_array().map(|r| r == 0.9);
                prop_assert_eq!(capped, point.rgb.map(|byte| byte >= 244));
            }
            prop_assert_eq!(cloud.scanners[0].position, DVec3::new(1.0, 2.0, 3.0));
            prop_assert!(cloud.repairs.is_empty());
        }
    }

    #[test]
    fn damaged_files_do_no_harm(
        points in points(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        for mut bytes in [as_ascii(&points), as_binary(&points), as_compressed(&points)] {
            let _ = read(&bytes[..cut.index(bytes.len())]);
            for (place, byte) in &changes {
                let place = place.index(bytes.len());
                bytes[place] = *byte;
            }
            sound(&bytes, "pcd");
        }
    }
}

#[test]
fn the_words_of_a_file_by_hand_are_understood() {
    // The example of the format's description: a colour as a whole number, 0x404070.
    let text = "VERSION .7\r\nFIELDS x y z rgb\r\nSIZE 4 4 4 4\r\nTYPE F F F F\r\n\
                COUNT 1 1 1 1\r\nWIDTH 3\r\nHEIGHT 1\r\nVIEWPOINT 0 0 0 1 0 0 0\r\nPOINTS 3\r\n\
                DATA ascii\r\n0.93773 0.33763 0 4.2108e+06\r\nnan nan nan 4.2108e+06\r\n1 1 1 4.2108e+06\r\n";
    let cloud = read(text.as_bytes()).unwrap();
    assert!((cloud.positions[0] - DVec3::new(0.93773, 0.33763, 0.0)).length() < 1e-7);
    assert!(cloud.positions[1].is_nan());
    let [blue, green, red, _] = 0x0040_4070_u32.to_le_bytes().map(f32::from);
    let linear = |byte: f32| ((byte / 255.0 + 0.055) / 1.055).powf(2.4);
    let expected = Vec3::new(linear(red), linear(green), linear(blue));
    assert!((cloud.reflectance[0] - expected).length() < 1e-6);
    // Whole numbers with an alpha, with sign or without, and floats of the same bits say the same.
    for (kind, word) in [
        ("U", 0xff40_4070_u32.to_string()),
        ("I", (0xff40_4070_u32 as i32).to_string()),
        ("U", (0xff40_4070_u32 as i32).to_string()),
        ("I", 0xff40_4070_u32.to_string()),
        ("F", 0xff40_4070_u32.to_string()),
        ("F", format!("{:e}", f32::from_bits(0x0040_4070))),
    ] {
        let other = text.replace("F F F F", &format!("F F F {kind}"));
        let other = read(other.replace("4.2108e+06", &word).as_bytes()).unwrap();
        assert_eq!(other.reflectance, cloud.reflectance, "{kind} {word}");
    }
    let zeros = text
        .replace("nan nan nan", "0 0 0")
        .replace("1 1 1 4", "0 0 0 4");
    let zeros = read(zeros.as_bytes()).unwrap();
    assert!(zeros.positions[1].is_nan() && zeros.positions[2].is_nan());
    assert!(zeros.repairs[0].starts_with("2 points at the origin"));
    // Small and capital letters, and the mark of UTF-8, are all the same.
    let other = text.to_lowercase().replace("x y z rgb", "X Y Z RGB");
    let other = read(format!("\u{feff}{other}").as_bytes()).unwrap();
    assert_eq!(other.reflectance, cloud.reflectance);
    assert_eq!(other.positions[0], cloud.positions[0]);
    // The default viewpoint is no evidence; the origin in another turn is, of points near it.
    assert!(cloud.scanners.is_empty());
    let turned = text.replace("0 0 0 1 0 0 0", "0 0 0 0 1 0 0");
    assert_eq!(read(turned.as_bytes()).unwrap().scanners.len(), 1);
    let far = turned
        .replace("0.93773 0.33763 0", "5000.5 0 0")
        .replace("1 1 1 4", "5000 0 0 4");
    assert!(read(far.as_bytes()).unwrap().scanners.is_empty());
}

#[test]
fn headers_that_lie_are_refused() {
    let point = Point {
        place: [1.0; 3],
        normal: [0.0; 3],
        rgb: [9; 3],
    };
    let [text, binary, compressed] =
        [as_ascii, as_binary, as_compressed].map(|f| f(std::slice::from_ref(&point)));
    let many = |bytes: &[u8]| {
        let place = bytes.windows(5).position(|w| w == b"DATA ").unwrap();
        let head = String::from_utf8_lossy(&bytes[..place]);
        let head = head.replace("WIDTH 1", "WIDTH 4000000000");
        let head = head.replace("POINTS 1", "POINTS 4000000000");
        [head.as_bytes(), &bytes[place..]].concat()
    };
    let cases: &[(Vec<u8>, &str)] = &[
        (many(&text), "room for at most"),
        (many(&binary), "room for at most 1"),
        (
            many(&compressed),
            "but the compressed ones are said to have 42",
        ),
        (compressed[..compressed.len() - 1].to_vec(), "cut short"),
        (binary[..binary.len() - 1].to_vec(), "room for at most 0"),
        (b"FIELDS x\n".to_vec(), "ends inside the header"),
        (
            b"FIELDS x y\nSIZE 4\nTYPE F F\nPOINTS 1\nDATA ascii\n".to_vec(),
            "2 FIELDS, but 1 values of SIZE",
        ),
        (
            b"FIELDS x\nSIZE 3\nTYPE F\nPOINTS 1\nDATA ascii\n".to_vec(),
            "no type \"F\" of \"3\" bytes",
        ),
        (
            b"FIELDS x\nSIZE 4\nTYPE F\nPOINTS 1\nDATA ascii\n1\n".to_vec(),
            "lack x, y or z",
        ),
        (
            b"FIELDS x\nSIZE 4\nTYPE F\nDATA ascii\n1\n".to_vec(),
            "neither POINTS nor WIDTH",
        ),
        (
            b"FIELDS x\nCOUNT 99999999999\nDATA ascii\n1\n".to_vec(),
            "counts are whole numbers from 1",
        ),
        (
            b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nPOINTS 3\nDATA ascii\n".to_vec(),
            "3 POINTS, but WIDTH and HEIGHT make 2",
        ),
        (
            b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 0\nDATA ascii\n".to_vec(),
            "empty cloud",
        ),
        (
            b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1\nDATA lzma\n".to_vec(),
            "header line 5 (\"DATA lzma\")",
        ),
        (
            b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1\nDATA ascii\n1 2 z\n".to_vec(),
            "line 6: \"z\" is no number (field \"z\")",
        ),
    ];
    for (bytes, expected) in cases {
        let message = error(bytes);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }

    // 4 GB of points cannot come from 100 bytes, whatever both sizes say.
    let points = 3_000_000;
    let mut bomb =
        format!("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS {points}\nDATA binary_compressed\n")
            .into_bytes();
    bomb.extend(100u32.to_le_bytes());
    bomb.extend((12 * points as u32).to_le_bytes());
    bomb.extend([0xff; 100]);
    assert!(error(&bomb).contains("LZF saves a factor of 88 at most"));
    // Repetitions that begin before the first byte.
    let mut damaged = compressed.clone();
    let body = damaged.len() - 1;
    damaged[body] = 0xff;
    let _ = read(&damaged);
    let start = compressed.windows(5).position(|w| w == b"ssed\n").unwrap() + 13;
    damaged[start] = 0xe0;
    assert!(error(&damaged).contains("compressed points are damaged"));
}
