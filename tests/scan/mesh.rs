//! Triangles to points.

use fmmgi_gpu::scan::{ReadOptions, Scan};
use glam::{DVec3, Vec3};
use proptest::prelude::*;

use super::*;

fn sample(text: &str, ending: &str, options: ReadOptions) -> PointCloud {
    let file = named(text.as_bytes(), ending);
    let scan = Scan::read(file.path(), &options, &Silent).unwrap();
    assert!(scan.sampled);
    scan.cloud
}

fn points(n: usize) -> ReadOptions {
    ReadOptions {
        faces: true,
        points: Some(n),
        ..ReadOptions::default()
    }
}

/// The unit square in `k` by `k` squares of two triangles, with colour by place.
fn square(k: usize) -> String {
    let at = |i: usize| i as f64 / k as f64;
    let mut text = String::new();
    for i in 0..(k + 1) * (k + 1) {
        let (x, y) = (at(i % (k + 1)), at(i / (k + 1)));
        text += &format!("v {x} {y} 3 {x} {y} 0\n");
    }
    for i in 0..k * k {
        let a = i / k * (k + 1) + i % k + 1;
        text += &format!(
            "f {a} {} {}\nf {a} {} {}\n",
            a + 1,
            a + k + 2,
            a + k + 2,
            a + k + 1
        );
    }
    text
}

/// Distance from each point to its nearest neighbour, in ascending order.
fn distances(cloud: &PointCloud) -> Vec<f64> {
    let nearest = |p: &DVec3| {
        let others = cloud.positions.iter().filter(|q| *q != p);
        others.map(|q| p.distance(*q)).fold(f64::INFINITY, f64::min)
    };
    let mut all: Vec<f64> = cloud.positions.iter().map(nearest).collect();
    all.sort_by(f64::total_cmp);
    all
}

#[test]
fn samples_are_even_on_coarse_and_fine_meshes() {
    for k in [1, 10, 100] {
        let n = 4096;
        let cloud = sample(&square(k), "obj", points(n));
        assert_eq!(cloud.len(), n);
        assert!(cloud.areas.iter().all(|&a| a == 1.0 / n as f32));
        assert!(cloud.normals.iter().all(|&n| n == Vec3::Z));
        for (p, colour) in cloud.positions.iter().zip(&cloud.reflectance) {
            assert!(p.z == 3.0 && p.min_element() >= 0.0 && p.max(DVec3::Z * 9.0).x <= 1.0);
            assert_eq!(colour.z, 0.0);
        }
        // Points in 16 by 16 squares, of 16 each: independent ones would vary by 4.
        let mut counts = [[0i32; 16]; 16];
        for p in &cloud.positions {
            counts[(p.x * 16.0) as usize][(p.y * 16.0) as usize] += 1;
        }
        let squares: i32 = counts.iter().flatten().map(|c| (c - 16).pow(2)).sum();
        let deviation = (f64::from(squares) / 256.0).sqrt();
        let distances = distances(&cloud);
        let low = distances[n / 20] * 64.0;
        // At most 1.56 and at least 0.33; independent points have 4 and 0.13.
        assert!(deviation < 2.0 && low > 0.3, "{k}: {deviation} {low}");
    }
}

#[test]
fn colours_are_interpolated() {
    let cloud = sample(&square(1), "obj", points(1000));
    // The corners are red 0 and 1, whose reflectance is 0 and 0.9.
    for (p, r) in cloud.positions.iter().zip(&cloud.reflectance) {
        assert!((f64::from(r.x) - 0.9 * p.x).abs() < 1e-6, "{p} {r}");
    }
}

#[test]
fn a_spacing_tells_the_number() {
    let spacing = ReadOptions {
        spacing: Some(0.05),
        ..ReadOptions::default()
    };
    assert_eq!(sample(&square(3), "obj", spacing).len(), 400);
    let neither = sample(&square(3), "obj", ReadOptions::default());
    assert_eq!(neither.len(), 20_000);
    let [a, b] = [0, 1].map(|seed| {
        let options = ReadOptions { seed, ..points(50) };
        sample(&square(3), "obj", options).positions
    });
    assert_ne!(a, b);
}

