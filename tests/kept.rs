//! What files say of their points is in the output, as other readers find it there.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use fmmgi_gpu::output::{self, Paint};
use fmmgi_gpu::progress::{Progress, Silent};
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{IlluminationMap, Scene, scan};
use glam::Vec3;
use las::point::{Classification, Format, ScanDirection};
use las::{Builder, Color, GpsTimeType, Point, Reader, Transform, Vector, Vlr, Writer};
use ply_rs::parser::Parser;
use ply_rs::ply::{DefaultElement, Ply, Property, ScalarType};

/// Hears what is said.
#[derive(Default)]
struct Notes(Mutex<Vec<String>>);

impl Progress for Notes {
    fn note(&self, line: &str) {
        self.0.lock().unwrap().push(line.to_owned());
    }
}

impl Notes {
    fn all(&self) -> String {
        self.0.lock().unwrap().join("\n")
    }
}

fn light(n: usize) -> IlluminationMap {
    let irradiance: Vec<Vec3> = (0..n).map(|i| Vec3::new(0.1, 0.2, i as f32)).collect();
    IlluminationMap {
        radiosity: irradiance.iter().map(|h| h * 0.3).collect(),
        irradiance,
        radius: vec![0.25; n],
        in_transport: (0..n).map(|i| i % 3 > 0).collect(),
        ..IlluminationMap::default()
    }
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Folder(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, text).unwrap();
        path
    }

    /// Lights files together; the path of the output, and what was said.
    fn lit(&self, inputs: &[&Path], name: &str, paint: Option<Paint>) -> (PathBuf, String) {
        let options = SceneOptions::default();
        let scene = Scene::load_all(inputs, &options, &Silent).unwrap();
        let (path, notes) = (self.path(name), Notes::default());
        let map = light(scene.cloud.len());
        output::write_scene(&path, &scene, &map, paint, &notes).unwrap();
        (path, notes.all())
    }
}

/// Bytes that the points of test files have beside their format: a number with a scale, three bytes of nobody,
/// and light of a former run.
const OWN: usize = 9;
const KEPT: usize = 5;
const LIGHT: usize = 25;

fn description(name: &str, kind: u8, options: u8, scale: f64) -> Vec<u8> {
    let mut bytes = vec![0; 192];
    (bytes[2], bytes[3]) = (kind, options);
    bytes[4..4 + name.len()].copy_from_slice(name.as_bytes());
    bytes[112..120].copy_from_slice(&scale.to_le_bytes());
    bytes
}

/// A point with a value in each field of a format.
fn point(i: usize, format: &Format) -> Point {
    let k = i as u16;
    let is_long = format.is_extended;
    let classes = if is_long {
        [2, 6, 64, 200, 18]
    } else {
        [2, 6, 9, 31, 7]
    };
    Point {
        x: 1000.0 + i as f64 * 0.25,
        y: 2000.0 - i as f64 * 0.5,
        z: (i % 7) as f64 * 0.125,
        intensity: k.wrapping_mul(997),
        return_number: 1 + (i % 3) as u8,
        number_of_returns: 3,
        scan_direction: match i % 2 {
            0 => ScanDirection::RightToLeft,
            _ => ScanDirection::LeftToRight,
        },
        is_edge_of_flight_line: i % 5 == 1,
        classification: Classification::new(classes[i % 5]).unwrap(),
        is_synthetic: i % 3 == 1,
        is_key_point: i % 4 == 1,
        is_withheld: i % 6 == 1,
        is_overlap: is_long && i % 7 == 1,
        scanner_channel: if is_long { (i % 4) as u8 } else { 0 },
        scan_angle: if is_long {
            ((i % 90) as i16 * 100) as f32 * 0.006
        } else {
            (i % 90) as f32 - 45.0
        },
        user_data: (i % 251) as u8,
        point_source_id: 7 + k,
        gps_time: format.has_gps_time.then_some(3e8 + i as f64 / 3.0),
        color: format
            .has_color
            .then(|| Color::new(k.wrapping_mul(31), 40_000 + k, 65_535 - k)),
        nir: format.has_nir.then_some(k.wrapping_mul(77)),
        waveform: format.has_waveform.then(|| las::raw::point::Waveform {
            wave_packet_descriptor_index: 1 + (i % 3) as u8,
            byte_offset_to_waveform_data: 60 + i as u64,
            waveform_packet_size_in_bytes: 12,
            return_point_waveform_location: i as f32,
            x_t: 0.5,
            y_t: 0.25,
            z_t: -1.0,
        }),
        extra_bytes: (0..OWN).map(|b| (i * 13 + b * 7) as u8).collect(),
    }
}

