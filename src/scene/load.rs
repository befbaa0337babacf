//! From a file to a scene.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3, Vec3};

use super::file::{CloudTable, SceneFile};
use super::sample::sample_model;
use super::surface::Model;
use super::{PointLight, Scene, SceneOptions, Source};
use crate::error::{Error, Result};
use crate::memory;
use crate::points::{DEFAULT_REFLECTANCE, Grid, PointCloud, Scanner};
use crate::progress::Progress;
use crate::scan::{ReadOptions, Scan};

/// Points on built-in shapes when nobody says how many.
pub(crate) const DEFAULT_POINTS: usize = 20_000;
/// No scene file is longer; a scan under the wrong name is.
const LONGEST_FILE: u64 = 16 << 20;

impl Scene {
    /// Reads a scene file (`.toml`), or a scan as a scene without lights.
    ///
    /// Built-in shapes share the number of points by area. A shape's points all have the same
    /// area; the sum is exact. Points that lie inside another solid shape or where two touch face
    /// to face are removed, so the cloud can have fewer points than were asked for. The order of
    /// the points is that of the file: shapes, then scans.
    ///
    /// # Errors
    /// [`Error::Input`] and [`Error::Io`] name the file, the line and what is wrong;
    /// [`Error::Usage`] when a number of points is asked for that cannot be;
    /// [`Error::TooLarge`] before more points are made than memory holds.
    pub fn load(path: &Path, options: &SceneOptions, progress: &dyn Progress) -> Result<Scene> {
        Scene::load_all(&[path], options, progress)
    }

    /// Reads several files into one scene, in their order: any number of scans and at most one
    /// scene file.
    ///
    /// # Errors
    /// As [`Scene::load`]; also [`Error::Usage`] for a second scene file, and for files that lie thousands of
    /// their sizes apart, unless the options say that this is meant.
    pub fn load_all<P: AsRef<Path>>(
        paths: &[P],
        options: &SceneOptions,
        progress: &dyn Progress,
    ) -> Result<Scene> {
        if options.points == Some(0) {
            return Err(Error::Usage("0 points: a scene needs at least 1".into()));
        }
        let paths = paths.iter().map(AsRef::as_ref);
        let mut scene = Scene::default();
        let mut has_surfaces = false;
        if let Some(second) = paths.clone().filter(|path| is_scene_file(path)).nth(1) {
            return Err(Error::Usage(format!(
                "{}: a second scene file; only scans can be added to one",
                second.display()
            )));
        }
        for path in paths.clone() {
            let surfaces = if is_scene_file(path) {
                scene.add_scene_file(path, options, progress)?
            } else {
                let scan = Scan::read(path, &read_options(options), progress)?;
                let sampled = scan.sampled;
                scene.add(path.to_owned(), scan, false);
                sampled
            };
            has_surfaces |= surfaces;
        }
        scene.check_together(options.far_apart)?;
        // A number of points says how finely surfaces are sampled; scans are not resampled.
        match (options.points, paths.last()) {
            (Some(_), Some(path)) if !has_surfaces => Err(Error::Usage(format!(
                "{}: the number of points can be chosen only for built-in shapes and meshes, not \
                 for a scan",
                path.display()
            ))),
            _ => Ok(scene),
        }
    }

    /// Adds the points of a file behind those that are there.
    fn add(&mut self, path: PathBuf, scan: Scan, moved: bool) {
        let before = self.cloud.len();
        append(&mut self.cloud, scan.cloud);
        self.sources.push(Source {
            path,
            format: scan.format,
            fields: scan.fields,
            taken: scan.taken,
            points: before..self.cloud.len(),
            sampled: scan.sampled,
            moved,
        });
    }

    /// Adds all that a scene file has; tells whether points were made on shapes or meshes.
    fn add_scene_file(
        &mut self,
        path: &Path,
        options: &SceneOptions,
        progress: &dyn Progress,
    ) -> Result<bool> {
        let text = read_text(path)?;
        let file: SceneFile =
            toml::from_str(&text).map_err(|e| Error::input(path, in_words(&e)))?;
        if file.shape.is_empty() && file.cloud.is_empty() {
            return Err(Error::input(
                path,
                "nothing to light: a scene needs a [[shape]] or a [[cloud]]",
            ));
        }
        let mut has_surfaces = !file.shape.is_empty();
        let mut shapes = PointCloud::default();
        if has_surfaces {
            let mut model = Model::default();
            file.shape.iter().for_each(|shape| shape.build(&mut model));
            let in_file = file.points.map(|n| n.0);
            let count = options.points.or(in_file).unwrap_or(DEFAULT_POINTS);
            check_size(path, count)?;
            shapes = sample_model(path, &model, count, options.seed, progress)?;
        } else if file.points.is_some() {
            let message = "points: there is no [[shape]] to put them on";
            return Err(Error::input(path, message));
        }
        let shapes = Scan {
            format: format!("scene file, shapes: {}", file.shape.len()),
            sampled: has_surfaces,
            cloud: shapes,
            ..Scan::default()
        };
        self.add(path.to_owned(), shapes, false);
        for table in &file.cloud {
            let scan_path = scan_path(path, table)?;
            let mut scan = Scan::read(&scan_path, &table.read_options(options), progress)?;
            has_surfaces |= scan.sampled;
            scan.cloud = place(scan.cloud, table);
            self.add(scan_path, scan, table.moves());
        }
        self.lights.extend(file.light.iter().map(PointLight::from));
        self.sky = file.sky.0;
        self.camera = file.camera.map(|c| c.0);
        self.tolerance = file.tolerance.map(|t| t.0);
        Ok(has_surfaces)
    }
}

