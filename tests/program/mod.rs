//! The program as a test runs it.
#![allow(dead_code)]

use std::fs;
use std::path::Path;

use assert_cmd::Command;
use assert_cmd::assert::Assert;
use tempfile::TempDir;

/// Two squares of surface that face each other.
pub const SCAN: &str = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n\
    property float z\nproperty float nx\nproperty float ny\nproperty float nz\n\
    property float area\nend_header\n\
    0 0 0 0 0 1 1\n1 0 0 0 0 1 1\n0 1 0 0 0 1 1\n1 1 0 0 0 1 1\n\
    0 0 1 0 0 -1 1\n1 0 1 0 0 -1 1\n0 1 1 0 0 -1 1\n1 1 1 0 0 -1 1\n";

/// A folder with `scan.ply`.
pub fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scan.ply"), SCAN).unwrap();
    folder
}

/// Writes a scan with lines `x y z nx ny nz`.
pub fn write_scan(folder: &TempDir, name: &str, points: &[&str]) {
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

/// The program in a folder, with arguments that are parted by spaces.
pub fn command(folder: &Path, args: &str) -> Command {
    let mut command = Command::cargo_bin("fmmgi-gpu").unwrap();
    command.current_dir(folder).args(args.split_whitespace());
    command
}

pub fn run(folder: &Path, args: &str) -> Assert {
    command(folder, args).assert()
}

/// Runs the program, which must fail with this code and these words and write nothing.
pub fn fails(folder: &TempDir, args: &str, code: i32, words: &str) {
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