/// Writes a file; returns its points as they are read back.
fn las_file(path: &Path, format: u8, points: usize) -> Vec<Point> {
    let mut builder = Builder::from((1, if format < 4 { 2 } else { 4 }));
    builder.point_format = Format::new(format).unwrap();
    builder.point_format.extra_bytes = OWN as u16;
    builder.point_format.is_compressed = path.extension().unwrap() == "laz";
    builder.gps_time_type = GpsTimeType::Standard;
    builder.file_source_id = 77;
    builder.system_identifier = "a scanner".to_owned();
    let axis = |offset| Transform {
        scale: 0.001,
        offset,
    };
    builder.transforms = Vector {
        x: axis(1000.0),
        y: axis(2000.0),
        z: axis(0.0),
    };
    let descriptions = [
        description("temperature", 4, 0b1000, 0.1),
        description("nobody", 0, 3, 0.0),
        description("irradiance_g", 9, 0, 0.0),
    ];
    let record = |user: &str, number: u16, data: Vec<u8>| Vlr {
        user_id: user.to_owned(),
        record_id: number,
        description: "described".to_owned(),
        data,
    };
    builder
        .vlrs
        .push(record("LASF_Projection", 34735, vec![1, 0, 1, 0]));
    builder.vlrs.push(record("somebody", 3, vec![1, 2, 3]));
    builder
        .vlrs
        .push(record("LASF_Spec", 4, descriptions.concat()));
    if builder.version.minor == 4 {
        builder.evlrs.push(record("late", 9, vec![4, 5]));
    }
    let format = builder.point_format;
    let mut writer = Writer::from_path(path, builder.into_header().unwrap()).unwrap();
    for i in 0..points {
        writer.write_point(point(i, &format)).unwrap();
    }
    writer.close().unwrap();
    las_back(path).1
}

/// What a reader of its own finds in a file, and the names of the extra dimensions.
fn las_back(path: &Path) -> (las::Header, Vec<Point>, Vec<String>) {
    let mut reader = Reader::from_path(path).unwrap();
    let header = reader.header().clone();
    let points = reader.read_all().unwrap();
    let points = points.points().map(Result::unwrap).collect();
    let mut records = header.vlrs().iter();
    let described = records.find(|vlr| (vlr.user_id.as_str(), vlr.record_id) == ("LASF_Spec", 4));
    let names = described.unwrap().data.chunks(192).map(|d| {
        let name = String::from_utf8_lossy(&d[4..36]);
        name.trim_end_matches('\0').to_owned()
    });
    (header.clone(), points, names.collect())
}

const LIGHT_NAMES: [&str; 7] = [
    "irradiance_r",
    "irradiance_g",
    "irradiance_b",
    "radiosity_r",
    "radiosity_g",
    "radiosity_b",
    "in_transport",
];

#[test]
fn las_keeps_every_field_of_every_point_format() {
    let folder = Folder::new();
    // More than a chunk of compression in some.
    for (format, n) in (0..=10).map(|format| (format, if format % 5 == 1 { 60_000 } else { 300 })) {
        for (input, output) in [("a.las", "b.laz"), ("a.laz", "c.las"), ("a.laz", "d.laz")] {
            let input = folder.path(input);
            let points = las_file(&input, format, n);
            let (path, notes) = folder.lit(&[&input], output, None);
            let (header, back, names) = las_back(&path);
            let what = format!("format {format} in {output}");
            assert_eq!(
                header.point_format().to_u8().unwrap() & 0x3f,
                format,
                "{what}"
            );
            assert_eq!(names[..2], ["temperature", "nobody"], "{what}");
            assert_eq!(names[2..], LIGHT_NAMES, "{what}");
            assert_eq!(back.len(), n);
            let map = light(n);
            for (i, (mut back, mut point)) in back.into_iter().zip(points).enumerate() {
                point.extra_bytes.truncate(KEPT);
                let own = back.extra_bytes.split_off(KEPT);
                assert_eq!(back, point, "{what}: point {i}");
                assert_eq!(own.len(), LIGHT);
                let blue = f32::from_le_bytes(own[8..12].try_into().unwrap());
                assert_eq!(blue, map.irradiance[i].z);
                assert_eq!(own[24], u8::from(map.in_transport[i]));
            }
            assert_eq!(header.gps_time_type(), GpsTimeType::Standard);
            assert_eq!(header.file_source_id(), 77);
            assert_eq!(header.system_identifier(), "a scanner");
            let users = |records: &[Vlr]| -> Vec<String> {
                records.iter().map(|r| r.user_id.clone()).collect()
            };
            let before = users(header.vlrs());
            for user in ["somebody", "LASF_Projection"] {
                let found = before.iter().filter(|other| *other == user);
                assert_eq!(found.count(), 1, "{what}: {user}");
            }
            assert_eq!(header.evlrs().len(), usize::from(format >= 4), "{what}");
            assert_eq!(
                notes.contains("waveforms"),
                [4, 5, 9, 10].contains(&format),
                "{notes}"
            );
        }
    }
}

