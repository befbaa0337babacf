//! Files of kept operators, with whatever is in them behind a right checksum:
//! `cargo +nightly fuzz run operator`.
#![no_main]

use std::sync::OnceLock;

use fmmgi_gpu::glam::{DVec3, Vec3};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{Backend, Method, Options, PointCloud, Scene, Transport};
use libfuzzer_sys::fuzz_target;
use tempfile::TempDir;
use xxhash_rust::xxh3::xxh3_64;

fn options() -> Options {
    Options {
        method: Method::Fmm,
        ..Options::default()
    }
}

/// Two plates of 6 by 6 points that face each other, under a lamp, and the file of what was kept.
struct Start {
    folder: TempDir,
    scene: Scene,
    bytes: Vec<u8>,
}

fn start() -> Start {
    let mut cloud = PointCloud::default();
    for k in 0..72 {
        let [x, y] = [k % 6, k / 6 % 6].map(|i| f64::from(i) / 6.0);
        let up = k < 36;
        cloud.positions.push(DVec3::new(x, y, if up { 0.0 } else { 1.0 }));
        cloud.normals.push(if up { Vec3::Z } else { Vec3::NEG_Z });
        cloud.reflectance.push(Vec3::splat(0.5));
        cloud.emission.push(Vec3::ZERO);
    }
    let scene = Scene {
        cloud,
        lights: vec![PointLight {
            position: DVec3::new(0.4, 0.5, 0.6),
            intensity: Vec3::ONE,
        }],
        ..Scene::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept");
    let mut transport = Transport::new(&scene, &options(), Backend::Cpu, &Silent).unwrap();
    transport.illuminate(&scene, &Silent).unwrap();
    transport.save(&path).unwrap();
    let bytes = std::fs::read(path).unwrap();
    Start {
        folder,
        scene,
        bytes,
    }
}

// The input says, six bytes each, which words of a sound file become others.
fuzz_target!(|changes: &[u8]| {
    static START: OnceLock<Start> = OnceLock::new();
    let start = START.get_or_init(start);
    let mut bytes = start.bytes.clone();
    let words = bytes.len() / 4 - 2;
    for change in changes.chunks_exact(6) {
        let word = usize::from(u16::from_le_bytes([change[0], change[1]])) % words;
        bytes[4 * word..4 * word + 4].copy_from_slice(&change[2..]);
    }
    let end = bytes.len() - 8;
    let checksum = xxh3_64(&bytes[..end]);
    bytes[end..].copy_from_slice(&checksum.to_le_bytes());
    let path = start.folder.path().join("other");
    std::fs::write(&path, &bytes).unwrap();
    if let Ok(mut loaded) =
        Transport::load(&path, &start.scene, &options(), Backend::Cpu, &Silent)
    {
        let _ = loaded.illuminate(&start.scene, &Silent);
    }
});
