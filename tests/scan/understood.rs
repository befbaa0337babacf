//! What the properties mean, in every encoding.

use glam::{DVec3, Vec3};

use super::*;

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
    // Floats up to 1, up to 255, whole numbers of 8 bits in more, signed bytes: all say the same.
    for (kind, values) in [
        ("float", "1 0 0.737255"),
        ("double", "255 0 188"),
        ("float", "255.0 0 188.0"),
        ("ushort", "255 0 188"),
        ("int", "255 0 188"),
        ("char", "-1 0 -68"),
        ("ushort", "65280 0 48128"),
    ] {
        let (reflectance, _) = colour(kind, values);
        let expected = Vec3::new(0.9, 0.0, 0.502_886);
        assert!(
            (reflectance - expected).length() < 1e-4,
            "{kind} {values}: {reflectance}"
        );
    }
    let (black, repairs) = colour("uchar", "0 0 0");
    assert_eq!(black, Vec3::splat(0.5));
    assert_eq!(repairs, ["2 colours left out: all are black"]);
    let (unknown, repairs) = colour("int", "1 2 70000");
    assert_eq!(unknown, Vec3::splat(0.5));
    assert!(repairs[0].contains("values up to 70000 are of no known depth"));
    let none = read(&two_points("", "", "")).unwrap();
    assert_eq!(none.reflectance, [Vec3::splat(0.5); 2]);
}

#[test]
fn colours_are_what_they_are_told_to_be() {
    let properties = ["red", "green", "blue"].map(|name| format!("property float {name}\n"));
    let file = file(&two_points(&properties.concat(), "1 0 0.5", "0 0 0"));
    let read = |colours| {
        let options = ReadOptions {
            colours,
            ..ReadOptions::default()
        };
        Scan::read(file.path(), &options, &Silent).unwrap()
    };
    let taken = read(None);
    assert!((taken.cloud.reflectance[0] - Vec3::new(0.9, 0.0, 0.214_041)).length() < 1e-5);
    assert!(
        taken
            .taken
            .contains("colours red green blue: sRGB, 0 to 1 (if they are linear")
    );
    let linear = read(Some(ColourSpace::Linear)).cloud.reflectance[0];
    assert_eq!(linear, Vec3::new(1.0, 0.0, 0.5));
    let dark = read(Some(ColourSpace::Srgb8)).cloud.reflectance[0];
    assert!(dark.x < 1e-3 && dark.x > 0.0);
}

