//! What becomes of scans: a row of a table for each file (format, points, seconds to load and to prepare
//! it, peak memory of that, what was repaired) and a small picture of it, lit by the sky and by a lamp
//! beside the camera.
//!
//! ```sh
//! cargo run --release --example scans -- FOLDER -o PICTURES
//! cargo run --release --example scans -- room.laz pump.e57       # without pictures
//! ```
//!
//! Each file is read and prepared in a process of its own. A file that is no scan has its error in the row.

use std::ffi::OsString;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use fmmgi_gpu::glam::{DVec3, Vec3};
use fmmgi_gpu::output::write_atomic;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{Backend, Method, Options, Result, Scene, Transport, memory, render};

/// Stands before the file and the picture that a process of its own is for.
const ONE: &str = "--one";
const SIZE: [u32; 2] = [480, 360];
/// Enough for a picture.
const TOLERANCE: f64 = 0.1;
const RAYS: u32 = 16;
/// Irradiance from the sky, beside that of about 1 from the lamp.
const SKY: f32 = 0.3;
/// How far the lamp hangs over the camera, of the way to what that looks at.
const ABOVE: f64 = 0.1;

fn main() -> Result<()> {
    let mut args: Vec<OsString> = std::env::args_os().skip(1).collect();
    if args.first().is_some_and(|first| first == ONE) {
        // In words, which the table takes over.
        if let Err(e) = row(Path::new(&args[1]), args.get(2).map(Path::new)) {
            eprintln!("{e}");
            std::process::exit(1);
        }
        return Ok(());
    }
    let folder = args.iter().position(|arg| arg == "-o").and_then(|k| {
        let folder = (k + 1 < args.len()).then(|| PathBuf::from(args.remove(k + 1)));
        args.remove(k);
        folder
    });
    let cannot = |path: &Path, e: io::Error| fmmgi_gpu::Error::io(path, "cannot be used", e);
    if let Some(folder) = &folder {
        std::fs::create_dir_all(folder).map_err(|e| cannot(folder, e))?;
    }
    println!("| file | format | points | load, s | prepare, s | peak, MiB | repairs |");
    println!("|---|---|---|---|---|---|---|");
    let program = std::env::current_exe().map_err(|e| cannot(Path::new("this program"), e))?;
    for path in files(args.iter().map(PathBuf::from)) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let mut one = Command::new(&program);
        one.arg(ONE).arg(&path);
        one.args(folder.as_ref().map(|f| f.join(format!("{name}.png"))));
        let done = one.output().map_err(|e| cannot(&program, e))?;
        let told = String::from_utf8_lossy(&done.stdout);
        match told.trim_end() {
            "" => println!(
                "| {name} | | | | | | {} |",
                String::from_utf8_lossy(&done.stderr)
                    .trim()
                    .replace('\n', " ")
            ),
            row => println!("{row}"),
        }
        if !done.status.success() && !told.is_empty() {
            eprintln!("{name}: {}", String::from_utf8_lossy(&done.stderr).trim());
        }
    }
    Ok(())
}

/// The files, and those in the folders, by name.
fn files(paths: impl Iterator<Item = PathBuf>) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for path in paths {
        let Ok(entries) = path.read_dir() else {
            files.push(path);
            continue;
        };
        let mut found: Vec<PathBuf> = (entries.filter_map(|entry| Some(entry.ok()?.path())))
            .filter(|path| path.is_file())
            .collect();
        found.sort();
        files.append(&mut found);
    }
    files
}

/// Prints the row of a file, and takes its picture.
fn row(path: &Path, picture: Option<&Path>) -> Result<()> {
    let start = Instant::now();
    let mut scene = Scene::load(path, &SceneOptions::default(), &Silent)?;
    let load = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let options = Options {
        tolerance: Some(TOLERANCE),
        method: Method::Gather,
        rays: Some(RAYS),
        ..Options::default()
    };
    let mut transport = Transport::new(&scene, &options, Backend::Cpu, &Silent)?;
    let prepare = start.elapsed().as_secs_f64();
    let peak = memory::peak_bytes().map_or("?".into(), |bytes| (bytes >> 20).to_string());
    println!(
        "| {} | {} | {} | {load:.2} | {prepare:.2} | {peak} | {} |",
        path.file_name().unwrap_or_default().to_string_lossy(),
        scene.sources[0].format,
        scene.cloud.len(),
        transport.repairs().join("; ")
    );
    io::stdout().flush().ok();
    let Some(picture) = picture else {
        return Ok(());
    };
    let surfels = transport.surfels();
    let occluders = Occluders::build(surfels);
    let aspect = f64::from(SIZE[0]) / f64::from(SIZE[1]);
    let sight = CpuVisibility::<f32>::new(&occluders);
    let camera = render::fit(&scene.cloud, surfels, &sight, aspect)?;
    let way: DVec3 = camera.look_at - camera.position;
    scene.lights = vec![PointLight {
        position: camera.position + camera.up.normalize_or_zero() * (ABOVE * way.length()),
        intensity: Vec3::splat(way.length_squared() as f32),
    }];
    scene.sky = Vec3::splat(SKY);
    let lit = transport.illuminate(&scene, &Silent)?;
    let exposure = render::tone::exposure(&lit.map.radiosity);
    let image = render::picture(&scene.cloud, &lit.map, &camera, SIZE[0], SIZE[1], &Silent)?;
    let png = render::encode_png(&image, exposure)?;
    write_atomic(picture, |writer| writer.write_all(&png))
}