#[test]
fn colours_of_las_are_painted_when_asked() {
    let folder = Folder::new();
    for format in 0..=10 {
        let input = folder.path("a.las");
        let points = las_file(&input, format, 50);
        for paint in [Paint::Lit, Paint::Irradiance] {
            let (path, _) = folder.lit(&[&input], "b.las", Some(paint));
            let (header, back, names) = las_back(&path);
            let had_colours = points[0].color.is_some();
            let expected = match format {
                0 => 2,
                1 => 3,
                4 => 5,
                6 => 7,
                9 => 10,
                other => other,
            };
            assert_eq!(header.point_format().to_u8().unwrap(), expected);
            assert_eq!(names.contains(&"original_green".to_owned()), had_colours);
            for (mut back, point) in back.into_iter().zip(&points) {
                let painted = back.color.unwrap();
                assert_eq!(painted.red % 257, 0);
                if let Some(color) = point.color {
                    let original = [color.red, color.green, color.blue].map(u16::to_le_bytes);
                    assert_eq!(back.extra_bytes[KEPT..KEPT + 6], *original.as_flattened());
                }
                back.color = point.color;
                back.nir = point.nir;
                back.extra_bytes = point.extra_bytes.clone();
                assert_eq!(back, *point);
            }
            // Once more: the colours that were photographed stay what they were.
            if had_colours {
                let (again, _) = folder.lit(&[&path], "c.las", Some(paint));
                let read = |path: &Path| scan::read(path, &Silent).unwrap().reflectance;
                assert_eq!(read(&again), read(&input));
                let (_, again, names) = las_back(&again);
                let is_original = |name: &&String| name.starts_with("original");
                assert_eq!(names.iter().filter(is_original).count(), 3);
                let color = points[7].color.unwrap();
                let original = [color.red, color.green, color.blue].map(u16::to_le_bytes);
                let bytes = &again[7].extra_bytes;
                assert_eq!(bytes[KEPT..KEPT + 6], *original.as_flattened());
            }
        }
    }
}

#[test]
fn las_files_are_merged() {
    let folder = Folder::new();
    let (a, b) = (folder.path("a.las"), folder.path("b.laz"));
    let (points, more) = (las_file(&a, 1, 40), las_file(&b, 3, 30));
    let (path, notes) = folder.lit(&[&a, &b], "c.laz", None);
    assert!(
        notes.contains("a.las: has no red green blue, which are 0 there"),
        "{notes}"
    );
    let (header, back, _) = las_back(&path);
    assert_eq!(header.point_format().to_u8().unwrap() & 0x3f, 3);
    for (mut back, mut point) in back.into_iter().zip(points.into_iter().chain(more)) {
        back.extra_bytes.truncate(KEPT);
        point.extra_bytes.truncate(KEPT);
        point.color = point.color.or(Some(Color::new(0, 0, 0)));
        assert_eq!(back, point);
    }
    // The two families of formats have no field in common: all become extra dimensions.
    las_file(&b, 7, 30);
    let (path, notes) = folder.lit(&[&a, &b], "c.las", None);
    assert!(notes.contains("extra dimensions"), "{notes}");
    let (_, back, names) = las_back(&path);
    assert_eq!(back.len(), 70);
    assert!(names.contains(&"gps_time".to_owned()), "{names:?}");
}

