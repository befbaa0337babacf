//! Small inputs that programs read wrong, with the right answers: a line for each.
//!
//! `cargo test --release --test faults -- --nocapture` prints the lines. The files are not part of this
//! repository.

use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Mutex;

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan::ReadOptions;
use fmmgi_gpu::scan::Scan;
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::{Backend, Illumination, Options, Scene, illuminate};
use glam::{DVec3, Vec3, dvec3, vec3};

/// The folder of the files.
fn faults() -> Option<PathBuf> {
    let folder = std::env::var_os("FMMGI_FAULTS").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/faults")),
        PathBuf::from,
    );
    if !folder.is_dir() {
        eprintln!("NOT RUN: there is no folder at {}", folder.display());
        return None;
    }
    Some(folder)
}

/// What came of the files.
struct Report {
    folder: PathBuf,
    lines: Mutex<String>,
    wrong: Mutex<Vec<String>>,
}

impl Report {
    fn scene(&self, name: &str) -> Result<Scene, String> {
        let path = self.folder.join(name);
        Scene::load(&path, &SceneOptions::default(), &Silent).map_err(|e| e.to_string())
    }

    /// The light of a file, of a lamp or the sky.
    fn lit(
        &self,
        name: &str,
        lamp: Option<(DVec3, Vec3)>,
    ) -> Result<(Scene, Illumination), String> {
        let mut scene = self.scene(name)?;
        match lamp {
            Some((position, intensity)) => scene.lights.push(PointLight {
                position,
                intensity,
            }),
            None => scene.sky = Vec3::ONE,
        }
        let lit = illuminate(&scene, &Options::default(), Backend::Cpu, &Silent);
        Ok((scene, lit.map_err(|e| e.to_string())?))
    }

    fn tell(&self, name: &str, found: Result<String, String>, right: bool) {
        let found = found.unwrap_or_else(|error| format!("refused: {error}"));
        let word = if right { "right" } else { "WRONG" };
        writeln!(self.lines.lock().unwrap(), "{word}  {name}: {found}").unwrap();
        if !right {
            self.wrong.lock().unwrap().push(name.to_owned());
        }
    }

    fn value(&self, name: &str, found: Result<f64, String>, expected: f64, within: f64) {
        let right = found
            .as_ref()
            .is_ok_and(|x| (x / expected - 1.0).abs() < within);
        self.tell(
            name,
            found.map(|x| format!("{x:.3}, expected {expected}")),
            right,
        );
    }

    fn words(&self, name: &str, found: Result<String, String>, expected: &str) {
        let right = match &found {
            Ok(text) | Err(text) => text.contains(expected),
        };
        self.tell(name, found, right);
    }

    /// A file with the colours and the box of the room.
    fn room(&self, name: &str) {
        let mean = |scene: &Scene| {
            let sum: Vec3 = scene.cloud.reflectance.iter().sum();
            sum / scene.cloud.len() as f32
        };
        let scene = self.scene(name);
        let right = scene.as_ref().is_ok_and(|scene| {
            let bounds = scene.bounds().unwrap();
            let same_size = (bounds.max - bounds.min - dvec3(4.0, 3.0, 2.5)).length() < 1e-3;
            scene.cloud.len() >= 236
                && same_size
                && (mean(scene) - vec3(0.379, 0.364, 0.399)).length() < 2e-3
        });
        let found = scene.map(|s| format!("{} points, reflectance {:.3}", s.cloud.len(), mean(&s)));
        self.tell(name, found, right);
    }
}

fn mean(lit: &Illumination) -> f64 {
    let sum: f64 = lit.map.irradiance.iter().map(|h| f64::from(h.x)).sum();
    sum / lit.map.irradiance.len() as f64
}

