//! The program from outside: words and exit codes.

use std::fs;
use std::path::Path;

use assert_cmd::Command;
use assert_cmd::assert::Assert;
use tempfile::TempDir;

/// Two squares of surface that face each other.
const SCAN: &str = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n\
    property float z\nproperty float nx\nproperty float ny\nproperty float nz\n\
    property float area\nend_header\n\
    0 0 0 0 0 1 1\n1 0 0 0 0 1 1\n0 1 0 0 0 1 1\n1 1 0 0 0 1 1\n\
    0 0 1 0 0 -1 1\n1 0 1 0 0 -1 1\n0 1 1 0 0 -1 1\n1 1 1 0 0 -1 1\n";

/// A folder with `scan.ply`.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scan.ply"), SCAN).unwrap();
    folder
}

/// Runs the program in a folder, with arguments that are parted by spaces.
fn run(folder: &Path, args: &str) -> Assert {
    Command::cargo_bin("fmmgi-gpu")
        .unwrap()
        .current_dir(folder)
        .args(args.split_whitespace())
        .assert()
}

/// Runs the program, which must fail with this code and these words and write nothing.
fn fails(folder: &TempDir, args: &str, code: i32, words: &str) {
    let names = || {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        names.sort();
        names
    };
    let before = names();
    let assert = run(folder.path(), args).code(code);
    let output = assert.get_output();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.starts_with("error: "), "{args}: {message}");
    assert!(
        message.contains(words),
        "{args}: {message:?} lacks {words:?}"
    );
    assert!(output.stdout.is_empty(), "{args}");
    assert_eq!(names(), before, "{args}");
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
#[ignore = "needs scene files"]
fn bad_scene_files_are_told() {
    fails(&folder(), "solve gone.toml --quiet", 1, "gone.toml: ");
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
    run(folder().path(), "adapters").success();
}

#[test]
#[ignore = "needs illuminate and pictures"]
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

#[test]
#[ignore = "needs illuminate"]
fn a_solve_that_does_not_converge_is_written_with_code_4() {
    let folder = folder();
    let args = "solve scan.ply --backend cpu --light point:0.5,0.5,0.5 --tolerance 1e-6 \
        --max-bounces 1 -o a.ply";
    run(folder.path(), args).code(4);
    assert!(folder.path().join("a.ply").exists());
}