/// A PLY file of another writer's: binary of both kinds, or ascii.
fn ply_file(folder: &Folder, encoding: &str, points: usize) -> PathBuf {
    let path = folder.path(&format!("{encoding}.ply"));
    let mut file = BufWriter::new(File::create(&path).unwrap());
    write!(
        file,
        "ply\nformat {encoding} 1.0\nelement vertex {points}\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nproperty double y\nproperty float x\nproperty double z\nproperty char label\n\
         property ushort scalar_Intensity\nproperty int row\nproperty uint id\nproperty short s\n\
         property double gps_time\nproperty float nx\nproperty float ny\nproperty float nz\nend_header\n"
    )
    .unwrap();
    for i in 0..points {
        let v = ply_row(i);
        if encoding == "ascii" {
            let words: Vec<String> = v.iter().map(f64::to_string).collect();
            writeln!(file, "{}", words.join(" ")).unwrap();
            continue;
        }
        macro_rules! put {
            ($type:ty, $k:expr) => {{
                let value = v[$k] as $type;
                let bytes = match encoding {
                    "binary_big_endian" => value.to_be_bytes(),
                    _ => value.to_le_bytes(),
                };
                file.write_all(&bytes).unwrap();
            }};
        }
        (0..3).for_each(|k| put!(u8, k));
        put!(f64, 3);
        put!(f32, 4);
        put!(f64, 5);
        put!(i8, 6);
        put!(u16, 7);
        put!(i32, 8);
        put!(u32, 9);
        put!(i16, 10);
        put!(f64, 11);
        (12..15).for_each(|k| put!(f32, k));
    }
    file.flush().unwrap();
    path
}

const PLY_NAMES: [&str; 15] = [
    "red",
    "green",
    "blue",
    "y",
    "x",
    "z",
    "label",
    "scalar_Intensity",
    "row",
    "id",
    "s",
    "gps_time",
    "nx",
    "ny",
    "nz",
];

fn ply_row(i: usize) -> [f64; 15] {
    let f = i as f64;
    let id = 4e9 + f;
    [
        (i % 256) as f64,
        7.0,
        255.0,
        f / 3.0,
        0.5 * f,
        1e7 + 0.1 * f,
        (i % 200) as f64 - 100.0,
        (i % 65_536) as f64,
        -f,
        id,
        -3.0,
        1e9 + f / 7.0,
        0.0,
        0.6,
        0.8,
    ]
}

fn ply_back(path: &Path) -> Ply<DefaultElement> {
    let mut file = File::open(path).unwrap();
    Parser::new().read_ply(&mut file).unwrap()
}

fn number(property: &Property) -> f64 {
    match *property {
        Property::Char(v) => v.into(),
        Property::UChar(v) => v.into(),
        Property::Short(v) => v.into(),
        Property::UShort(v) => v.into(),
        Property::Int(v) => v.into(),
        Property::UInt(v) => v.into(),
        Property::Float(v) => v.into(),
        Property::Double(v) => v,
        _ => panic!("a list"),
    }
}

#[test]
fn ply_keeps_every_property_in_its_type() {
    let folder = Folder::new();
    let n = 300;
    let mut whole = Vec::new();
    for encoding in ["binary_little_endian", "binary_big_endian", "ascii"] {
        let input = ply_file(&folder, encoding, n);
        let types = ply_back(&input).header.elements["vertex"]
            .properties
            .clone();
        for paint in [None, Some(Paint::Keep)] {
            let (path, notes) = folder.lit(&[&input], "out.ply", paint);
            assert_eq!(notes, "");
            whole.push(fs::read(&path).unwrap());
            let back = ply_back(&path);
            let properties = &back.header.elements["vertex"].properties;
            for (i, vertex) in back.payload["vertex"].iter().enumerate() {
                for (name, value) in PLY_NAMES.into_iter().zip(ply_row(i)) {
                    let is_colour = ["red", "green", "blue"].contains(&name);
                    let kept = match paint {
                        None if is_colour => format!("original_{name}"),
                        _ => name.to_owned(),
                    };
                    assert_eq!(properties[&kept].data_type, types[name].data_type, "{name}");
                    let value = match name {
                        "x" => f64::from(value as f32),
                        "nx" | "ny" | "nz" => f64::from(value as f32),
                        _ => value,
                    };
                    assert_eq!(number(&vertex[&kept]), value, "{encoding}: {name} of {i}");
                }
                assert_eq!(number(&vertex["scalar_irradiance_b"]), i as f64);
                assert_eq!(number(&vertex["radius"]), 0.25);
                if paint.is_none() {
                    let red = &properties["red"].data_type;
                    assert_eq!(*red, ply_rs::ply::PropertyType::Scalar(ScalarType::UChar));
                }
            }
        }
        // Lit once more, the light is new, and the colours are those of the beginning, of which the reflectances come.
        let (first, _) = folder.lit(&[&input], "first.ply", None);
        let (second, _) = folder.lit(&[&first], "second.ply", None);
        let names = |path: &Path| -> Vec<String> {
            let mut names: Vec<String> =
                (ply_back(path).header.elements["vertex"].properties.keys())
                    .cloned()
                    .collect();
            names.sort();
            names
        };
        assert_eq!(names(&first), names(&second));
        let read = |path: &Path| scan::read(path, &Silent).unwrap().reflectance;
        assert_eq!(read(&second), read(&input));
        let vertex = &ply_back(&second).payload["vertex"][9];
        assert_eq!(number(&vertex["original_red"]), 9.0);
    }
    // However the input is written.
    assert!(whole[0] == whole[2] && whole[1] == whole[5]);
}

