//! What the program refuses, and in which words.

mod program;

use std::fs;
use std::path::Path;

use program::{SCAN, fails, folder, run, write_scan};

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
            "no surface in these 2 points",
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
