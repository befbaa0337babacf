//! Kept operators in files: what comes back is what went in, and no file does harm.

mod program;
mod relit;

use std::fs;
use std::path::Path;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Backend, Error, Method, Occlusion, Options, Result, Scene, Transport};
use program::{fails, folder, run};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use relit::{lamp, move_lamp};
use tempfile::TempDir;
use xxhash_rust::xxh3::xxh3_64;

const CEILING: [f64; 3] = [0.5, 0.9, 0.5];
const CORNER: [f64; 3] = [0.15, 0.2, 0.1];

/// Bytes before the arrays.
const HEADER: usize = 148;
/// Where counts are, and how many words one more takes: surfels, facets, cones, boxes, occluders,
/// links of order 1, sampled ones, those of surfels, pairs left out.
const MORE: [(usize, usize); 9] = [
    (56, 30),
    (60, 10),
    (64, 1),
    (68, 1),
    (72, 1),
    (88, 3),
    (136, 3),
    (140, 2),
    (144, 2),
];

fn options() -> Options {
    Options {
        method: Method::Fmm,
        ..Options::default()
    }
}

fn load(path: &Path, scene: &Scene) -> Result<Transport> {
    Transport::load(path, scene, &options(), Backend::Cpu, &Silent)
}

/// A scene, and the file of what was kept of its light.
struct Kept {
    folder: TempDir,
    scene: Scene,
    transport: Transport,
    bytes: Vec<u8>,
}

impl Kept {
    fn new(points: usize) -> Kept {
        let folder = tempfile::tempdir().unwrap();
        let scene = lamp("cornell", points, CEILING);
        let mut transport = Transport::new(&scene, &options(), Backend::Cpu, &Silent).unwrap();
        transport.illuminate(&scene, &Silent).unwrap();
        let path = folder.path().join("kept");
        transport.save(&path).unwrap();
        Kept {
            bytes: fs::read(path).unwrap(),
            folder,
            scene,
            transport,
        }
    }

    /// Loads other bytes.
    fn load(&self, bytes: &[u8]) -> Result<Transport> {
        let path = self.folder.path().join("other");
        fs::write(&path, bytes).unwrap();
        load(&path, &self.scene)
    }

    /// What is said against other bytes.
    fn refused(&self, bytes: &[u8]) -> String {
        match self.load(bytes) {
            Err(error @ Error::Input { .. }) => error.to_string(),
            Err(error) => panic!("{error:?}"),
            Ok(_) => panic!("taken"),
        }
    }
}

/// Puts the right checksum at the end.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    if let Some(end) = bytes.len().checked_sub(8) {
        let checksum = xxh3_64(&bytes[..end]);
        bytes[end..].copy_from_slice(&checksum.to_le_bytes());
    }
    bytes
}

#[test]
fn what_comes_back_is_what_went_in() {
    let mut kept = Kept::new(3000);
    let mut loaded = kept.load(&kept.bytes).unwrap();
    let again = kept.folder.path().join("again");
    loaded.save(&again).unwrap();
    assert!(fs::read(&again).unwrap() == kept.bytes);
    // Who is next to whom is no part of the file: it is found with the first light.
    kept.transport.illuminate(&kept.scene, &Silent).unwrap();
    loaded.illuminate(&kept.scene, &Silent).unwrap();
    // The next light needs other links.
    move_lamp(&mut kept.scene, CORNER);
    let here = kept.transport.illuminate(&kept.scene, &Silent).unwrap();
    let there = loaded.illuminate(&kept.scene, &Silent).unwrap();
    assert_eq!(here.map.irradiance, there.map.irradiance);
    assert_eq!(here.stats.segments, there.stats.segments);
    loaded.save(&again).unwrap();
    assert!(fs::metadata(&again).unwrap().len() > kept.bytes.len() as u64);
}

#[test]
fn a_transport_that_saw_no_light_keeps_its_surfels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("kept");
    let scene = lamp("cornell", 1500, CEILING);
    let mut transport = Transport::new(&scene, &options(), Backend::Cpu, &Silent).unwrap();
    transport.save(&path).unwrap();
    let mut loaded = load(&path, &scene).unwrap();
    let [here, there] =
        [&mut transport, &mut loaded].map(|t| t.illuminate(&scene, &Silent).unwrap());
    assert_eq!(here.map.irradiance, there.map.irradiance);
}

#[test]
fn files_that_do_not_fit_are_refused_with_words() {
    let kept = Kept::new(1500);
    let bytes = &kept.bytes;
    let patched = |place: usize, word: u32| {
        let mut bytes = bytes.clone();
        bytes[place..place + 4].copy_from_slice(&word.to_le_bytes());
        bytes
    };
    let refused = |bytes: &[u8], words: &str| {
        let said = kept.refused(bytes);
        assert!(said.contains(words), "{said}");
    };
    refused(b"", "too short");
    refused(&[0; 4096], "does not begin like one");
    refused(
        b"ply\nformat ascii 1.0\n".repeat(20).as_slice(),
        "does not begin like one",
    );
    refused(&patched(8, 99), "version 99");
    refused(&bytes[..bytes.len() - 4], "incomplete");
    refused(&[bytes.as_slice(), &[0; 4]].concat(), "incomplete");
    refused(&patched(bytes.len() / 2, 0x1234_5678), "checksum");
    // Counts that the length does not back allocate nothing.
    for place in (52..HEADER).step_by(4) {
        for word in [u32::MAX, 1 << 31, 1 << 24] {
            kept.refused(&sealed(patched(place, word)));
        }
    }
    let other = lamp("cornell", 1400, CEILING);
    let path = kept.folder.path().join("kept");
    let said = load(&path, &other).err().unwrap().to_string();
    assert!(
        said.contains("another cloud") && said.contains("--save-operator"),
        "{said}"
    );
    let mut moved = kept.scene.clone();
    moved.cloud.positions[0].x += 1e-9;
    assert!(
        load(&path, &moved)
            .err()
            .unwrap()
            .to_string()
            .contains("another cloud")
    );
    assert!(load(kept.folder.path(), &kept.scene).is_err());
    assert!(matches!(
        load(Path::new("nowhere"), &kept.scene),
        Err(Error::Io { .. })
    ));
    for options in [
        Options {
            method: Method::Gather,
            ..options()
        },
        Options {
            occlusion: Occlusion::None,
            ..options()
        },
        Options {
            order: Some(4),
            ..options()
        },
    ] {
        let loaded = Transport::load(&path, &kept.scene, &options, Backend::Cpu, &Silent);
        assert!(matches!(loaded, Err(Error::Usage(_))));
    }
}