#[test]
fn all_are_right() {
    let Some(folder) = faults() else { return };
    let report = Report {
        folder,
        lines: Mutex::default(),
        wrong: Mutex::default(),
    };
    let r = &report;
    let lamp = |x, y, z| Some((dvec3(x, y, z), vec3(10.0, 9.0, 8.0)));
    let (in_room, on_map) = (lamp(2.0, 1.5, 1.25), lamp(500_002.0, 5_000_001.5, 301.25));

    // A default viewpoint is no evidence.
    for name in ["object.xyz", "pcd_default_viewpoint_object.pcd"] {
        r.value(
            name,
            r.lit(name, None).map(|(_, lit)| mean(&lit)),
            1.0,
            0.03,
        );
        let lamp = Some((dvec3(0.0, 0.0, 5.0), Vec3::splat(25.0)));
        r.value(
            name,
            r.lit(name, lamp).map(|(_, lit)| mean(&lit)),
            0.254,
            0.05,
        );
    }
    // Flagged points are in nobody's way.
    for name in ["las_room.las", "las_withheld.las", "las_noise_class7.las"] {
        let wall = r.lit(name, on_map).map(|(scene, lit)| {
            let points = scene.cloud.positions.iter().enumerate();
            let wall = points.filter(|(i, p)| {
                (p.x - 500_000.0).abs() < 1e-6 && scene.cloud.flagged.get(*i) != Some(&true)
            });
            let light: Vec<f64> = wall.map(|(i, _)| lit.map.irradiance[i].x.into()).collect();
            light.iter().sum::<f64>() / light.len() as f64
        });
        r.value(name, wall, 3.17, 0.06);
    }
    for name in [
        "obj_wall_with_door.obj",
        "obj_line_continuation.obj",
        "obj_face_of_two.obj",
    ] {
        let path = r.folder.join(name);
        let scan = Scan::read(&path, &ReadOptions::default(), &Silent).map_err(|e| e.to_string());
        let area = scan.map(|scan| {
            let in_door = |p: &DVec3| name.contains("door") && p.x > 2.0 && p.x < 3.0 && p.z < 2.0;
            match scan.cloud.positions.iter().any(in_door) {
                true => 0.0,
                false => scan.cloud.areas.iter().map(|&a| f64::from(a)).sum(),
            }
        });
        let expected = if name.contains("door") { 13.0 } else { 6.0 };
        r.value(name, area, expected, 1e-3);
    }
    let doubts = |name: &str, lamp: Option<(DVec3, Vec3)>| {
        let mut scene = r.scene(name)?;
        let lights = lamp.map(|(position, intensity)| PointLight {
            position,
            intensity,
        });
        scene.lights.extend(lights);
        Ok(scene.doubts().map_err(|e| e.to_string())?.concat())
    };
    r.words(
        "utm_float32.ply",
        doubts("utm_float32.ply", on_map),
        "coordinates step by 0.5",
    );
    r.words(
        "utm_double.ply",
        doubts("utm_double.ply", in_room),
        "lies far from the points",
    );
    let both = ["local.ply", "utm_double.ply"].map(|name| r.folder.join(name));
    let both = Scene::load_all(&both, &SceneOptions::default(), &Silent);
    r.words(
        "local.ply and utm_double.ply",
        both.map(|_| "lit together".into())
            .map_err(|e| e.to_string()),
        "--far-apart",
    );

    for name in [
        "ply_diffuse_red.ply",
        "pcd_r_g_b.pcd",
        "ply_3dgs.ply",
        "ply_float255.ply",
        "ply_ushort_0_255.ply",
        "pcd_rgb_F_whole_numbers.pcd",
        "txt_x_y_z_r_g_b_label.txt",
        "txt_row_column_x_y_z_r_g_b.xyz",
        "txt_R_rownames.txt",
        "txt_decimal_comma_semicolon.csv",
        "txt_utf16.csv",
        "ply_vertex_over_two_lines.ply",
        "ply_bom.ply",
        "ply_int64.ply",
        "ply_normalx.ply",
    ] {
        r.room(name);
    }
    let normals = r
        .scene("ply_normalx.ply")
        .map(|scene| f64::from(scene.cloud.normals[0].z));
    r.value("ply_normalx.ply", normals, -1.0, 1e-6);
    let points = |name: &str| r.scene(name).map(|scene| scene.cloud.len() as f64);
    r.value(
        "pcd_upper_xyz.pcd",
        points("pcd_upper_xyz.pcd"),
        236.0,
        1e-9,
    );
    r.value(
        "e57_no_return_at_origin.e57",
        points("e57_no_return_at_origin.e57"),
        236.0,
        1e-9,
    );
    let light = |name: &str| r.lit(name, in_room).map(|(_, lit)| mean(&lit));
    let expected = light("e57_room.e57").unwrap_or(0.0);
    r.value(
        "e57_no_return_at_origin.e57",
        light("e57_no_return_at_origin.e57"),
        expected,
        0.02,
    );
    let name = "las_legacy_count_differs.las";
    r.value(name, points(name), 236.0, 1e-9);
    r.words(
        "gzip_named_ply.ply",
        r.scene("gzip_named_ply.ply").map(|_| "read".into()),
        "gzip",
    );

    println!("{}", report.lines.lock().unwrap());
    let wrong = report.wrong.lock().unwrap();
    assert!(wrong.is_empty(), "{wrong:?}");
}