/// A cube of edge 2 about the origin as PLY, with corners in quads or a polygon of all.
fn cube_ply(encoding: &str) -> Vec<u8> {
    let header = format!(
        "ply\nformat {encoding} 1.0\nelement vertex 8\n{XYZ}\
         element other 1\nproperty list uchar short stuff\n\
         element face 6\nproperty uchar flag\nproperty list uchar int vertex_indices\nend_header\n"
    );
    let quads = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let corner = |i: usize, axis: usize| if i >> axis & 1 == 1 { 1f32 } else { -1.0 };
    if encoding == "ascii" {
        let corners =
            (0..8).map(|i| format!("{} {} {}\n", corner(i, 0), corner(i, 1), corner(i, 2)));
        let quads = quads
            .iter()
            .map(|[a, b, c, d]| format!("9 4 {a} {b} {c} {d}\n"));
        let lines: Vec<String> = corners.chain(["2 7 7\n".into()]).chain(quads).collect();
        return (header + &lines.concat()).into_bytes();
    }
    let mut bytes = header.into_bytes();
    for i in 0..8 {
        (0..3).for_each(|axis| bytes.extend(corner(i, axis).to_le_bytes()));
    }
    bytes.extend([2, 7, 0, 7, 0]);
    for quad in quads {
        bytes.extend([9, 4]);
        quad.iter()
            .for_each(|i: &i32| bytes.extend(i.to_le_bytes()));
    }
    bytes
}

#[test]
fn faces_of_ply_files_give_normals_or_samples() {
    for encoding in ["ascii", "binary_little_endian"] {
        let bytes = cube_ply(encoding);
        let vertices = read(&bytes).unwrap();
        assert_eq!(vertices.repairs, ["no normals: taken from 12 triangles"]);
        for (p, n) in vertices.positions.iter().zip(&vertices.normals) {
            // Outward, if not quite along the diagonal: quads are cut one way.
            assert!(n.dot(p.as_vec3().normalize()) > 0.8 && n.is_normalized());
        }
        let file = named(&bytes, "ply");
        let sampled = Scan::read(file.path(), &points(600), &Silent)
            .unwrap()
            .cloud;
        assert!((sampled.areas.iter().sum::<f32>() - 24.0).abs() < 1e-3);
        for (p, n) in sampled.positions.iter().zip(&sampled.normals) {
            assert!((p.dot(n.as_dvec3()) - 1.0).abs() < 1e-12, "{p} {n}");
        }
        for side in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Z] {
            let on = sampled
                .normals
                .iter()
                .filter(|n| n.as_dvec3().dot(side) > 0.9);
            assert!((on.count() as i32 - 100).abs() <= 1);
        }

        // Damaged faces leave the vertices what they are, but are no surface.
        for end in [bytes.len() - 2, bytes.len() - 30] {
            let cut = read(&bytes[..end]).unwrap();
            assert_eq!(cut.positions, vertices.positions);
            assert!(cut.normals.is_empty() && cut.repairs[0].starts_with("faces left out: "));
            let file = named(&bytes[..end], "ply");
            let error = Scan::read(file.path(), &points(600), &Silent).unwrap_err();
            assert!(matches!(error, Error::Input { .. }), "{error}");
        }
    }
}

/// A square of two triangles, with the faces before the vertices.
fn faces_first(encoding: &str, corners: [u8; 3]) -> Vec<u8> {
    let header = format!(
        "ply\nformat {encoding} 1.0\nelement face 2\nproperty list uchar int vertex_indices\n\
         element vertex 4\n{XYZ}end_header\n"
    );
    let vertices = [[0u8, 0, 1], [2, 0, 1], [2, 2, 1], [0, 2, 1]];
    let faces = [corners, [0, 2, 3]];
    let text = |row: &[u8; 3]| format!("{} {} {}\n", row[0], row[1], row[2]);
    let mut bytes = header.into_bytes();
    match encoding {
        "ascii" => {
            let faces = faces.iter().map(|face| "3 ".to_owned() + &text(face));
            bytes.extend(
                faces
                    .chain(vertices.iter().map(text))
                    .collect::<String>()
                    .bytes(),
            );
        }
        _ => {
            for face in faces {
                bytes.push(3);
                face.iter()
                    .for_each(|&i| bytes.extend(i32::from(i).to_le_bytes()));
            }
            vertices
                .as_flattened()
                .iter()
                .for_each(|&x| bytes.extend(f32::from(x).to_le_bytes()));
        }
    }
    bytes
}

