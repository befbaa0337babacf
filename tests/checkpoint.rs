//! Runs that are stopped or killed, and go on where they were.

mod common;
mod program;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::thread::sleep;
use std::time::{Duration, Instant};

use common::{gpu, random, scene};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::PointLight;
use fmmgi_gpu::{
    Backend, Checkpoint, Error, IlluminationMap, Method, Options, Progress, Result, Scene,
    Transport,
};
use glam::{DVec3, Vec3};
use rand::RngExt;

/// More than one round: links are refined.
fn options(method: Method) -> Options {
    Options {
        method,
        tolerance: Some(0.02),
        below_model: true,
        ..Options::default()
    }
}

/// Stops the work as a stage begins, and remembers what it is told.
#[derive(Default)]
struct Until {
    stage: Option<usize>,
    begun: AtomicUsize,
    names: Mutex<Vec<&'static str>>,
    notes: Mutex<String>,
}

impl Until {
    fn stage(stage: usize) -> Until {
        Until {
            stage: Some(stage),
            ..Until::default()
        }
    }

    fn begun(&self, name: &str) -> usize {
        let names = self.names.lock().unwrap();
        names.iter().filter(|n| **n == name).count()
    }

    fn was_told(&self, words: &str) -> bool {
        self.notes.lock().unwrap().contains(words)
    }
}

impl Progress for Until {
    fn stage(&self, name: &'static str, _: u64) {
        self.begun.fetch_add(1, Relaxed);
        self.names.lock().unwrap().push(name);
    }
    fn note(&self, line: &str) {
        *self.notes.lock().unwrap() += &format!("{line}\n");
    }
    fn cancelled(&self) -> bool {
        self.stage
            .is_some_and(|stage| self.begun.load(Relaxed) > stage)
    }
}

fn lit(
    scene: &Scene,
    options: &Options,
    backend: Backend,
    folder: &Path,
    progress: &Until,
) -> Result<IlluminationMap> {
    let mut transport = Transport::new(scene, options, backend, progress)?;
    let checkpoint = Checkpoint::open(folder, &Silent)?;
    Ok(transport.illuminate_from(scene, &checkpoint, progress)?.map)
}

/// Stops a run at one stage after the other, each time in the folder that the run before left, and
/// compares what comes out in the end.
fn stopped_and_resumed(method: Method, backend: fn() -> Backend<'static>, step: usize) {
    let scene = scene("cornell", 1500);
    let options = options(method);
    let whole = Until::default();
    let mut transport = Transport::new(&scene, &options, backend(), &whole).unwrap();
    let expected = transport.illuminate(&scene, &whole).unwrap();
    let refined = whole.notes.lock().unwrap().matches("links within").count();
    assert!(refined > 1 || method != Method::Fmm, "one round only");

    let folder = tempfile::tempdir().unwrap();
    let kept = folder.path().join("kept");
    let mut ended = None;
    for stage in (0..whole.begun.into_inner()).step_by(step) {
        match lit(&scene, &options, backend(), &kept, &Until::stage(stage)) {
            Err(Error::Interrupted) => {}
            other => ended = Some(other.unwrap()),
        }
    }
    let last = Until::default();
    let resumed = lit(&scene, &options, backend(), &kept, &last).unwrap();
    assert_eq!(resumed.irradiance, expected.map.irradiance);
    if let Some(ended) = ended {
        assert_eq!(ended.irradiance, expected.map.irradiance);
    }
    // With all stages there, nothing is solved once more.
    let again = Until::default();
    lit(&scene, &options, backend(), &kept, &again).unwrap();
    assert!(again.was_told("stages are done"));
    for name in ["links", "bounces", "verification"] {
        assert_eq!(again.begun(name), 0, "{name}");
    }
    let checkpoint = Checkpoint::open(&kept, &Silent).unwrap();
    fs::write(kept.join("a file of the user"), "x").unwrap();
    checkpoint.clear().unwrap();
    assert_eq!(names(&kept), [kept.join("a file of the user")]);
}

fn names(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    names.sort();
    names
}

#[test]
fn a_stopped_run_goes_on_with_the_same_bits() {
    stopped_and_resumed(Method::Fmm, || Backend::Cpu, 1);
}

#[test]
fn a_stopped_run_goes_on_with_the_same_bits_on_a_device() {
    let on_device = || Backend::Gpu {
        device: &gpu().device,
        queue: &gpu().queue,
        adapter: "test",
    };
    stopped_and_resumed(Method::Fmm, on_device, 7);
}

#[test]
fn methods_of_one_stage_go_on_as_well() {
    stopped_and_resumed(Method::Gather, || Backend::Cpu, 5);
}

