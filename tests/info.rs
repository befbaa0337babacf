//! `fmmgi-gpu info`.

mod program;

use std::fs;

use program::{fails, folder, run};

#[test]
fn files_are_told_in_words_and_in_json() {
    let folder = folder();
    let map = "650000.1 5650000.2 10\n650001.1 5650000.2 10\n650000.1 5650001.2 10\nnan 0 0\n";
    fs::write(folder.path().join("map.xyz"), map).unwrap();
    let scene =
        "[[cloud]]\nfile = 'scan.ply'\n[[shape]]\nsphere = { centre = [9, 0, 0], radius = 1 }\n";
    fs::write(folder.path().join("scene.toml"), scene).unwrap();

    let output = run(folder.path(), "info scan.ply map.xyz scene.toml").success();
    let text = String::from_utf8_lossy(&output.get_output().stdout).into_owned();
    for expected in [
        "scan.ply\n  format    PLY, ascii\n  points    8\n  fields    x y z nx ny nz area\n  \
         taken     place x y z; normals nx ny nz; areas area; no colours: reflectance 0.5\n  \
         box       0.0000 0.0000 0.0000 .. 1.0000 1.0000 1.0000\n  size      1.0000 1.0000 1.0000\n  spacing   1.000e0",
        "note      no colours: reflectance 0.5",
        "note      nothing gives light",
        "map.xyz\n  format    text, parted by blanks\n  points    4\n",
        "note      1 points have no place",
        "note      coordinates lie far from the origin",
        "note      no areas: found from the neighbours",
        "scene.toml\n  format    scene file, shapes: 1\n  points    20000\n",
    ] {
        assert!(text.contains(expected), "{text} lacks {expected}");
    }

    let output = run(folder.path(), "info --json map.xyz scene.toml").success();
    let json: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    let names: Vec<_> = json
        .as_array()
        .unwrap()
        .iter()
        .map(|r| r["file"].as_str())
        .collect();
    assert_eq!(
        names,
        [Some("map.xyz"), Some("scene.toml"), Some("./scan.ply")]
            .map(|n| n.map(|n| n.trim_start_matches("./")))
    );
    assert_eq!(json[0]["points"], 4);
    assert_eq!(json[0]["placed"], 3);
    assert_eq!(json[0]["spacing"], 1.0);
    assert_eq!(json[0]["needs_double"], true);
    assert_eq!(json[0]["bounds"][1][1], 5_650_001.2);
    assert_eq!(json[2]["with_normal"], 8);
}

#[test]
fn a_bad_file_does_not_keep_the_others_from_being_told() {
    let folder = folder();
    fs::write(folder.path().join("bad.ply"), "ply\n").unwrap();
    let assert = run(folder.path(), "info bad.ply scan.ply missing.xyz").code(1);
    let output = assert.get_output();
    assert!(String::from_utf8_lossy(&output.stdout).starts_with("scan.ply\n"));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        errors.contains("bad.ply: ") && errors.contains("missing.xyz: "),
        "{errors}"
    );
    fails(&folder, "info", 2, "required");
}

#[test]
fn several_files_are_one_scene() {
    let folder = folder();
    let places = "x,y,z,nx,ny,nz\n0,0,5,0,0,-1\n1,0,5,0,0,-1\n0,1,5,0,0,-1\n1,1,5,0,0,-1\n";
    fs::write(folder.path().join("more.csv"), places).unwrap();
    fs::write(
        folder.path().join("tile.obj"),
        "v 0 0 7\nv 1 0 7\nv 0 1 7\nf 1 3 2\n",
    )
    .unwrap();
    let scene = "sky = [1, 1, 1]\n[[cloud]]\nfile = 'tile.obj'\npoints = 10\n";
    fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let solve = |files: &str, points: usize| {
        let args = format!("solve {files} -o lit.ply --backend cpu");
        let output = run(folder.path(), &args).success();
        let text = String::from_utf8_lossy(&output.get_output().stdout).into_owned();
        assert!(text.contains(&format!("points      {points}, ")), "{text}");
    };
    solve("scan.ply more.csv --sky 1,1,1", 12);
    solve("scan.ply scene.toml more.csv", 8 + 10 + 4);
    solve("scene.toml --points 50", 10);
    solve("tile.obj scan.ply --points 50 --sky 1,1,1", 58);
    fails(
        &folder,
        "solve scan.ply more.csv --points 9",
        2,
        "not for a scan",
    );
    fails(
        &folder,
        "solve scene.toml scene.toml",
        2,
        "a second scene file",
    );
    fails(
        &folder,
        "solve scan.ply more.csv -o more.csv",
        2,
        "is the input",
    );
}

/// A sphere without normals, with a point in the air and one twice: each step is told.
#[test]
fn quality_tells_each_step() {
    let folder = folder();
    let mut text = String::new();
    for i in 0..3000 {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 3000.0;
        let (s, c) = (2.399_963 * f64::from(i)).sin_cos();
        let r = (1.0 - z * z).sqrt();
        text += &format!("{} {} {z}\n", r * c, r * s);
    }
    text += "0 0 2\n";
    let again = text.lines().next().unwrap().to_owned() + "\n";
    fs::write(folder.path().join("ball.xyz"), text + &again).unwrap();
    let output = run(folder.path(), "info --quality --json ball.xyz").success();
    let json: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    let quality = &json[0]["quality"];
    let steps = quality["steps"].to_string();
    assert!(
        steps.contains("fitted to the points, turned outward as on a closed body"),
        "{steps}"
    );
    assert_eq!(quality["strays"], 1);
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    assert!((number(&quality["area"]) / 12.566 - 1.0).abs() < 0.02);
    // All is seen of the sky from outside, nothing from inside.
    assert!(number(&quality["open"]["front"]) > 0.99 && number(&quality["open"]["back"]) < 0.01);
    let output = run(folder.path(), "info --quality --normals inward ball.xyz").success();
    let text = String::from_utf8_lossy(&output.get_output().stdout).into_owned();
    for expected in [
        "fitted to the points, turned inward, as told",
        "a closed room, seen from inside",
    ] {
        assert!(text.contains(expected), "{text} lacks {expected}");
    }
    fails(&folder, "info --normals inward ball.xyz", 2, "--quality");
}
