//! Whole runs of the program from outside: what they say, and their exit codes.

mod program;

use std::fs;

use program::{command, fails, folder, run, write_scan};

#[test]
fn points_that_cannot_take_part_are_counted() {
    let folder = folder();
    write_scan(
        &folder,
        "some.ply",
        &[
            "nan 0 0 0 0 1",
            "0 0 0 0 0 0",
            "0 0 0 0 0 1",
            "1 0 0 0 0 1",
            "0 1 0 0 0 1",
            "0 1 0 0 0 1",
        ],
    );
    for method in ["direct", "fmm", "gather"] {
        let args = format!(
            "solve some.ply --backend cpu --sky 1,1,1 --light point:0,0,1e-9 --method {method}"
        );
        let assert = run(folder.path(), &args).success();
        let summary = String::from_utf8_lossy(&assert.get_output().stdout);
        for words in [
            "6, of which 3 take part",
            "repaired    1 points with coordinates that are not finite",
            "repaired    1 points without normals: they have those of the nearest",
            "repaired    2 points at the place of another one",
            "repaired    1 lights lie on a surface",
            "repaired    1 surfels lie closer to a light than their own radius",
        ] {
            assert!(summary.contains(words), "{summary:?} lacks {words:?}");
        }
    }
}

#[test]
fn bright_light_changes_nothing_but_the_brightness() {
    let folder = folder();
    let solve = |light: &str| {
        let args = format!(
            "solve scan.ply --backend cpu --light point:0.1,0.3,0.4:{light} --tolerance 1e-5 \
             --stats stats.json"
        );
        run(folder.path(), &args).success();
        let stats = fs::read(folder.path().join("stats.json")).unwrap();
        let stats: serde_json::Value = serde_json::from_slice(&stats).unwrap();
        stats["iterations"].clone()
    };
    assert_eq!(solve("1,1,1"), solve("1e15,1e15,1e15"));
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_cleanly() {
    use std::io::{BufRead, BufReader, Read};
    use std::process::Stdio;

    let folder = folder();
    // Seconds of work, of which the test waits for the first moments.
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cave.toml");
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_fmmgi-gpu"))
        .args(["solve", scene, "--points", "100000", "--tolerance", "0.001"])
        .args([
            "--backend",
            "cpu",
            "--sky",
            "1,1,1",
            "-o",
            "out.ply",
            "--stats",
            "out.json",
        ])
        .current_dir(&folder)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.starts_with("backend: ") {
        line.clear();
        assert!(
            stderr.read_line(&mut line).unwrap() > 0,
            "it ended before the work"
        );
    }
    // SAFETY: a signal to a child that has not been waited for.
    assert_eq!(unsafe { libc::kill(child.id() as i32, libc::SIGINT) }, 0);
    let mut message = String::new();
    stderr.read_to_string(&mut message).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(
        message.contains("error: interrupted; nothing was written"),
        "{message}"
    );
    let files = fs::read_dir(&folder).unwrap().count();
    assert_eq!(files, 1, "only the scan is there");
}

#[test]
fn every_order_solves() {
    let folder = folder();
    for order in [0, 1, 6, 8, 12] {
        for visibility in ["surfels", "none"] {
            let args = format!(
                "solve scan.ply --method fmm --backend cpu --sky 1,1,1 --order {order} \
                 --visibility {visibility} --stats stats.json"
            );
            run(folder.path(), &args).success();
            let stats = fs::read_to_string(folder.path().join("stats.json")).unwrap();
            let stats: serde_json::Value = serde_json::from_str(&stats).unwrap();
            assert_eq!(stats["order"], order, "{args}");
        }
    }
}

#[test]
fn rays_are_counted() {
    let folder = folder();
    for (rays, cast) in [("", 16), ("--rays 64", 64), ("--rays 100", 128)] {
        let args = format!(
            "solve scan.ply --method gather --backend cpu --light point:0.1,0.3,0.4 --tolerance 0.5 \
             --stats stats.json {rays}"
        );
        let assert = run(folder.path(), &args).success();
        let summary = String::from_utf8_lossy(&assert.get_output().stdout).into_owned();
        assert!(
            summary.contains(&format!("{cast} from each point")),
            "{summary}"
        );
        let stats = fs::read_to_string(folder.path().join("stats.json")).unwrap();
        let stats: serde_json::Value = serde_json::from_str(&stats).unwrap();
        assert_eq!(stats["rays"], cast);
    }
    for (args, words) in [
        ("--method gather --rays 1", "1 is not in 2..=65536"),
        (
            "--method gather --visibility none",
            "the gather method follows rays",
        ),
    ] {
        let args = format!("solve scan.ply --quiet --sky 1,1,1 {args}");
        fails(&folder, &args, 2, words);
    }
}

#[test]
fn adapters_are_listed() {
    let folder = folder();
    let mut command = command(folder.path(), "adapters");
    // Without a display.
    for name in [
        "XDG_RUNTIME_DIR",
        "NODEVICE_SELECT",
        "MESA_VK_DEVICE_SELECT",
    ] {
        command.env_remove(name);
    }
    let assert = command.assert().success();
    let output = assert.get_output();
    assert!(!output.stdout.is_empty());
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(!message.contains("XDG_RUNTIME_DIR"), "{message}");
}

#[test]
fn a_scan_is_solved() {
    let folder = folder();
    let path = |name: &str| folder.path().join(name);
    let assert = run(
        folder.path(),
        "solve scan.ply --backend cpu --light point:0.5,0.5,0.5 -o a.ply --stats a.json --image a.png --size 32x24",
    )
    .success();
    let summary = String::from_utf8_lossy(&assert.get_output().stdout);
    assert!(summary.contains("8, of which 8 take part"), "{summary}");
    assert!(summary.contains("written     a.ply"), "{summary}");
    assert!(fs::read(path("a.ply")).unwrap().starts_with(b"ply\n"));
    assert!(fs::read(path("a.png")).unwrap().starts_with(b"\x89PNG"));
    let stats: serde_json::Value =
        serde_json::from_slice(&fs::read(path("a.json")).unwrap()).unwrap();
    assert_eq!(stats["points"], 8);
    assert_eq!(stats["backend"], "cpu");

    // Twice the light is twice the irradiance.
    let args = "solve scan.ply --backend cpu --quiet --light point:0.5,0.5,0.5:2,2,2 -o b.ply";
    let assert = run(folder.path(), args).success();
    assert!(assert.get_output().stdout.is_empty() && assert.get_output().stderr.is_empty());
    let assert = run(folder.path(), "compare b.ply a.ply --json").success();
    let json: serde_json::Value = serde_json::from_slice(&assert.get_output().stdout).unwrap();
    for key in ["rel_l2", "median", "max", "bias"] {
        assert!((json[key].as_f64().unwrap() - 1.0).abs() < 1e-3, "{json}");
    }
    run(folder.path(), "compare a.ply a.ply").success();
    // Twice as much, 0.5 being the darkest colour: all that is seen is dark red.
    let args = "compare b.ply a.ply --image d.png --scale 0.5 --size 32x24";
    let assert = run(folder.path(), args).success();
    let told = String::from_utf8_lossy(&assert.get_output().stdout);
    assert!(told.contains("50% more is dark red"), "{told}");
    assert!(fs::read(path("d.png")).unwrap().starts_with(b"\x89PNG"));
    fails(
        &folder,
        "compare b.ply a.ply --image a.ply",
        2,
        "overwritten",
    );
    fails(
        &folder,
        "compare a.ply scan.ply",
        1,
        "not an output of \"solve\"",
    );
    fails(
        &folder,
        "compare a.ply gone.ply",
        1,
        "gone.ply: cannot be opened",
    );

    // Without light everything is dark, and this is said.
    let assert = run(folder.path(), "solve scan.ply --backend cpu").success();
    assert!(String::from_utf8_lossy(&assert.get_output().stderr).contains("nothing gives light"));
}

/// A tunnel of white walls, a hundred times as long as wide, with light at its open end. No wall
/// keeps light: it goes on from width to width, and a Krylov space of a few dozen steps does not
/// hold the way there and back.
const TUNNEL: &str = "points = 800\n\
    [[shape]]\n\
    box = { centre = [0, 0, 50], size = [1, 1, 100], inward = true, open = ['front'] }\n\
    reflectance = 1\n\
    [[light]]\nposition = [0, 0, 1]\nintensity = 1\n";

#[test]
fn a_solve_that_does_not_converge_is_written_with_code_4() {
    let folder = folder();
    fs::write(folder.path().join("tunnel.toml"), TUNNEL).unwrap();
    let solve = |args: &str| {
        let args = format!("solve tunnel.toml --backend cpu -o a.ply --stats a.json {args}");
        let output = run(folder.path(), &args).get_output().clone();
        assert!(folder.path().join("a.ply").exists());
        fs::remove_file(folder.path().join("a.ply")).unwrap();
        let stats = fs::read(folder.path().join("a.json")).unwrap();
        let stats: serde_json::Value = serde_json::from_slice(&stats).unwrap();
        let summary = String::from_utf8_lossy(&output.stdout).into_owned();
        (
            output.status.code(),
            stats["converged"].clone(),
            summary.contains("NOT CONVERGED"),
        )
    };
    assert_eq!(solve(""), (Some(4), false.into(), true));
    // Bounces that are asked for are all that is asked for.
    assert_eq!(solve("--max-bounces 2"), (Some(0), true.into(), false));
}

/// The sky is seen in a few thousand directions at most, which is not as good as this.
#[test]
fn a_tolerance_that_is_missed_is_told_with_code_4() {
    let folder = folder();
    let porch = "points = 400\nsky = [1, 1, 1]\n[[shape]]\nbox = { centre = [0, 0, 0], size = \
                 [1, 1, 2], inward = true, open = ['front'] }\n";
    fs::write(folder.path().join("porch.toml"), porch).unwrap();
    let solve = |tolerance| {
        let args = format!(
            "solve porch.toml --method fmm --backend cpu --below-model --tolerance {tolerance}"
        );
        let output = run(folder.path(), &args).get_output().clone();
        let summary = String::from_utf8_lossy(&output.stdout).into_owned();
        (output.status.code(), summary.contains("TOLERANCE NOT MET"))
    };
    assert_eq!(solve("0.05"), (Some(0), false));
    assert_eq!(solve("1e-5"), (Some(4), true));
}
