//! The format of scene files: everything in them arrives, and bad ones are refused in words.

use std::fs;
use std::path::Path;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Error, PointCloud, Result, Scene};
use glam::{DVec3, Vec3, dvec3};
use proptest::prelude::*;

fn load_text(text: &str, points: impl Into<Option<usize>>) -> Result<Scene> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    fs::write(&path, text).unwrap();
    let points = points.into();
    Scene::load(
        &path,
        &SceneOptions {
            points,
            seed: 1,
            ..SceneOptions::default()
        },
        &Silent,
    )
}

fn shape(shape: &str, points: usize) -> PointCloud {
    load_text(&format!("[[shape]]\n{shape}"), points)
        .unwrap()
        .cloud
}

const QUAD: &str = "quad = { corner = [1, 2, 3], u = [2, 0, 0], v = [1, 3, 0] }";
const BLOCK: &str = "box = { centre = [1, 2, 3], size = [1, 2, 3], rotate = [10, 20, 30] }";
const SPHERE: &str = "sphere = { centre = [5, 0, 0], radius = 2 }";

#[test]
fn everything_in_a_scene_file_arrives() {
    let text = r#"
        points = 10
        tolerance = 0.01
        sky = [0.1, 0.2, 0.3]
        [camera]
        position = [0, 0, 5]
        look_at = [0, 0, 0]
        [[light]]
        position = [1, 2, 3]
        intensity = 4
        [[shape]]
        quad = { corner = [0, 0, 0], u = [1, 0, 0], v = [0, 1, 0] }
        reflectance = [0.1, 0.2, 0.3]
        emission = 2
        [[shape]]
        box = { centre = [5, 0, 0], size = [1, 1, 1], open = ["left", "back"], faces = { top = 0.9 } }
    "#;
    let scene = load_text(text, None).unwrap();
    assert_eq!(scene.cloud.len(), 10);
    assert_eq!(scene.tolerance, Some(0.01));
    assert_eq!(scene.sky, Vec3::new(0.1, 0.2, 0.3));
    let camera = scene.camera.unwrap();
    assert_eq!((camera.up, camera.fov), (DVec3::Y, 45.0));
    assert_eq!(scene.lights.len(), 1);
    assert_eq!(scene.lights[0].position, dvec3(1.0, 2.0, 3.0));
    assert_eq!(scene.lights[0].intensity, Vec3::splat(4.0));
    let cloud = &scene.cloud;
    assert_eq!(cloud.reflectance[0], Vec3::new(0.1, 0.2, 0.3));
    assert_eq!(cloud.emission[0], Vec3::splat(2.0));
    assert_eq!(cloud.normals[0], Vec3::Z);
    for i in (0..10).filter(|&i| cloud.positions[i].x > 2.0) {
        let top = cloud.normals[i].y > 0.5;
        assert_eq!(cloud.reflectance[i].x, if top { 0.9 } else { 0.5 });
        assert!(cloud.normals[i].x > -0.5 && cloud.normals[i].z > -0.5);
    }
    // A quarter turn about y takes z to x, and the front with it.
    let turned =
        "box = { centre = [0, 0, 0], size = [1, 1, 1], rotate = [0, 90, 0], open = [\"front\"] }";
    assert!(shape(turned, 60).normals.iter().all(|n| n.x < 0.5));
    // About x first, then y: y goes to z, and z to x.
    let turned =
        "box = { centre = [0, 0, 0], size = [1, 1, 1], rotate = [90, 90, 0], open = [\"top\"] }";
    assert!(shape(turned, 60).normals.iter().all(|n| n.x < 0.5));
}