#[test]
fn faces_may_stand_before_the_vertices() {
    for encoding in ["ascii", "binary_little_endian"] {
        let bytes = faces_first(encoding, [0, 1, 2]);
        let cloud = read(&bytes).unwrap();
        assert_eq!(cloud.positions[2], DVec3::new(2.0, 2.0, 1.0));
        assert_eq!(cloud.normals, [Vec3::Z; 4]);
        let file = named(&bytes, "ply");
        let scan = Scan::read(file.path(), &points(50), &Silent).unwrap();
        assert!(scan.format.ends_with("2 faces"), "{}", scan.format);
        assert!(scan.sampled && (scan.cloud.areas.iter().sum::<f32>() - 4.0).abs() < 1e-5);

        // Damaged faces leave the vertices what they are.
        let damaged = read(&faces_first(encoding, [0, 9, 2])).unwrap();
        assert_eq!(damaged.positions, cloud.positions);
        assert!(damaged.normals.is_empty());
        assert!(damaged.repairs[0].contains("a face has the vertex 9"));
    }
}

/// A wall of 5 by 3 with a door of 1 by 2, as one polygon.
const WALL: [[i32; 2]; 8] = [
    [0, 0],
    [2, 0],
    [2, 2],
    [3, 2],
    [3, 0],
    [5, 0],
    [5, 3],
    [0, 3],
];

#[test]
fn polygons_that_are_not_convex_keep_their_shape() {
    let vertices = |word: &str| WALL.map(|[x, z]| format!("{word}{x} 0 {z}\n")).concat();
    let obj = vertices("v ") + "f 1 2 3 4 5 6 7 8\n";
    // Backwards, and before the vertices.
    let back = "f 8 7 6 5 \\\n 4 3 2 1\n".to_owned() + &vertices("v ");
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex 8\n{XYZ}element face 2\n\
         property list uchar int vertex_indices\nend_header\n{}8 0 1 2 3 4 5 6 7\n2 0 1\n",
        vertices("")
    );
    for (text, ending, side) in [(obj, "obj", -1.0), (back, "obj", 1.0), (ply, "ply", -1.0)] {
        let file = named(text.as_bytes(), ending);
        let options = ReadOptions {
            faces: true,
            ..points(1000)
        };
        let cloud = Scan::read(file.path(), &options, &Silent).unwrap().cloud;
        assert!(
            (cloud.areas.iter().sum::<f32>() - 13.0).abs() < 1e-3,
            "{ending}"
        );
        let in_door = |p: &&DVec3| (2.0..3.0).contains(&p.x) && p.z < 2.0;
        assert_eq!(
            cloud.positions.iter().filter(in_door).count(),
            0,
            "{ending}"
        );
        assert!(cloud.normals.iter().all(|n| n.y == side), "{ending}");
        if ending == "ply" {
            assert_eq!(
                cloud.repairs[0],
                "1 faces of fewer than three corners left out"
            );
        }
    }
}

#[test]
fn points_of_obj_files_have_their_normals() {
    let cloud =
        read(b"v 1 2 3 255 0 188\nv 4 5 6 0 0 0\nvn 0 0 1\nvn 1 0 0\nl 1 2\nf 1 2\n").unwrap();
    assert_eq!(cloud.normals, [Vec3::Z, Vec3::X]);
    assert!((cloud.reflectance[0] - Vec3::new(0.9, 0.0, 0.502_886)).length() < 1e-4);
    assert_eq!(
        cloud.repairs,
        ["1 faces of fewer than three corners left out"]
    );
}