/// A folder in which a run has ended, and what it found.
fn ended() -> (tempfile::TempDir, Scene, IlluminationMap) {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene("cornell", 1000);
    let run = Until::default();
    let map = lit(
        &scene,
        &options(Method::Fmm),
        Backend::Cpu,
        folder.path(),
        &run,
    )
    .unwrap();
    (folder, scene, map)
}

#[test]
fn a_damaged_checkpoint_is_begun_anew() {
    let (folder, scene, expected) = ended();
    let stages = |name: &PathBuf| name.to_string_lossy().contains("stage-");
    let files: Vec<PathBuf> = names(folder.path()).into_iter().filter(stages).collect();
    assert!(files.len() > 5, "{files:?}");
    let mut rng = random(3);
    for file in &files {
        let bytes = fs::read(file).unwrap();
        let mut flipped = bytes.clone();
        let place = rng.random_range(0..bytes.len());
        flipped[place] ^= 1 << rng.random_range(0..8);
        let cut = bytes[..rng.random_range(0..bytes.len())].to_vec();
        for damaged in [Some(flipped), Some(cut), None] {
            match damaged {
                Some(bytes) => fs::write(file, bytes).unwrap(),
                None => fs::remove_file(file).unwrap(),
            }
            // The last one may be missing: so it is where a run was killed before.
            let told = file.exists() || file != files.last().unwrap();
            let run = Until::default();
            let map = lit(
                &scene,
                &options(Method::Fmm),
                Backend::Cpu,
                folder.path(),
                &run,
            )
            .unwrap();
            assert_eq!(
                run.was_told("damaged, and begun anew"),
                told,
                "{}",
                file.display()
            );
            assert_eq!(map.irradiance, expected.irradiance);
        }
    }
}

#[test]
fn the_checkpoint_of_another_run_is_refused() {
    let (folder, scene, expected) = ended();
    let before: Vec<_> = names(folder.path())
        .iter()
        .map(|name| fs::read(name).unwrap())
        .collect();
    let refused = |scene: &Scene, options: &Options| {
        let run = Until::default();
        let error = lit(scene, options, Backend::Cpu, folder.path(), &run).unwrap_err();
        assert_eq!(error.exit_code(), 1);
        let message = error.to_string();
        assert!(
            message.contains("another input, other options"),
            "{message}"
        );
    };
    let of = options(Method::Fmm);
    refused(
        &scene,
        &Options {
            seed: 1,
            ..of.clone()
        },
    );
    refused(
        &scene,
        &Options {
            max_bounces: Some(3),
            ..of.clone()
        },
    );
    refused(
        &scene,
        &Options {
            tolerance: Some(0.05),
            ..of.clone()
        },
    );
    let mut other = scene.clone();
    other.lights.push(PointLight {
        position: DVec3::splat(0.5),
        intensity: Vec3::splat(1e-6),
    });
    refused(&other, &of);
    let mut other = scene.clone();
    other.sky = Vec3::ONE;
    refused(&other, &of);
    let mut other = scene.clone();
    other.cloud.reflectance[7].y += 1e-6;
    refused(&other, &of);
    // It is as it was.
    let after: Vec<_> = names(folder.path())
        .iter()
        .map(|name| fs::read(name).unwrap())
        .collect();
    assert!(before == after);
    let map = lit(&scene, &of, Backend::Cpu, folder.path(), &Until::default()).unwrap();
    assert_eq!(map.irradiance, expected.irradiance);
}

#[test]
fn a_folder_serves_one_run_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let first = Checkpoint::open(folder.path(), &Silent).unwrap();
    let second = Checkpoint::open(folder.path(), &Silent)
        .unwrap_err()
        .to_string();
    assert!(
        second.contains("of another run, which has not ended"),
        "{second}"
    );
    drop(first);
    Checkpoint::open(folder.path(), &Silent).unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "x").unwrap();
    let error = Checkpoint::open(&file, &Silent).unwrap_err();
    assert!(matches!(error, Error::Io { .. }), "{error:?}");
}

#[test]
fn a_run_waits_for_one_that_is_about_to_end() {
    let folder = tempfile::tempdir().unwrap();
    let progress = Until::default();
    // One that is killed only lets go, one that ends well takes the folder away.
    for clears in [false, true] {
        let first = Checkpoint::open(folder.path(), &progress).unwrap();
        assert_eq!(progress.was_told("waiting for another run"), clears);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                sleep(Duration::from_millis(700));
                match clears {
                    true => first.clear().unwrap(),
                    false => drop(first),
                }
            });
            Checkpoint::open(folder.path(), &progress).unwrap();
        });
        assert!(progress.was_told("waiting for another run"));
    }
}