#[test]
fn bad_scene_files_are_refused_in_words() {
    let camera = |rest: &str| format!("[camera]\n{rest}\n[[shape]]\n{QUAD}");
    let with = |rest: &str| format!("[[shape]]\n{rest}");
    let cases: &[(String, &[&str])] = &[
        ("".into(), &["nothing to light"]),
        ("points = [".into(), &["line 1"]),
        (
            "\nsky = 1\nskye = 2".into(),
            &["line 3", "unknown key `skye`", "tolerance", "light"],
        ),
        (
            with(&format!("{QUAD}\nreflectence = 1")),
            &["line 3", "reflectence", "`reflectance`"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0], w = [0,1,0] }"),
            &["line 2", "`w`", "`v`"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0] }"),
            &["line 2", "missing key", "`v`"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0], v = [2,0,0] }"),
            &["line 2", "span an area"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1,0,0], v = [0,0,0] }"),
            &["span an area"],
        ),
        (
            with("quad = { corner = [0,0,0], u = [1e-25,0,0], v = [0,1e-25,0] }"),
            &["span an area"],
        ),
        (
            with("quad = { corner = [0,0,nan], u = [1,0,0], v = [0,1,0] }"),
            &["line 2", "NaN"],
        ),
        (
            with("quad = { corner = [0,0,inf], u = [1,0,0], v = [0,1,0] }"),
            &["inf"],
        ),
        (
            with("quad = { corner = [0,0], u = [1,0,0], v = [0,1,0] }"),
            &["three numbers", "got 2"],
        ),
        (
            with("quad = { corner = [0,0,0,0], u = [1,0,0], v = [0,1,0] }"),
            &["got 4"],
        ),
        (with("quad = 3"), &["line 2", "expected a table", "corner"]),
        (
            with("quad = { corner = 1, u = [1,0,0], v = [0,1,0] }"),
            &["expected a list of numbers"],
        ),
        (
            with(
                "quad = { corner = [0,0,0], u = [1,0,0], v = [0,1,0], hole = { u = [0.5, 1.5], v = [0, 0.5] } }",
            ),
            &["hole", "within the edges"],
        ),
        (
            with(
                "quad = { corner = [0,0,0], u = [1,0,0], v = [0,1,0], hole = { u = [0, 1], v = [0, 1] } }",
            ),
            &["leaves nothing"],
        ),
        (
            with(
                "quad = { corner = [0,0,0], u = [1,0,0], v = [0,1,0], hole = { u = [0.5, 0.5], v = [0, 1] } }",
            ),
            &["from < to"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 0 }"),
            &["line 2", "above 0"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = -1 }"),
            &["above 0"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1e300 }"),
            &["1e12"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1, bumps = 2 }"),
            &["bumps 2", "0.8"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1, bumps = nan }"),
            &["bumps NaN"],
        ),
        (
            with("sphere = { centre = [0,0,0], radius = 1, inward = 1 }"),
            &["expected a boolean"],
        ),
        (
            with("box = { centre = [0,0,0], size = [1,0,1] }"),
            &["above 0"],
        ),
        (
            with("box = { centre = [0,0,0], size = [1,1,1], open = [\"lid\"] }"),
            &["lid", "top"],
        ),
        (
            with("box = { centre = [0,0,0], size = [1,1,1], faces = { top = 2 } }"),
            &["reflectance", "between 0 and 1"],
        ),
        (
            with(
                "box = { centre = [0,0,0], size = [1,1,1], open = [\"left\",\"right\",\"top\",\"bottom\",\"front\",\"back\"] }",
            ),
            &["left out"],
        ),
        (
            with("cave = { start = [0,0,0], radius = 1, length = 1000, columns = 1 }"),
            &["100 times"],
        ),
        (
            with("cave = { start = [0,0,0], radius = 1, length = 10, columns = 1000000 }"),
            &["columns 1000000"],
        ),
        (with("reflectance = 0.5"), &["line 1", "exactly one"]),
        (with(&format!("{QUAD}\n{SPHERE}")), &["exactly one"]),
        (
            with(&format!("{QUAD}\nreflectance = 1.5")),
            &["line 3", "between 0 and 1"],
        ),
        (
            with(&format!("{QUAD}\nreflectance = [0, -0.1, 0]")),
            &["between 0 and 1"],
        ),
        (
            with(&format!("{QUAD}\nreflectance = [0, 1]")),
            &["invalid length 2"],
        ),
        (
            with(&format!("{QUAD}\nreflectance = \"red\"")),
            &["a number or three"],
        ),
        (
            with(&format!("{QUAD}\nemission = -1")),
            &["line 3", "from 0 on"],
        ),
        (with(&format!("{QUAD}\nemission = nan")), &["NaN"]),
        (
            with(&format!("{QUAD}\nemission = 1e300")),
            &["at most 1e15"],
        ),
        (
            format!("points = 0\n{}", with(QUAD)),
            &["line 1", "at least 1"],
        ),
        (format!("points = -5\n{}", with(QUAD)), &["-5"]),
        (format!("points = 1.5\n{}", with(QUAD)), &["whole number"]),
        (
            format!("points = 1000000000000\n{}", with(QUAD)),
            &["1000000000000 points"],
        ),
        (
            format!("points = 400000000\n{}", with(QUAD)),
            &["400000000 points", "MiB"],
        ),
        (
            format!("tolerance = 0\n{}", with(QUAD)),
            &["line 1", "between 1e-6 and 0.5"],
        ),
        (format!("sky = -1\n{}", with(QUAD)), &["line 1", "-1"]),
        (
            format!(
                "[[light]]\nposition = [0,0,0]\nintensity = -1\n{}",
                with(QUAD)
            ),
            &["line 3"],
        ),
        (
            format!(
                "[[light]]\nposition = [0,nan,0]\nintensity = 1\n{}",
                with(QUAD)
            ),
            &["line 2"],
        ),
        (
            format!("[[light]]\nposition = [0,0,0]\n{}", with(QUAD)),
            &["line 1", "intensity"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [0,0,0]"),
            &["line 1", "same place"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [0,3,0]"),
            &["along the view"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [0,3,0]\nup = [0,0,0]"),
            &["zero"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [1,0,0]\nfov = 180"),
            &["fov 180"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [1,0,0]\nfov = nan"),
            &["fov NaN"],
        ),
        (
            camera("position = [0,0,0]\nlook_at = [1,0,0]\nfow = 50"),
            &["line 4", "`fow`", "`fov`"],
        ),
        (
            "[[cloud]]\nfile = \"scene.toml\"".into(),
            &["scene.toml", "scene file"],
        ),
        ("[[cloud]]\nfile = \"none.ply\"".into(), &["none.ply"]),
        (
            "points = 9\n[[cloud]]\nfile = \"none.ply\"".into(),
            &["points", "no [[shape]]"],
        ),
        (
            "[[cloud]]\nfile = \"none.ply\"\nscale = 0".into(),
            &["line 3", "above 0"],
        ),
    ];
    for (text, words) in cases {
        let Err(error) = load_text(text, None) else {
            panic!("accepted:\n{text}");
        };
        let message = error.to_string();
        for word in *words {
            assert!(
                message.contains(word),
                "`{word}` is not in:\n{message}\nfor:\n{text}"
            );
        }
        assert_eq!(error.exit_code(), 1);
    }
}

#[test]
fn bad_requests_are_refused_in_words() {
    let text = format!("[[shape]]\n{BLOCK}");
    assert!(matches!(load_text(&text, 0), Err(Error::Usage(_))));
    assert!(matches!(load_text(&text, 5), Err(Error::Usage(m)) if m.contains("too few")));
    let trillion = load_text(&text, 1_000_000_000_000);
    assert!(matches!(trillion, Err(Error::TooLarge(_))));
    // The number of points is for shapes.
    let cloud = load_text("[[cloud]]\nfile = \"a.ply\"", 100);
    assert!(matches!(cloud, Err(Error::Usage(m)) if m.contains("built-in shapes")));

    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("none.toml");
    let load = |path: &Path| Scene::load(path, &SceneOptions::default(), &Silent);
    assert!(matches!(load(&missing), Err(Error::Io { path, .. }) if path == missing));
    let directory = folder.path().join("folder.toml");
    fs::create_dir(&directory).unwrap();
    assert!(matches!(load(&directory), Err(Error::Io { .. })));
    let binary = folder.path().join("binary.toml");
    fs::write(&binary, [0xff, 0xfe, 0x00]).unwrap();
    assert!(load(&binary).unwrap_err().to_string().contains("UTF-8"));
    let long = folder.path().join("long.toml");
    fs::write(&long, vec![b'#'; (16 << 20) + 1]).unwrap();
    assert!(load(&long).unwrap_err().to_string().contains("16 MiB"));
}

/// Values of every kind, in and out of range.
fn value() -> impl Strategy<Value = String> {
    let number = prop_oneof![
        any::<f64>().prop_map(|x| format!("{x:?}").replace("NaN", "nan")),
        any::<i64>().prop_map(|x| x.to_string()),
        (-3i32..4).prop_map(|x| x.to_string()),
        (0.0..1.0f64).prop_map(|x| format!("{x:?}")),
    ];
    let other = prop_oneof![
        Just("true".to_string()),
        Just("\"top\"".to_string()),
        Just("[\"top\"]".to_string()),
        Just("{}".to_string()),
        Just("1979-05-27".to_string()),
    ];
    let vector = prop::collection::vec(number.clone(), 0..5);
    let triple = prop::collection::vec(number.clone(), 3..4);
    let list = |v: Vec<String>| format!("[{}]", v.join(", "));
    prop_oneof![
        3 => number,
        1 => vector.prop_map(list),
        4 => triple.prop_map(list),
        1 => other,
    ]
}

/// A scene file with some of its values replaced.
fn distorted() -> impl Strategy<Value = String> {
    let lines = [
        ("points", "40"),
        ("sky", "0.5"),
        ("tolerance", "0.1"),
        ("[camera]\nposition", "[0, 0, 9]"),
        ("look_at", "[0, 0, 0]"),
        ("fov", "50"),
        ("[[light]]\nposition", "[0, 0, 9]"),
        ("intensity", "1"),
        ("[[shape]]\nreflectance", "0.5"),
        ("emission", "1"),
        ("quad.corner", "[0, 0, 0]"),
        ("quad.u", "[1, 0, 0]"),
        ("quad.v", "[0, 1, 0]"),
        ("quad.hole.u", "[0.1, 0.2]"),
        ("quad.hole.v", "[0.1, 0.2]"),
        ("[[shape]]\nbox.centre", "[0, 0, 1]"),
        ("box.size", "[1, 1, 1]"),
        ("box.rotate", "[0, 40, 0]"),
        ("[[shape]]\nsphere.centre", "[0, 0, 1.5]"),
        ("sphere.radius", "1"),
        ("sphere.bumps", "0.3"),
        ("[[shape]]\ncave.start", "[0, 0, -1]"),
        ("cave.radius", "1"),
        ("cave.length", "4"),
        ("cave.columns", "2"),
    ];
    let at = prop::sample::select((0..lines.len()).collect::<Vec<_>>());
    prop::collection::vec((at, value()), 0..3).prop_map(move |changes| {
        let mut values = lines.map(|(_, v)| v.to_string());
        for (i, value) in changes {
            values[i] = value;
        }
        let text = lines.iter().zip(&values);
        text.map(|((key, _), value)| format!("{key} = {value}\n"))
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..Default::default() })]

    #[test]
    fn no_scene_file_breaks_the_loader(text in prop_oneof![4 => distorted(), 1 => "\\PC{0,200}"]) {
        match load_text(&text, 60) {
            Ok(scene) => {
                let cloud = &scene.cloud;
                prop_assert!(!cloud.is_empty() && cloud.len() <= 60);
                prop_assert!(cloud.positions.iter().all(|p| p.is_finite()));
                prop_assert!(cloud.normals.iter().all(|n| n.is_normalized()));
                prop_assert!(cloud.areas.iter().all(|&a| a > 0.0 && a.is_finite()));
                prop_assert!(cloud.emission.iter().all(|e| e.is_finite()));
            }
            Err(error) => prop_assert!(error.to_string().contains("scene.toml")),
        }
    }
}
