//! `fmmgi-gpu solve -o` from outside: the ending says the format.

mod program;

use std::fs;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan;
use program::{fails, folder, run};

#[test]
fn endings_say_the_format() {
    let folder = folder();
    let input = scan::read(&folder.path().join("scan.ply"), &Silent).unwrap();
    for (name, magic) in [
        ("lit.ply", "ply\n"),
        ("lit.las", "LASF"),
        ("lit.laz", "LASF"),
        ("lit.csv", "x,y,z,nx,ny,nz,area,red"),
        ("lit.npy", "NUMPY"),
    ] {
        run(
            folder.path(),
            &format!("solve scan.ply --sky 1,1,1 --backend cpu -o {name}"),
        )
        .success();
        let path = folder.path().join(name);
        let head = fs::read(&path).unwrap();
        assert!(
            String::from_utf8_lossy(&head[..30]).contains(magic),
            "{name}"
        );
        if !name.ends_with("npy") {
            let back = scan::read(&path, &Silent).unwrap();
            for (p, q) in back.positions.iter().zip(&input.positions) {
                assert!((*p - *q).length() < 1e-8, "{name}: {p}");
            }
        }
    }
}

#[test]
fn other_endings_are_refused_before_the_work() {
    let folder = folder();
    // The input is not even looked at.
    fs::write(folder.path().join("broken.ply"), "no scan").unwrap();
    fails(
        &folder,
        "solve broken.ply -o lit.obj",
        2,
        "lit.obj: points can be written to files",
    );
    for (args, words) in [
        ("-o lit.jpg", "lit.jpg: points can be written to files"),
        ("-o lit", "lit: points can be written to files"),
        ("--image lit.jpg", "must end with .png"),
        ("--image lit", "must end with .png"),
    ] {
        fails(&folder, &format!("solve broken.ply {args}"), 2, words);
    }
    fails(
        &folder,
        "visible broken.ply --from 0,0,0 -o seen.laz",
        2,
        "must end with .ply",
    );
}

#[test]
fn colours_are_painted_as_asked() {
    let folder = folder();
    let text = "x y z nx ny nz red green blue intensity\n0 0 0 0 0 1 255 0 0 7\n\
                1 0 0 0 0 1 0 255 0 8\n0 1 0 0 0 1 0 0 255 9\n1 1 0 0 0 1 9 9 9 10\n";
    fs::write(folder.path().join("scan.txt"), text).unwrap();
    for (args, header) in [
        (
            "",
            "x,y,z,nx,ny,nz,original_red,original_green,original_blue,intensity,red",
        ),
        (
            "--paint irradiance",
            "x,y,z,nx,ny,nz,original_red,original_green,original_blue,intensity,red",
        ),
        (
            "--paint keep",
            "x,y,z,nx,ny,nz,red,green,blue,intensity,radius",
        ),
    ] {
        run(
            folder.path(),
            &format!("solve scan.txt --sky 1,1,1 --backend cpu --solver-error -o lit.csv {args}"),
        )
        .success();
        let csv = fs::read_to_string(folder.path().join("lit.csv")).unwrap();
        let lines: Vec<&str> = csv.lines().collect();
        assert!(lines[0].starts_with(header), "{args}: {}", lines[0]);
        assert!(
            lines[2].starts_with("1,0,0,0,0,1,0,255,0,8,"),
            "{args}: {}",
            lines[2]
        );
    }
    fails(&folder, "solve scan.txt --paint lit", 2, "--output");
}