#[test]
fn what_is_wrong_is_told() {
    let cases = [
        ("v 1 2\n", "line 1: a vertex of 2 numbers"),
        ("v 1 2 q\n", "line 1: \"q\" is no number (a vertex)"),
        (
            "v 1 2 3\n\nf 1 1 2\n",
            "line 3: a face has the vertex 2, but there are 1",
        ),
        ("v 1 2 3\nf -1 -2 -1\n", "line 2: a face has the vertex 0"),
        (
            "v 1 2 3\nf 1 1 0\n",
            "line 2: \"0\" is no number (a corner of a face)",
        ),
        ("v 1 2 3\nf 1 1 1\n", "the faces have no area"),
        (
            "v 1 2 nan\nv 0 0 1\nv 0 1 0\nf 1 2 3\n",
            "the faces have no area",
        ),
        (
            "v 1e300 0 0\nv 0 1e300 1\nv 0 1 0\nf 1 2 3\n",
            "the faces have no area",
        ),
        ("o nothing\n", "the file has no vertices"),
    ];
    for (text, expected) in cases {
        let message = error_named(text.as_bytes(), "obj");
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
    let bare = read(b"# points\nv 1 2 3 1\nv 4 5 6\n").unwrap();
    assert_eq!(
        bare.positions,
        [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]
    );
    let far = named(square(1).as_bytes(), "obj");
    let options = ReadOptions {
        spacing: Some(1e-9),
        ..ReadOptions::default()
    };
    let error = Scan::read(far.path(), &options, &Silent).unwrap_err();
    assert!(matches!(error, Error::TooLarge(_)), "{error}");
}

proptest! {
    #[test]
    fn any_triangles_are_sampled_by_area(
        corners in prop::collection::vec([-10.0..10f64, -10.0..10.0, -10.0..10.0], 3..30),
        faces in prop::collection::vec(any::<[prop::sample::Index; 3]>(), 1..40),
        offset in prop::sample::select(vec![0.0, 5e6]),
    ) {
        let vertex = |p: &[f64; 3]| format!("v {:?} {:?} {:?}\n", p[0] + offset, p[1], p[2]);
        let faces: Vec<[usize; 3]> = faces.iter().map(|f| f.map(|i| i.index(corners.len()))).collect();
        let face = |f: &[usize; 3]| format!("f {} {}/7 {}//2\n", f[0] + 1, f[1] + 1, f[2] + 1);
        let text: String = corners.iter().map(vertex).chain(faces.iter().map(face)).collect();
        let area = |f: &[usize; 3]| {
            let [a, b, c] = f.map(|i| DVec3::from(corners[i]) + DVec3::X * offset);
            0.5 * (b - a).cross(c - a).length()
        };
        let total: f64 = faces.iter().map(area).sum();
        prop_assume!(total > 1e-6);
        let cloud = sample(&text, "obj", points(500));
        let sum: f64 = cloud.areas.iter().map(|&a| f64::from(a)).sum();
        prop_assert!((sum / total - 1.0).abs() < 1e-5);
        // Every sample lies on a face with its normal.
        for (p, n) in cloud.positions.iter().zip(&cloud.normals) {
            let on = faces.iter().any(|f| {
                let [a, b, c] = f.map(|i| DVec3::from(corners[i]) + DVec3::X * offset);
                let normal = (b - a).cross(c - a).normalize_or_zero();
                normal.dot(n.as_dvec3()) > 0.999 && (*p - a).dot(normal).abs() < 1e-6
            });
            prop_assert!(on, "{p} {n}");
        }
    }

    #[test]
    fn damaged_files_do_no_harm(
        kind in 0..3,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let (mut bytes, ending) = match kind {
            0 => (square(2).into_bytes(), "obj"),
            1 => (cube_ply("ascii"), "ply"),
            _ => (cube_ply("binary_little_endian"), "ply"),
        };
        for (place, byte) in changes {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        sound(&bytes, ending);
        sound(&bytes[..cut.index(bytes.len())], ending);
    }
}
