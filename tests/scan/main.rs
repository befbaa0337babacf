//! Reading scans: what is understood, and that nothing else does harm.

mod fuzz;
mod mesh;
mod pcd;
mod ptx;
mod real;
mod refused;
mod text;
mod understood;

use std::io::Write;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan::{ColourSpace, ReadOptions, Scan};
use fmmgi_gpu::{Error, PointCloud, scan};
use glam::Vec3;
use tempfile::NamedTempFile;

fn file(bytes: &[u8]) -> NamedTempFile {
    named(bytes, "")
}

/// A file with an ending.
fn named(bytes: &[u8], ending: &str) -> NamedTempFile {
    let ending = match ending {
        "" => String::new(),
        ending => format!(".{ending}"),
    };
    let mut file = tempfile::Builder::new().suffix(&ending).tempfile().unwrap();
    file.write_all(bytes).unwrap();
    file
}

fn read(bytes: &[u8]) -> Result<PointCloud, Error> {
    scan::read(file(bytes).path(), &Silent)
}

/// The message of the error that reading gives; it must name the file.
fn error(bytes: &[u8]) -> String {
    error_named(bytes, "")
}

fn error_named(bytes: &[u8], ending: &str) -> String {
    let file = named(bytes, ending);
    let error = scan::read(file.path(), &Silent).expect_err("bad input was read");
    let message = error.to_string();
    assert!(
        message.starts_with(file.path().to_str().unwrap()),
        "{message}"
    );
    assert_eq!(error.exit_code(), 1);
    message
}

/// Reads a file that may be damaged: whatever comes out fits together.
fn sound(bytes: &[u8], ending: &str) {
    let options = ReadOptions {
        faces: true,
        points: Some(100),
        ..ReadOptions::default()
    };
    for options in [ReadOptions::default(), options] {
        let file = named(bytes, ending);
        let Ok(Scan { cloud, .. }) = Scan::read(file.path(), &options, &Silent) else {
            continue;
        };
        let n = cloud.len();
        assert!(n > 0 && cloud.reflectance.len() == n && cloud.emission.len() == n);
        for optional in [cloud.normals.len(), cloud.areas.len()] {
            assert!(optional == 0 || optional == n);
        }
        let zero_to_one = |r: &Vec3| r.cmpge(Vec3::ZERO).all() && r.cmple(Vec3::ONE).all();
        assert!(cloud.reflectance.iter().all(zero_to_one));
        assert!(
            cloud
                .scanners
                .iter()
                .all(|s| s.points.end <= n && s.position.is_finite())
        );
    }
}

fn ascii(body: &str) -> Vec<u8> {
    format!("ply\nformat ascii 1.0\n{body}").into_bytes()
}

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

/// Header with `extra` properties and two points, whose values are given as ascii words.
fn two_points(extra: &str, first: &str, second: &str) -> Vec<u8> {
    ascii(&format!(
        "element vertex 2\n{XYZ}{extra}end_header\n1 2 3 {first}\n4 5 6 {second}\n"
    ))
}

/// A binary file that has everything: an element with lists before the vertices, a list among
/// their properties, an element after them.
fn rich_binary(big_endian: bool) -> Vec<u8> {
    let name = if big_endian { "big" } else { "little" };
    let mut bytes = format!(
        "ply\nformat binary_{name}_endian 1.0\ncomment caf\u{e9}\nobj_info 7\n\
         element camera 2\nproperty list uchar int ids\nproperty double fov\n\
         element empty 1000\n\
         element fixed 3\nproperty short a\nproperty uint b\n\
         element vertex 2\nproperty double x\nproperty list ushort float weights\n\
         property float y\nproperty short z\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nproperty float scalar_Scalar_field_#2\nproperty float radius\n\
         element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    .into_bytes();
    bytes.retain(|&byte| byte != 0xc3); // comments may be in any encoding: here Latin-1
    macro_rules! put {
        ($($value:expr),*) => {
            $(bytes.extend(if big_endian { $value.to_be_bytes() } else { $value.to_le_bytes() });)*
        };
    }
    put!(2u8, 7i32, 8i32, 60.0f64);
    put!(0u8, 70.0f64);
    put!(1i16, 2u32, 1i16, 2u32, 1i16, 2u32);
    put!(
        1.5f64, 3u16, 0.1f32, 0.2f32, 0.3f32, -2.5f32, -300i16, 255u8, 0u8, 188u8, 9f32, 2f32
    );
    put!(6e6f64, 0u16, 0.25f32, 7i16, 0u8, 1u8, 2u8, 9f32, 1f32);
    put!(3u8, 0i32, 1i32, 0i32);
    bytes
}