/// kill -9 at random moments, of all that a run does, until one comes through.
#[test]
fn a_killed_program_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let room = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell.toml");
    let start = |output: &str, checkpoint: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_fmmgi-gpu"))
            .current_dir(folder.path())
            .args([
                "solve",
                room,
                "--points",
                "8000",
                "--tolerance",
                "0.015",
                "--below-model",
            ])
            .args(["--method", "fmm", "--backend", "cpu"])
            .args(["--output", output, "-v"])
            .args(checkpoint)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let clock = Instant::now();
    let code = start("whole.ply", &[]).wait().unwrap().code();
    assert!(matches!(code, Some(0 | 4)), "{code:?}");
    let mut whole = clock.elapsed();

    let mut rng = random(5);
    let (mut kills, mut resumed, mut lucky) = (0, 0, 0);
    let ended = loop {
        let mut run = start("lit.ply", &["--checkpoint", "kept"]);
        if kills < 12 {
            sleep(whole.mul_f64(rng.random_range(0.0..1.0)));
            run.kill().unwrap();
            kills += 1;
        }
        let output = run.wait_with_output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        resumed += usize::from(told.contains("stages are done"));
        assert!(
            !told.contains("error:") && !told.contains("damaged"),
            "{told}"
        );
        if output.status.code().is_some() {
            assert_eq!(output.status.code(), code, "{told}");
            if resumed > 0 {
                break told;
            }
            // It came through before the first kill: the whole run was slow for another reason.
            lucky += 1;
            assert!(lucky < 10, "no run found a stage");
            whole = whole.mul_f64(0.7);
        }
        // If it came so far, it is whole.
        let [lit, expected] =
            ["lit.ply", "whole.ply"].map(|name| fs::read(folder.path().join(name)));
        assert!(lit.is_err() || lit.unwrap() == expected.unwrap());
    };
    println!("{kills} kills, {resumed} runs went on: {ended}");
    let [lit, expected] = ["lit.ply", "whole.ply"].map(|name| fs::read(folder.path().join(name)));
    assert!(lit.unwrap() == expected.unwrap());
    // What is of no use any more is gone.
    assert!(!folder.path().join("kept").exists());
}

/// On a disk of 64 KiB nothing fits: neither the light nor the checkpoint, and nothing is left half
/// written. A disk that cannot be written to is told before the work.
#[test]
#[cfg(target_os = "linux")]
fn full_and_read_only_disks_are_told() {
    let folder = program::folder();
    let disk = folder.path().join("disk");
    fs::create_dir(&disk).unwrap();
    let mount = |options: &str| {
        let mut mount = Command::new("mount");
        mount
            .args(["-t", "tmpfs", "-o", options, "none"])
            .arg(&disk);
        mount.stderr(Stdio::null());
        mount.status().is_ok_and(|status| status.success())
    };
    if !mount("size=64k") {
        eprintln!("NOT RUN without the right to mount: a disk that is full");
        return;
    }
    struct Mounted<'a>(&'a Path);
    impl Drop for Mounted<'_> {
        fn drop(&mut self) {
            let _ = Command::new("umount").arg(self.0).status();
        }
    }
    let mounted = Mounted(&disk);
    let room = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/cornell.toml");
    for (output, what) in [
        ("--output disk/lit.ply", "disk/lit.ply"),
        ("--output disk/lit.laz", "disk/lit.laz"),
        ("--output disk/lit.npy", "disk/lit.npy"),
        ("--output disk/lit.csv", "disk/lit.csv"),
        ("--save-operator disk/operator", "disk/operator"),
        ("--checkpoint disk", "disk/stage-"),
    ] {
        let args =
            format!("solve {room} --points 8000 --backend cpu --method fmm --quiet {output}");
        let failed = program::run(folder.path(), &args).code(1);
        let told = String::from_utf8_lossy(&failed.get_output().stderr).into_owned();
        assert!(
            told.starts_with("error: ") && told.contains(what) && told.contains("No space left"),
            "{output}: {told}"
        );
        // Stages that fitted may stay, whole.
        let left = names(&disk).into_iter().filter(|name| {
            let name = name.file_name().unwrap().to_string_lossy();
            !name.starts_with("stage-") && name != "in-use"
        });
        assert_eq!(left.count(), 0, "{output}: {:?}", names(&disk));
    }
    drop(mounted);
    assert!(mount("size=64k,ro"));
    let _mounted = Mounted(&disk);
    for output in [
        "--output disk/lit.ply",
        "--save-operator disk/operator",
        "--checkpoint disk/kept",
    ] {
        let args = format!("solve scan.ply --sky 1,1,1 --backend cpu {output}");
        program::fails(&folder, &args, 1, "ead-only file");
    }
}
