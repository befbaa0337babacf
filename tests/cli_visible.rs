//! `fmmgi-gpu visible` from outside: words, exit codes, and what is painted.

mod program;

use std::fs;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan;
use glam::DVec3;
use program::{command, fails, folder, run};
use tempfile::TempDir;

/// A room with a screen across the middle of it, which leaves a gap under the ceiling.
const ROOM: &str = "points = 6000\n\
    [[shape]]\n\
    box = { centre = [0.5, 0.5, 0.5], size = [1, 1, 1], inward = true }\n\
    [[shape]]\n\
    box = { centre = [0.5, 0.3, 0.5], size = [0.1, 0.6, 1], open = ['bottom', 'front', 'back'] }\n";

const CYAN: [u8; 3] = [0, 245, 245];

fn room() -> TempDir {
    let folder = folder();
    fs::write(folder.path().join("room.toml"), ROOM).unwrap();
    folder
}

#[derive(Debug)]
struct Painted {
    place: DVec3,
    colour: [u8; 3],
    visible: bool,
}

fn read(folder: &TempDir, name: &str) -> Vec<Painted> {
    let path = folder.path().join(name);
    let cloud = scan::read(&path, &Silent).unwrap();
    let bytes = fs::read(&path).unwrap();
    let header = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .unwrap()
        + 11;
    let head = String::from_utf8_lossy(&bytes[..header]);
    assert!(head.ends_with("property uchar scalar_visible\nend_header\n"));
    let stride = 6 * 4 + 3 + 1;
    assert_eq!(bytes.len() - header, cloud.len() * stride);
    let rows = bytes[header..].chunks(stride);
    let point = |(&place, row): (&DVec3, &[u8])| Painted {
        place,
        colour: [row[24], row[25], row[26]],
        visible: row[27] == 1,
    };
    cloud.positions.iter().zip(rows).map(point).collect()
}

#[test]
fn wrong_usage_is_told_before_any_work() {
    let folder = room();
    for (args, words) in [
        ("", "--from <X,Y,Z>"),
        ("--from 1,2", "must be three finite numbers"),
        ("--from 1,2,NaN", "must be three finite numbers"),
        ("--from 0,0,0 -o gone.ply", "is the input"),
        ("--from 0,0,0 -o a --image a", "are the same file"),
        ("--from 0,0,0 --points 0", "invalid value '0'"),
        ("--from 0,0,0 --size 0x1", "each side must have"),
        ("--from 0,0,0 --visibility magic", "invalid value 'magic'"),
        ("--from 0,0,0 --backend cpu --adapter 0", "give only one"),
        ("--from 0,0,0 --quiet --verbose", "cannot be used with"),
    ] {
        fails(&folder, &format!("visible gone.ply {args}"), 2, words);
    }
    let from = "--from 0,0,0 --backend cpu";
    fails(&folder, &format!("visible gone.ply {from}"), 1, "gone.ply");
    fails(
        &folder,
        &format!("visible scan.ply {from} -o no/a.ply"),
        1,
        "no directory no",
    );
    fails(
        &folder,
        &format!("visible scan.ply {from} --points 5"),
        2,
        "points",
    );
}

/// The screen stands between x = 0.45 and 0.55 and is 0.6 high: seen from the floor before it, the
/// shadow is what lies below the plane through its nearer edge. Spacings are about 0.03.
#[test]
fn the_shadow_of_a_screen_is_not_painted() {
    let folder = room();
    for visibility in ["classic", "surfels"] {
        let args = format!(
            "visible room.toml --from 0.25,0,0.5 --visibility {visibility} --backend cpu \
             -o a.ply --image a.png --size 64x48"
        );
        let assert = run(folder.path(), &args).success();
        let summary = String::from_utf8_lossy(&assert.get_output().stdout).into_owned();
        let points = read(&folder, "a.ply");
        let seen = points.iter().filter(|p| p.visible).count();
        for words in [
            "from        [0.2",
            " from the place given\n",
            &format!("points      {seen} of {} (", points.len()),
            "cells       ",
            "written     a.png",
        ] {
            assert!(summary.contains(words), "{summary}");
        }
        let picture = fs::read(folder.path().join("a.png")).unwrap();
        assert!(picture.starts_with(b"\x89PNG"));

        let cyan: Vec<_> = points.iter().filter(|p| p.colour == CYAN).collect();
        assert_eq!(cyan.len(), 1);
        let from = cyan[0].place;
        assert!(from.distance(DVec3::new(0.25, 0.0, 0.5)) < 0.03, "{from}");
        let (mut in_shadow, mut wrong) = (0, 0);
        for point in &points {
            let p = point.place;
            let shadow = from.y + (p.x - from.x) * (0.6 - from.y) / (0.45 - from.x);
            let on_floor = p.y == 0.0;
            let expected = if on_floor || (p.x > 0.48 && p.y < shadow - 0.1) {
                false
            } else if p.x < 0.42 || p.y > shadow + 0.1 {
                true
            } else {
                continue;
            };
            in_shadow += usize::from(!expected && !on_floor);
            wrong += usize::from(point.visible != expected);
            let [red, _, blue] = point.colour;
            assert!(!point.visible || red > blue + 40, "{point:?} is yellow");
        }
        println!("{visibility}: {wrong} wrong, {in_shadow} in the shadow");
        // Measured: 1 with the report's test, which finds holes between points, 0 with cells.
        assert!(in_shadow > 2000 && wrong <= 3, "{visibility}: {wrong}");
    }
}

#[test]
fn cpu_and_gpu_paint_the_same() {
    let folder = room();
    for visibility in ["classic", "surfels"] {
        let paint = |backend: &str| {
            let args = format!(
                "visible room.toml --from 0.25,0,0.5 --points 2000 --visibility {visibility} \
                 --backend {backend} -o {backend}.ply --quiet"
            );
            let assert = command(folder.path(), &args).assert().success();
            assert!(assert.get_output().stdout.is_empty());
            fs::read(folder.path().join(format!("{backend}.ply"))).unwrap()
        };
        assert!(paint("cpu") == paint("gpu"), "{visibility}");
    }
}