fn is_scene_file(path: &Path) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("toml"))
}

fn read_options(options: &SceneOptions) -> ReadOptions {
    ReadOptions {
        faces: options.mesh,
        points: options.points,
        spacing: None,
        seed: options.seed,
        colours: options.colours,
        keep_flagged: options.keep_flagged,
        columns: options.columns.clone(),
    }
}

impl CloudTable {
    /// Whether points are at other places than in their file.
    fn moves(&self) -> bool {
        let is_scaled = self.scale.is_some_and(|scale| scale.0 != 1.0);
        is_scaled || self.rotate.0 != DQuat::IDENTITY || self.translate.0 != DVec3::ZERO
    }

    /// What the file says goes before what the caller asks for; lengths are those of the scene.
    fn read_options(&self, options: &SceneOptions) -> ReadOptions {
        let scale = self.scale.map_or(1.0, |s| s.0);
        let general = read_options(options);
        let says_how_many = self.points.is_some() || self.spacing.is_some();
        ReadOptions {
            faces: self.mesh || general.faces,
            points: self
                .points
                .map(|n| n.0)
                .or(general.points.filter(|_| !says_how_many)),
            spacing: self.spacing.map(|s| s.0 / scale),
            ..general
        }
    }
}

fn read_text(path: &Path) -> Result<String> {
    let file = File::open(path).map_err(|e| Error::io(path, "cannot open", e))?;
    let mut bytes = Vec::new();
    file.take(LONGEST_FILE + 1)
        .read_to_end(&mut bytes)
        .map_err(|e| Error::io(path, "cannot read", e))?;
    if bytes.len() as u64 > LONGEST_FILE {
        let limit = LONGEST_FILE >> 20;
        return Err(Error::input(
            path,
            format!("longer than {limit} MiB: this is no scene file"),
        ));
    }
    String::from_utf8(bytes).map_err(|e| {
        Error::input(
            path,
            format!("not a text file in UTF-8: {}", e.utf8_error()),
        )
    })
}

/// The parser's message, which shows the line, in the words of the file's writer.
fn in_words(error: &toml::de::Error) -> String {
    let mut text = error.to_string().trim_end().to_string();
    for (theirs, ours) in [
        ("TOML parse error at line", "line"),
        ("unknown field", "unknown key"),
        ("missing field", "missing key"),
        ("expected i64", "expected a whole number"),
        ("expected f64", "expected a number"),
        ("expected a sequence", "expected a list of numbers"),
    ] {
        text = text.replace(theirs, ours);
    }
    text
}

/// Refuses a number of points before anything is allocated for it.
fn check_size(path: &Path, count: usize) -> Result<()> {
    memory::check_points(count as u64)
        .map_err(|error| Error::TooLarge(format!("{}: {error}", path.display())))
}

/// Where the scan of a table is.
fn scan_path(scene_file: &Path, table: &CloudTable) -> Result<PathBuf> {
    if is_scene_file(&table.file) {
        return Err(Error::input(
            scene_file,
            format!(
                "cloud {}: a scene cannot contain a scene file",
                table.file.display()
            ),
        ));
    }
    let folder = scene_file.parent().unwrap_or(Path::new("."));
    Ok(folder.join(&table.file))
}

/// Scales, turns and moves a cloud, and gives it its material.
fn place(mut cloud: PointCloud, table: &CloudTable) -> PointCloud {
    let scale = table.scale.map_or(1.0, |s| s.0);
    let turn = table.rotate.0;
    if table.moves() {
        cloud.grid = None;
    }
    for p in &mut cloud.positions {
        *p = turn * (*p * scale) + table.translate.0;
    }
    for scanner in &mut cloud.scanners {
        scanner.position = turn * (scanner.position * scale) + table.translate.0;
    }
    let turn = turn.as_quat();
    cloud.normals.iter_mut().for_each(|n| *n = turn * *n);
    let areas = (scale * scale) as f32;
    cloud.areas.iter_mut().for_each(|a| *a *= areas);
    if let Some(reflectance) = table.reflectance {
        cloud.reflectance = vec![reflectance.0; cloud.len()];
    }
    if let Some(emission) = table.emission {
        cloud.emission = vec![emission.0; cloud.len()];
    }
    cloud
}

