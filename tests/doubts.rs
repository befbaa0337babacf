//! Coordinates that are doubtful: what `solve` and `info` say of them.

mod program;

use std::fs;
use std::path::Path;

use program::{fails, folder, run};

/// A closed room of 4 by 3 by 2.5, without normals, moved and scaled.
fn room(place: impl Fn([f64; 3]) -> [f64; 3]) -> String {
    let mut text = String::new();
    let ticks =
        |n: u32, length: f64| (0..n).map(move |i| length * (f64::from(i) + 0.5) / f64::from(n));
    let mut put = |p: [f64; 3]| {
        let [x, y, z] = place(p);
        text += &format!("{x} {y} {z}\n");
    };
    for x in ticks(8, 4.0) {
        for y in ticks(6, 3.0) {
            [0.0, 2.5].into_iter().for_each(|z| put([x, y, z]));
        }
        for z in ticks(5, 2.5) {
            [0.0, 3.0].into_iter().for_each(|y| put([x, y, z]));
        }
    }
    for y in ticks(6, 3.0) {
        for z in ticks(5, 2.5) {
            [0.0, 4.0].into_iter().for_each(|x| put([x, y, z]));
        }
    }
    text
}

/// What `solve` says on standard error.
fn said(folder: &Path, args: &str) -> String {
    let assert = run(folder, &format!("solve {args} --backend cpu"));
    let output = assert.get_output();
    assert!(matches!(output.status.code(), Some(0 | 4)), "{args}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn doubtful_coordinates_are_told() {
    let folder = folder();
    let write = |name: &str, place: &dyn Fn([f64; 3]) -> [f64; 3]| {
        fs::write(folder.path().join(name), room(place)).unwrap();
    };
    write("room.xyz", &|p| p);
    write("map.xyz", &|[x, y, z]| [x + 5e5, y + 5e6, z]);
    let single = |x: f64| f64::from(x as f32);
    write("single.xyz", &|[x, y, z]| {
        [single(x + 5e5), single(y + 5e6), z]
    });
    write("degrees.xyz", &|[x, y, z]| {
        [8.5 + x * 1e-5, 47.4 + y * 1e-5, z]
    });
    for (args, words) in [
        (
            "single.xyz --light point:500002,5000001.5,1.25",
            "coordinates step by 0.5",
        ),
        ("degrees.xyz --sky 1,1,1", "look like degrees"),
        (
            "map.xyz --light point:2,1.5,1.25",
            "lies far from the points (box 500000 5000000 0 ..",
        ),
        (
            "room.xyz --light point:-2,1.5,1.25 --normals inward",
            "the lamps light nothing, at [-2, 1.5, 1.25]",
        ),
    ] {
        let said = said(folder.path(), args);
        assert!(
            said.contains("warning: ") && said.contains(words),
            "{args}: {said}"
        );
    }
    for args in [
        "room.xyz --light point:2,1.5,1.25 --normals inward",
        "map.xyz --light point:500002,5000001.5,1.25 --normals inward",
    ] {
        let said = said(folder.path(), args);
        assert!(!said.contains("warning"), "{args}: {said}");
        assert!(
            said.contains("place x y z; no colours: reflectance 0.5"),
            "{said}"
        );
    }
    fails(
        &folder,
        "solve room.xyz map.xyz --sky 1,1,1",
        2,
        "--far-apart takes them",
    );
    let told = "solve room.xyz map.xyz --sky 1,1,1 --far-apart";
    fails(&folder, told, 1, "light them one by one");
}
