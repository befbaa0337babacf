//! Bad input, with the words it is refused with.

use std::path::Path;

use fmmgi_gpu::Progress;

use super::*;

#[test]
fn bad_input_is_told_in_words() {
    let vertices =
        |count: &str| ascii(&format!("element vertex {count}\n{XYZ}end_header\n1 2 3\n"));
    let header = |line: &str| {
        ascii(&format!(
            "{line}\nelement vertex 1\n{XYZ}end_header\n1 2 3\n"
        ))
    };
    let long_header = [b"ply\n".to_vec(), b"comment a line\n".repeat(100_000)].concat();
    let long_word = [
        ascii(&format!("element vertex 1\n{XYZ}end_header\n")),
        vec![b'1'; 5 << 20],
    ];
    let mut not_utf8 = header("element caf\u{e9} 1");
    not_utf8.retain(|&byte| byte != 0xc3);
    let cases: &[(&[u8], &str)] = &[
        (b"", "the file is empty"),
        (b"plyx", "not a scan in a format that is understood: PLY"),
        (b"ply x\n", "begins with a line \"ply\""),
        (b"ply\n", "ends inside the header"),
        (b"ply\nformat ascii 1.0", "ends inside the header"),
        (&long_header, "no end_header within 1048576 bytes"),
        (b"ply\nend_header\n", "No format line"),
        (
            b"ply\nformat ascii 2.0\n",
            "header line 2 (\"format ascii 2.0\"): only version 1.0",
        ),
        (b"ply\nformat ebcdic 1.0\n", "must be ascii"),
        (
            &header("format binary_big_endian 1.0"),
            "header line 3 (\"format binary_big_endian 1.0\"): a second format",
        ),
        (
            &header("property float x"),
            "header line 3 (\"property float x\"): a property before",
        ),
        (
            &header("element a 1\nproperty flaot x"),
            "must be \"property TYPE NAME\"",
        ),
        (
            &header("element a 1\nproperty list float int x"),
            "count of a list must be of an integer",
        ),
        (
            &header("element a 1\nproperty list int x"),
            "must be \"property TYPE NAME\"",
        ),
        (&header("element vertex 1"), "this name came before"),
        (
            &header("element a 1\nproperty int x\nproperty float x"),
            "header line 5 (\"property float x\"): this name came before",
        ),
        (&header("ply"), "header line 3 (\"ply\"): not understood"),
        (
            b"ply\nformat ascii 99999999999999999999999.0\n",
            "only version 1.0",
        ),
        (
            &header("element a 99999999999999999999999 b"),
            "not understood",
        ),
        (
            &header("elephant"),
            "header line 3 (\"elephant\"): not understood",
        ),
        (&not_utf8, "not UTF-8"),
        (&ascii("end_header\n"), "no element \"vertex\""),
        (&vertices("0"), "empty cloud"),
        (&vertices("-1"), "must be a whole number"),
        (&vertices("1e3"), "must be a whole number"),
        (
            &vertices("99999999999999999999999"),
            "must be a whole number",
        ),
        (&vertices("18446744073709551615"), "cut short"),
        (
            &vertices("1000000000"),
            "promises 1000000000 vertices, and there is room for at most 1",
        ),
        (
            &ascii("element vertex 1\nproperty float x\nend_header\n1\n"),
            "lacks x, y or z",
        ),
        (
            &two_points("", "", "7"),
            "line 9: more values than the header has",
        ),
        (
            &two_points("property float nx\n", "1", ""),
            "line 10: the line ends before the value of \"nx\"",
        ),
        (
            &two_points(
                "property float nx\nproperty float ny\nproperty float nz\n",
                "0 0 1",
                "0 1,5 0",
            ),
            "line 12: \"1,5\" is no number (property \"ny\")",
        ),
        (
            &two_points("property list int int l\n", "-1", "0"),
            "\"-1\" is no number (property \"l\")",
        ),
        (
            &two_points("property list int int l\n", "999999999999 1", "0"),
            "ends before the value",
        ),
        (&long_word.concat(), "line 8 is longer than"),
    ];
    for (bytes, expected) in cases {
        let message = error(bytes);
        assert!(message.contains(expected), "{message:?} lacks {expected:?}");
    }
}

#[test]
fn truncated_bodies_say_how_far_they_go() {
    let whole = rich_binary(false);
    // Without the face and a byte of the last vertex.
    let message = error(&whole[..whole.len() - 13 - 1]);
    assert!(message.contains("ends after 1 of 2 vertices"), "{message}");

    let mut plain =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex 3\n{XYZ}end_header\n")
            .into_bytes();
    plain.extend([0; 35]);
    let message = error(&plain);
    assert!(
        message.contains("promises 3 vertices, and there is room for at most 2"),
        "{message}"
    );

    // Lines that are long enough for the check by length.
    let lines = format!(
        "element vertex 3\n{XYZ}end_header\n{}",
        "1.00000 2.00000 3.00000\n".repeat(2)
    );
    let message = error(&ascii(&lines));
    assert!(message.contains("ends after 2 of 3 vertices"), "{message}");
}

#[test]
fn what_is_no_file_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let message = |path: &Path| scan::read(path, &Silent).unwrap_err().to_string();
    assert!(message(directory.path()).contains("is a directory"));
    let missing = directory.path().join("missing.ply");
    assert!(message(&missing).contains("missing.ply: cannot be opened: No such file"));
    #[cfg(unix)]
    {
        let pipe = directory.path().join("pipe.ply");
        let made = std::process::Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap();
        assert!(made.success());
        for path in [&pipe, Path::new("/dev/zero")] {
            assert!(message(path).contains("not a regular file"));
        }
    }
}

#[test]
fn reading_stops_when_told() {
    struct Stop;
    impl Progress for Stop {
        fn cancelled(&self) -> bool {
            true
        }
    }
    let table = b"1 2 3\n".to_vec();
    for bytes in [rich_binary(true), two_points("", "", ""), table] {
        let result = scan::read(file(&bytes).path(), &Stop);
        assert!(matches!(result, Err(Error::Interrupted)));
    }
}