#[test]
fn texts_keep_their_columns_as_they_are_written() {
    let folder = Folder::new();
    let text = "X;Y;Z;R;G;B;stamp;what;\"a, b\"\n\
                1.50;2;3;255;0;7;1305031102175304000;wall;0.10\n\
                2.50;2;4;25;0;7;1305031102175304001;\"the floor, here\";1e3\n\
                3;2;5;1;2;7;1305031102175304002;;\n";
    let input = folder.text("a.csv", text);
    let (path, notes) = folder.lit(&[&input], "b.csv", None);
    assert_eq!(notes, "");
    let lines: Vec<String> = fs::read_to_string(&path)
        .unwrap()
        .lines()
        .map(str::to_owned)
        .collect();
    let header = "x,y,z,original_red,original_green,original_blue,stamp,what,\"a, b\",nx,ny,nz,red,green,blue,radius,";
    assert!(lines[0].starts_with(header), "{}", lines[0]);
    let begins = [
        "1.50,2,3,255,0,7,1305031102175304000,wall,0.10,",
        "2.50,2,4,25,0,7,1305031102175304001,\"the floor, here\",1e3,",
        "3,2,5,1,2,7,1305031102175304002,,,",
    ];
    for (line, begin) in lines[1..].iter().zip(begins) {
        assert!(line.starts_with(begin), "{line}");
    }
    assert_eq!(lines.len(), 4);

    let (path, notes) = folder.lit(&[&input], "b.ply", None);
    assert!(notes.contains("column what, which is no number"), "{notes}");
    let back = ply_back(&path);
    let vertex = &back.payload["vertex"][1];
    assert_eq!(number(&vertex["original_red"]), 25.0);
    assert_eq!(number(&vertex["scalar_a__b"]), 1000.0);
}

#[test]
fn formats_hold_what_others_have() {
    let folder = Folder::new();
    let las = folder.path("a.laz");
    let points = las_file(&las, 3, 100);
    let (path, notes) = folder.lit(&[&las], "a.ply", None);
    assert!(notes.contains("extra bytes \"nobody\""), "{notes}");
    for (vertex, point) in ply_back(&path).payload["vertex"].iter().zip(&points) {
        let of = |name: &str| number(&vertex[name]);
        assert_eq!(of("scalar_intensity"), f64::from(point.intensity));
        assert_eq!(of("scalar_gps_time"), point.gps_time.unwrap());
        assert_eq!(
            of("scalar_classification"),
            f64::from(u8::from(point.classification))
        );
        assert_eq!(
            of("scalar_withheld"),
            f64::from(u8::from(point.is_withheld))
        );
        assert_eq!(of("scalar_source_id"), f64::from(point.point_source_id));
        assert_eq!(of("original_blue"), f64::from(point.color.unwrap().blue));
        let raw = i16::from_le_bytes([point.extra_bytes[0], point.extra_bytes[1]]);
        assert_eq!(of("scalar_temperature"), f64::from(raw) * 0.1);
    }
    let ply = ply_file(&folder, "ascii", 50);
    let (path, _) = folder.lit(&[&ply], "p.las", None);
    let (_, back, names) = las_back(&path);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let kept = [
        "label",
        "Intensity",
        "row",
        "id",
        "s",
        "gps_time",
        "nx",
        "ny",
        "nz",
    ];
    assert_eq!(names[..9], kept);
    for (i, point) in back.iter().enumerate() {
        let row = ply_row(i);
        assert_eq!(point.color.unwrap().red, row[0] as u16 * 257);
        let bytes = &point.extra_bytes;
        assert_eq!(u16::from_le_bytes([bytes[1], bytes[2]]), row[7] as u16);
    }
    // Files of two formats: what both have is one column.
    let text = folder.text("t.csv", "x,y,z,intensity,what\n1001,2001,0,7.5,wall\n");
    let (path, notes) = folder.lit(&[&las, &text], "both.csv", None);
    assert!(notes.contains("a.laz: has no what"), "{notes}");
    let csv = fs::read_to_string(&path).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 102);
    let of = |row: usize, name: &str| {
        rows[row][rows[0].iter().position(|other| *other == name).unwrap()]
    };
    assert_eq!(of(4, "intensity"), points[3].intensity.to_string());
    assert_eq!((of(101, "intensity"), of(101, "what")), ("7.5", "wall"));
    assert_eq!(
        (of(101, "x"), of(101, "user_data"), of(4, "what")),
        ("1001", "", "")
    );
}