/// Puts the points of `more` behind those of `cloud`.
fn append(cloud: &mut PointCloud, more: PointCloud) {
    let (before, added) = (cloud.len(), more.len());
    // Where one of the two lacks a property, its points get the value that stands for "unknown".
    fn join<T: Clone>(a: &mut Vec<T>, mut b: Vec<T>, before: usize, added: usize, unknown: T) {
        if a.is_empty() && b.is_empty() {
            return;
        }
        a.resize(before, unknown.clone());
        b.resize(added, unknown);
        a.append(&mut b);
    }
    join(&mut cloud.normals, more.normals, before, added, Vec3::ZERO);
    let grey = Vec3::splat(DEFAULT_REFLECTANCE);
    join(
        &mut cloud.reflectance,
        more.reflectance,
        before,
        added,
        grey,
    );
    join(
        &mut cloud.emission,
        more.emission,
        before,
        added,
        Vec3::ZERO,
    );
    join(&mut cloud.flagged, more.flagged, before, added, false);
    // Areas are all from the source, or all from the cells.
    if before > 0 && cloud.areas.is_empty() || added > 0 && more.areas.is_empty() {
        cloud.areas.clear();
    } else {
        cloud.areas.extend(more.areas);
    }
    // Grids that differ only in where they begin are taken for one.
    let alike = |a: &Grid, b: &Grid| a.scale == b.scale && a.reference == b.reference;
    cloud.grid = match (cloud.grid.take(), more.grid) {
        (_, grid) if before == 0 => grid,
        (grid, _) if added == 0 => grid,
        (Some(a), Some(b)) if alike(&a, &b) => Some(a),
        _ => None,
    };
    cloud.positions.extend(more.positions);
    let shifted = more.scanners.into_iter().map(|scanner| Scanner {
        points: scanner.points.start + before..scanner.points.end + before,
        ..scanner
    });
    cloud.scanners.extend(shifted);
    cloud.repairs.extend(more.repairs);
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;

    fn one_point() -> PointCloud {
        PointCloud {
            positions: vec![dvec3(1.0, 2.0, 3.0)],
            normals: vec![Vec3::Z],
            areas: vec![0.5],
            reflectance: vec![Vec3::splat(0.2)],
            emission: vec![Vec3::ZERO],
            scanners: vec![Scanner {
                position: dvec3(0.0, 1.0, 0.0),
                points: 0..1,
            }],
            flagged: Vec::new(),
            grid: None,
            repairs: vec!["1 repair".into()],
        }
    }

    #[test]
    fn a_cloud_is_scaled_then_turned_then_moved() {
        let table: CloudTable = toml::from_str(
            "file = 'a.ply'\nscale = 2\nrotate = [90, 0, 90]\ntranslate = [10, 0, 0]\nemission = 3",
        )
        .unwrap();
        let cloud = place(one_point(), &table);
        // (2, 4, 6) about x: (2, -6, 4); about z: (6, 2, 4).
        assert!((cloud.positions[0] - dvec3(16.0, 2.0, 4.0)).length() < 1e-12);
        assert!((cloud.normals[0] - Vec3::X).length() < 1e-6);
        // (0, 2, 0) about x: (0, 0, 2).
        assert!((cloud.scanners[0].position - dvec3(10.0, 0.0, 2.0)).length() < 1e-12);
        assert_eq!(cloud.areas, [2.0]);
        assert_eq!(cloud.reflectance, [Vec3::splat(0.2)]);
        assert_eq!(cloud.emission, [Vec3::splat(3.0)]);
    }

    #[test]
    fn clouds_with_different_properties_are_joined() {
        let bare = PointCloud {
            positions: vec![dvec3(7.0, 8.0, 9.0)],
            ..PointCloud::default()
        };
        let mut cloud = PointCloud::default();
        append(&mut cloud, one_point());
        assert_eq!(cloud.areas, [0.5]);
        append(&mut cloud, bare);
        append(&mut cloud, one_point());
        assert_eq!(cloud.len(), 3);
        assert_eq!(cloud.normals, [Vec3::Z, Vec3::ZERO, Vec3::Z]);
        let reflectance = [0.2, DEFAULT_REFLECTANCE, 0.2].map(Vec3::splat);
        assert_eq!(cloud.reflectance, reflectance);
        assert_eq!(cloud.emission, [Vec3::ZERO; 3]);
        assert!(cloud.areas.is_empty());
        let ranges: Vec<_> = cloud.scanners.iter().map(|s| s.points.clone()).collect();
        assert_eq!(ranges, [0..1, 2..3]);
        assert_eq!(cloud.repairs.len(), 2);
    }
}
