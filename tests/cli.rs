//! The program from outside: words and exit codes.

mod program;

use std::fs;
use std::path::Path;

use program::{SCAN, command, fails, folder, run};
use tempfile::TempDir;

/// Writes a scan with lines `x y z nx ny nz`.
fn write_scan(folder: &TempDir, name: &str, points: &[&str]) {
    let header: String = ["x", "y", "z", "nx", "ny", "nz"]
        .map(|name| format!("property float {name}\n"))
        .concat();
    let scan = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\n{header}end_header\n{}\n",
        points.len(),
        points.join("\n")
    );
    fs::write(folder.path().join(name), scan).unwrap();
}

#[test]
fn wrong_usage_is_told_before_any_work() {
    let folder = folder();
    // The input is not there: usage is checked first.
    for (args, words) in [
        ("", "required"),
        ("--tolerance 0", "must be a number from 1e-6 to 0.5"),
        ("--tolerance -0.1", "must be a number from 1e-6 to 0.5"),
        ("--tolerance NaN", "must be a number from 1e-6 to 0.5"),
        ("--tolerance 0.6", "must be a number from 1e-6 to 0.5"),
        ("--size 0x100", "each side must have 1 to 16384 pixels"),
        ("--size 100x16385", "each side must have 1 to 16384 pixels"),
        ("--size 16384x16384", "at most 33554432 pixels"),
        ("--size 99999999999x1", "must be WIDTHxHEIGHT"),
        ("--size -1x5", "unexpected argument"),
        ("--size big", "must be WIDTHxHEIGHT"),
        ("--light sun", "point:X,Y,Z:R,G,B"),
        (
            "--light point:1,2",
            "its place must be three finite numbers",
        ),
        (
            "--light point:1,2,inf",
            "its place must be three finite numbers",
        ),
        (
            "--light point:1,2,3:1,-1,1",
            "its intensity must not be negative",
        ),
        (
            "--light point:1,2,3:1,nan,1",
            "its intensity must be finite",
        ),
        (
            "--light point:1,2,3:1,1e300,1",
            "its intensity must be finite",
        ),
        (
            "--light point:1,2,3:1",
            "its intensity must be three numbers",
        ),
        ("--sky -1,0,0", "must not be negative"),
        ("--sky 1,NaN,1", "must be finite"),
        ("--sky 1", "must be three numbers"),
        ("--threads 0", "0 is not in 1..=1024"),
        ("--points 0", "invalid value '0'"),
        ("--max-bounces -1", "unexpected argument"),
        ("--order 13", "13 is not in 0..=12"),
        ("--method magic", "invalid value 'magic'"),
        ("--backend abacus", "invalid value 'abacus'"),
        ("--backend cpu --adapter 0", "give only one"),
        (
            "--backend gpu --method direct",
            "--method direct runs on the CPU only",
        ),
        ("--quiet --verbose", "cannot be used with"),
        ("-o gone.ply", "gone.ply is the input"),
        ("-o ./gone.ply", "is the input"),
        ("-o a.ply --image ./a.ply", "are the same file"),
        ("--image a --stats a", "are the same file"),
    ] {
        let input = if args.is_empty() { "" } else { "gone.ply" };
        fails(&folder, &format!("solve {input} {args}"), 2, words);
    }
    fails(&folder, "solve scan.ply --points 5", 2, "points");
    run(folder.path(), "").code(2);
    run(folder.path(), "dance").code(2);
    run(folder.path(), "--help").success();
    run(folder.path(), "--version").success();
}

#[cfg(unix)]
#[test]
fn the_input_is_not_overwritten_through_a_link() {
    let folder = folder();
    let link = folder.path().join("link.ply");
    std::os::unix::fs::symlink("scan.ply", link).unwrap();
    std::os::unix::fs::symlink(".", folder.path().join("here")).unwrap();
    for args in [
        "scan.ply -o link.ply",
        "link.ply -o scan.ply",
        "scan.ply -o here/scan.ply",
    ] {
        fails(&folder, &format!("solve {args}"), 2, "is the input");
    }
    fails(
        &folder,
        "solve scan.ply -o here/a --stats a",
        2,
        "are the same file",
    );
    assert_eq!(
        fs::read_to_string(folder.path().join("scan.ply")).unwrap(),
        SCAN
    );
}

#[test]
fn outputs_that_cannot_be_written_are_told_before_the_work() {
    let folder = folder();
    fs::create_dir(folder.path().join("sub")).unwrap();
    fails(
        &folder,
        "solve gone.ply -o no/out.ply",
        1,
        "no/out.ply: cannot be written: no directory no",
    );
    fails(&folder, "solve gone.ply -o sub", 1, "sub: is a directory");
    fails(
        &folder,
        "solve gone.ply --stats scan.ply/x.json",
        1,
        "scan.ply/x.json: cannot be written",
    );
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let sub = folder.path().join("sub");
        fs::set_permissions(&sub, fs::Permissions::from_mode(0o555)).unwrap();
        // Root may write anywhere.
        if fs::write(sub.join("try"), "").is_ok() {
            eprintln!("NOT RUN as root: a directory without permission to write");
        } else {
            fails(
                &folder,
                "solve gone.ply -o sub/a.ply",
                1,
                "no permission to write in sub",
            );
        }
        fs::set_permissions(&sub, fs::Permissions::from_mode(0o755)).unwrap();
    }
}