#[test]
fn moved_and_sampled_points_keep_what_is_still_true() {
    let folder = Folder::new();
    let las = folder.path("a.laz");
    let points = las_file(&las, 1, 60);
    ply_file(&folder, "ascii", 20);
    let scene = folder.text(
        "scene.toml",
        "points = 30\n[[shape]]\nsphere = { centre = [0, 0, 0], radius = 1 }\n\
         [[cloud]]\nfile = 'a.laz'\ntranslate = [-1000, -2000, 0]\n",
    );
    let (path, _) = folder.lit(&[&scene], "s.ply", None);
    let vertices = &ply_back(&path).payload["vertex"];
    assert_eq!(vertices.len(), 90);
    for (vertex, point) in vertices[30..].iter().zip(&points) {
        let of = |name: &str| number(&vertex[name]);
        assert!((of("x") - (point.x - 1000.0)).abs() < 1e-4);
        assert_eq!(of("scalar_gps_time"), point.gps_time.unwrap());
        assert_eq!(of("scalar_intensity"), f64::from(point.intensity));
    }
    // Points on shapes have none.
    assert!(number(&vertices[0]["scalar_gps_time"]).is_nan());
    assert_eq!(number(&vertices[0]["scalar_intensity"]), 0.0);

    let scene = folder.text(
        "turned.toml",
        "[[cloud]]\nfile = 'ascii.ply'\nrotate = [90, 0, 0]\n",
    );
    let (path, _) = folder.lit(&[&scene], "t.ply", Some(Paint::Keep));
    for (i, vertex) in ply_back(&path).payload["vertex"].iter().enumerate() {
        let of = |name: &str| number(&vertex[name]);
        let row = ply_row(i);
        assert!((of("y") + row[5]).abs() < 1e-6 && (of("z") - row[3]).abs() < 1e-6);
        assert!((of("ny") + 0.8).abs() < 1e-6 && (of("nz") - 0.6).abs() < 1e-6);
        assert_eq!((of("red"), of("id")), (row[0], row[9]));
    }
    let scene = folder.text("moved.toml", "[[cloud]]\nfile = 'a.laz'\nscale = 2\n");
    let (path, _) = folder.lit(&[&scene], "m.laz", None);
    for (back, point) in las_back(&path).1.iter().zip(&points) {
        assert!((back.x - 2.0 * point.x).abs() < 1e-4);
        assert_eq!(back.gps_time, point.gps_time);
        assert_eq!(back.extra_bytes[..KEPT], point.extra_bytes[..KEPT]);
    }
}

#[test]
fn a_file_that_has_changed_is_told() {
    let folder = Folder::new();
    let input = folder.path("a.las");
    las_file(&input, 1, 100);
    let scene = Scene::load(&input, &SceneOptions::default(), &Silent).unwrap();
    let write = |notes: &Notes| {
        output::write_scene(&folder.path("b.las"), &scene, &light(100), None, notes)
    };
    las_file(&input, 1, 99);
    let error = write(&Notes::default()).unwrap_err().to_string();
    assert!(error.contains("has changed since it was read"), "{error}");
    assert!(!folder.path("b.las").exists());
    fs::remove_file(&input).unwrap();
    let notes = Notes::default();
    write(&notes).unwrap();
    assert!(notes.all().contains("left out"), "{}", notes.all());
}