#[test]
fn one_table_has_the_names_of_all_formats() {
    let names = |names: &[&str], kind: &str| {
        let line = |name: &&str| format!("property {kind} {name}\n");
        names.iter().map(line).collect::<String>()
    };
    for (normals, colours) in [
        (
            ["NormalX", "NormalY", "NormalZ"],
            ["diffuse_red", "diffuse_green", "diffuse_blue"],
        ),
        (["normal_x", "normal_y", "normal_z"], ["R", "G", "B"]),
        (["Nx", "Ny", "Nz"], ["scalar_Rf", "scalar_Gf", "scalar_Bf"]),
    ] {
        let extra = names(&normals, "float") + &names(&colours, "float");
        let cloud = read(&two_points(&extra, "0 0 1 255 0 188", "1 0 0 0 0 0")).unwrap();
        assert_eq!(cloud.normals, [Vec3::Z, Vec3::X]);
        assert!((cloud.reflectance[0] - Vec3::new(0.9, 0.0, 0.502_886)).length() < 1e-4);
    }
    // Splats: 0.5 + 0.28209 f.
    let splats = names(&["f_dc_0", "f_dc_1", "f_dc_2"], "float");
    let cloud = read(&two_points(&splats, "9 -9 0.841063", "0 0 0")).unwrap();
    assert!((cloud.reflectance[0] - Vec3::new(0.9, 0.0, 0.502_886)).length() < 1e-4);
    assert!((cloud.reflectance[1].x - 0.214_041).abs() < 1e-5);
    // A share of the light is grey, decibels are not.
    let grey = read(&two_points("property float reflectance\n", "0.25", "1")).unwrap();
    assert_eq!(grey.reflectance, [Vec3::splat(0.25), Vec3::ONE]);
    let decibels = read(&two_points("property float reflectance\n", "-12.5", "-3")).unwrap();
    assert_eq!(decibels.reflectance, [Vec3::splat(0.5); 2]);
    assert_eq!(
        decibels.repairs,
        ["2 reflectances left out: not all are from 0 to 1"]
    );
    let packed = read(&two_points(
        "property uint rgba\n",
        "4294901948",
        "4278190080",
    ))
    .unwrap();
    assert!((packed.reflectance[0] - Vec3::new(0.9, 0.0, 0.502_886)).length() < 1e-4);
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
        "0 0 0 inf 0 1e16 nan",
    ))
    .unwrap();
    assert_eq!(cloud.reflectance[0], Vec3::new(0.5, 1.0, 0.0));
    assert_eq!(cloud.emission, [Vec3::Z, Vec3::Z * 1e15]);
    assert_eq!(cloud.areas, [0.0; 2]);
    assert_eq!(
        cloud.repairs,
        [
            "1 reflectances that are no number set to 0.5",
            "1 reflectances outside [0, 1] clamped",
            "2 emissions that are negative or no number set to 0",
            "1 emissions above 1e15 reduced to that",
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
fn headers_and_lines_are_read_as_people_write_them() {
    let plain = two_points(
        "property uchar red\nproperty uchar green\nproperty uchar blue\n",
        "255 0 188",
        "0 0 0",
    );
    let expected = read(&plain).unwrap();
    let text = String::from_utf8(plain).unwrap();
    let many = format!(
        "ply\nformat ascii 1.0\nelement vertex 9999\n{XYZ}end_header\n{}",
        "1 2\n3\n".repeat(9999)
    );
    for other in [
        format!("\u{feff}{text}"),
        text.replace("ascii 1.0\n", "ascii 1.0\n\n"),
        text.replace("uchar", "UCHAR"),
        text.replace("3 255", "3\n255").replace("6 0", "6\n0"),
        text.replace("3 255 0", "3\n255\n0")
            .replace("6 0 0", "6\n0\n0"),
        text.replace("property float x", "property int64 t\nproperty float x")
            .replace("1 2 3", "1234567890123 1 2 3")
            .replace("4 5 6", "1 4 5 6"),
    ] {
        let cloud = read(other.as_bytes()).unwrap_or_else(|error| panic!("{other}: {error}"));
        assert_eq!(cloud.positions, expected.positions, "{other}");
        assert_eq!(cloud.reflectance, expected.reflectance, "{other}");
    }
    let cloud = read(many.as_bytes()).unwrap();
    assert!(
        cloud.len() == 9999
            && cloud
                .positions
                .iter()
                .all(|p| *p == DVec3::new(1.0, 2.0, 3.0))
    );
    let message = error(many.replacen("3\n1 2\n3\n1", "3\n1 x\n3\n1", 1).as_bytes());
    assert!(
        message.contains("\"x\" is no number (property \"y\")"),
        "{message}"
    );

    let mut bytes =
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty uint64 red\n".to_vec();
    bytes.extend(format!("property uint64 green\nproperty uint64 blue\n{XYZ}end_header\n").bytes());
    bytes.extend([7u64; 3].map(u64::to_le_bytes).concat());
    bytes.extend([1f32, 2.0, 3.0].map(f32::to_le_bytes).concat());
    let cloud = read(&bytes).unwrap();
    assert_eq!(cloud.positions, [DVec3::new(1.0, 2.0, 3.0)]);
    assert_eq!(cloud.reflectance, [Vec3::splat(0.5)]);
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

#[test]
fn packed_colours_keep_their_bits() {
    // A subnormal number, a large one, a signalling and a quiet word for none.
    let colours = [0x0001_0203u32, 0x7f7f_8040, 0xff81_0203, 0xffc8_6432];
    let expected = read(&ascii(&format!(
        "element vertex 4\n{XYZ}property uchar red\nproperty uchar green\nproperty uchar blue\n\
         end_header\n{}",
        colours
            .map(|c| {
                let [b, g, r, _] = c.to_le_bytes();
                format!("0 0 0 {r} {g} {b}\n")
            })
            .concat()
    )));
    let expected = expected.unwrap().reflectance;
    for (name, big) in [("little", false), ("big", true)] {
        for list in ["", "property list uchar float weights\n"] {
            let mut bytes = format!(
                "ply\nformat binary_{name}_endian 1.0\nelement vertex 4\n{XYZ}{list}\
                 property float rgb\nend_header\n"
            )
            .into_bytes();
            for colour in colours {
                bytes.extend([0; 12]);
                bytes.extend((!list.is_empty()).then_some(0));
                bytes.extend(match big {
                    true => colour.to_be_bytes(),
                    false => colour.to_le_bytes(),
                });
            }
            assert_eq!(read(&bytes).unwrap().reflectance, expected, "{name} {list}");
        }
    }
}