#[test]
fn bad_inputs_are_told() {
    let folder = folder();
    fs::write(folder.path().join("cut.ply"), &SCAN[..SCAN.len() - 20]).unwrap();
    fs::write(folder.path().join("noise.bin"), [0u8, 1, 2, 255]).unwrap();
    fails(
        &folder,
        "solve gone.ply --quiet",
        1,
        "gone.ply: cannot be opened",
    );
    fails(&folder, "solve . --quiet", 1, ".: is a directory");
    fails(
        &folder,
        "solve cut.ply -o out.ply",
        1,
        "cut.ply: the file is cut short",
    );
    fails(
        &folder,
        "solve noise.bin -o out.ply",
        1,
        "not a scan in a format that is understood",
    );
}

#[test]
fn bad_scene_files_are_told() {
    let folder = folder();
    fails(&folder, "solve gone.toml --quiet", 1, "gone.toml: ");
    let scene = |top: &str| {
        format!("{top}\n[[shape]]\nquad = {{ corner = [0, 0, 0], u = [1, 0, 0], v = [0, 1, 0] }}\n")
    };
    for (top, words) in [
        (
            "[camera]\nposition = [0, 0, 0]\nlook_at = [0, 0, 0]",
            "are the same place",
        ),
        (
            "[camera]\nposition = [0, 0, 0]\nlook_at = [0, 1, 0]",
            "up must not point along the view",
        ),
        ("[[light]]\nposition = [nan, 0, 0]\nintensity = 1", "line 2"),
        ("[[light]]\nposition = [0, 0, 1]\nintensity = -1", "line 3"),
        ("colour = 1", "unknown key `colour`"),
    ] {
        fs::write(folder.path().join("scene.toml"), scene(top)).unwrap();
        fails(&folder, "solve scene.toml --quiet -o out.ply", 1, words);
    }
    fs::write(folder.path().join("scene.toml"), scene("")).unwrap();
    fails(
        &folder,
        "solve scene.toml --points 1000000000000 --quiet",
        1,
        "1000000000000 points",
    );
    fails(
        &folder,
        "solve scene.toml --points 400000000 --quiet",
        1,
        "only",
    );
}

#[test]
fn a_scan_in_a_scene_is_not_overwritten() {
    let folder = folder();
    fs::write(
        folder.path().join("scene.toml"),
        "[[cloud]]\nfile = 'scan.ply'\n",
    )
    .unwrap();
    fails(
        &folder,
        "solve scene.toml --quiet -o scan.ply",
        2,
        "scan.ply is the input",
    );
    fails(
        &folder,
        "solve scene.toml --quiet --stats scene.toml",
        2,
        "scene.toml is the input",
    );
}

#[test]
fn clouds_without_surface_are_told() {
    let folder = folder();
    for (points, words) in [
        (&["0 0 0 0 0 1"][..], "lie at one place"),
        (&["1 1 1 0 0 1"; 4], "lie at one place"),
        (
            &["nan 0 0 0 0 1", "0 inf 0 0 0 1"],
            "none of the 2 points has finite coordinates",
        ),
        (
            &["0 0 0 0 0 0", "1 0 0 nan 0 1"],
            "none of the 2 points has finite coordinates and a normal",
        ),
    ] {
        write_scan(&folder, "bad.ply", points);
        for method in ["direct", "fmm", "gather"] {
            let args = format!(
                "solve bad.ply --quiet --backend cpu --sky 1,1,1 -o out.ply --method {method}"
            );
            fails(&folder, &args, 1, words);
        }
    }
}

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
            "repaired    1 points without normals: estimated",
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
fn full_disks_are_told() {
    let folder = folder();
    if !Path::new("/dev/full").exists() {
        eprintln!("NOT RUN: there is no /dev/full");
        return;
    }
    for output in ["-o", "--image", "--stats"] {
        let args = format!(
            "solve scan.ply --quiet --sky 1,1,1 --backend cpu --size 8x8 {output} /dev/full"
        );
        fails(
            &folder,
            &args,
            1,
            "/dev/full: cannot be written: No space left",
        );
    }
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
fn missing_backends_have_their_own_exit_code() {
    let folder = folder();
    fails(
        &folder,
        "solve scan.ply --adapter no-such-adapter -o out.ply",
        3,
        "no-such-adapter",
    );
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