#[test]
fn damage_behind_a_right_checksum_does_no_harm() {
    let kept = Kept::new(120);
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let (mut taken, mut refusals) = (0, std::collections::BTreeMap::new());
    for _ in 0..6000 {
        match kept.load(&sealed(damaged(&kept.bytes, &mut random))) {
            // Wrong numbers that could be right give wrong light, or none, with words.
            Ok(mut loaded) => {
                taken += 1;
                if taken % 8 == 0 {
                    let _ = loaded.illuminate(&kept.scene, &Silent);
                }
            }
            Err(error) => {
                let said = error.to_string();
                let what = said.rsplit(": ").next().unwrap_or_default().to_owned();
                *refusals.entry(what).or_insert(0) += 1;
            }
        }
    }
    println!(
        "{} bytes; {taken} taken; refused: {refusals:#?}",
        kept.bytes.len()
    );
    // All checks have been reached.
    for what in [
        "positions",
        "normals",
        "areas",
        "corners",
        "offsets",
        "points with",
        "surfels with",
        "children",
        "cells that are not there",
        "cells without an area",
        "boxes",
        "rows",
        "links to",
        "weights",
    ] {
        assert!(
            refusals.keys().any(|k| k.starts_with(what)),
            "{what}: {refusals:#?}"
        );
    }
}

/// One to three changes: bits, words, words that mean much, words from elsewhere, the length.
fn damaged(bytes: &[u8], random: &mut impl Rng) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..random.random_range(1..4) {
        let words = bytes.len() / 4;
        let word = match random.random_range(0..10) {
            0 => random.random_range(0..HEADER / 4),
            _ => random.random_range(0..words.max(1)),
        };
        let Some(at) = bytes.get_mut(4 * word..4 * word + 4) else {
            continue;
        };
        match random.random_range(0..12) {
            0 => at[random.random_range(0..4)] ^= 1 << random.random_range(0..8),
            1..=3 => at.copy_from_slice(&random.random::<u32>().to_le_bytes()),
            4..=8 => {
                let telling = [0, 1, 2, 3, 64, 119, 120, 121, u32::MAX, 1 << 31];
                let floats = [f32::NAN, f32::INFINITY, -1.0, 1e38, 1e-40, 1.0].map(f32::to_bits);
                let all = [telling.as_slice(), &floats].concat();
                at.copy_from_slice(&all[random.random_range(0..all.len())].to_le_bytes());
            }
            9 | 10 => {
                let from = 4 * random.random_range(0..words);
                bytes.copy_within(from..from + 4, 4 * word);
            }
            _ => {
                // One more of something, in a file that is as long as it has to be then.
                let (place, more) = MORE[random.random_range(0..MORE.len())];
                bytes[place] = bytes[place].wrapping_add(1);
                bytes.resize(bytes.len() + 4 * more, 0);
            }
        }
    }
    bytes
}

#[test]
fn the_program_keeps_an_operator_and_lights_with_it() {
    let folder = folder();
    let path = folder.path();
    fails(&folder, "relight scan.ply", 2, "--save-operator");
    fails(
        &folder,
        "solve scan.ply --save-operator kept --method gather",
        2,
        "fmm",
    );
    fails(
        &folder,
        "solve scan.ply --save-operator kept --visibility none",
        2,
        "fmm",
    );
    fails(
        &folder,
        "solve scan.ply --save-operator scan.ply",
        2,
        "the input",
    );
    let lamp = "--light point:0.5,0.5,0.5";
    run(path, &format!("relight scan.ply {lamp} --operator kept")).code(1);
    run(
        path,
        &format!("solve scan.ply {lamp} --save-operator kept -o a.ply"),
    )
    .success();
    run(
        path,
        &format!("relight scan.ply {lamp} --operator kept -o b.ply"),
    )
    .success();
    run(
        path,
        &format!("solve scan.ply {lamp} --operator kept -o c.ply"),
    )
    .success();
    let read = |name: &str| fs::read(path.join(name)).unwrap();
    assert!(read("b.ply") == read("c.ply"));
    run(path, "compare a.ply b.ply").success();
    // It may replace itself.
    run(
        path,
        &format!("relight scan.ply {lamp} --operator kept --save-operator kept"),
    )
    .success();
    fs::write(
        path.join("scan2.ply"),
        program::SCAN.replace("1 1 1 0", "1 1 1.5 0"),
    )
    .unwrap();
    let said = run(
        path,
        &format!("relight scan2.ply {lamp} --operator kept -o d.ply"),
    )
    .code(1);
    let said = String::from_utf8_lossy(&said.get_output().stderr).into_owned();
    assert!(said.contains("another cloud"), "{said}");
    assert!(!path.join("d.ply").exists());
}
