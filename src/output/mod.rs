//! Results to files. A file appears under its name only when it is complete.

mod atomic;
mod columns;
mod csv;
mod las;
mod las_copy;
mod npy;
mod ply;
mod rows;

use std::path::Path;

pub(crate) use atomic::remove_temporary;
pub use atomic::{check_writable, write_atomic, write_atomic_file};
pub use csv::write_csv;
use glam::DVec3;
pub use las::write_las;
pub use npy::write_npy;
pub use ply::{needs_double, write_painted, write_ply};
use rayon::prelude::*;
pub use rows::Paint;

use crate::error::{Error, Result};
use crate::illuminate::stats::Stats;
use crate::map::IlluminationMap;
use crate::points::PointCloud;
use crate::progress::Progress;
use crate::scene::Scene;
use columns::Columns;
use las_copy::LasCopy;
use rows::Lit;

/// A kind of file for points with their light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Ply,
    Las,
    /// LAS, compressed.
    Laz,
    Csv,
    Npy,
}

impl Format {
    /// The format that the ending of a file's name stands for. Devices and pipes without an ending get PLY.
    ///
    /// # Errors
    /// [`Error::Usage`] for other endings, and for files without one.
    pub fn of(path: &Path) -> Result<Format> {
        // `/dev/stdout` may lead to a file.
        let is_pipe = || path.metadata().is_ok_and(|m| !m.is_file() && !m.is_dir());
        let is_device = || path.starts_with("/dev") || is_pipe();
        let ending = path.extension().unwrap_or_default();
        match ending.to_ascii_lowercase().to_str() {
            Some("") if is_device() => Ok(Format::Ply),
            Some("ply") => Ok(Format::Ply),
            Some("las") => Ok(Format::Las),
            Some("laz") => Ok(Format::Laz),
            Some("csv") => Ok(Format::Csv),
            Some("npy") => Ok(Format::Npy),
            _ => Err(Error::Usage(format!(
                "{}: points can be written to files that end with .ply, .laz, .las, .csv or .npy",
                path.display()
            ))),
        }
    }
}

/// Writes all points of a cloud with their light, in the cloud's order and at the precision of its
/// coordinates, in the format that the ending of the name stands for.
///
/// # Errors
/// [`Error::Usage`] for an ending that stands for none, [`Error::Invalid`] if cloud and map differ
/// in length, [`Error::Io`] if writing fails.
pub fn write(path: &Path, cloud: &PointCloud, map: &IlluminationMap) -> Result<()> {
    match Format::of(path)? {
        Format::Ply => write_ply(path, cloud, map),
        Format::Las => write_las(path, cloud, map, false),
        Format::Laz => write_las(path, cloud, map, true),
        Format::Csv => write_csv(path, cloud, map),
        Format::Npy => write_npy(path, cloud, map),
    }
}

/// Writes the lit points of a scene as [`write`] does, with all that the files they are from say of them: these
/// are read once more, block by block.
///
/// LAS and LAZ inputs to LAS or LAZ keep their point format, all fields and all extra bytes; the light comes in
/// extra dimensions. PLY, text, LAS and LAZ keep their columns in PLY, CSV, LAS and LAZ; what the output has
/// under the same name is kept as `original_NAME`, and older light is replaced. `paint` says what the colours
/// are; `None` keeps those of the input in LAS and LAZ, and paints the lit ones in other formats. What is left
/// out goes to `progress` as notes.
///
/// # Errors
/// As [`write`]; also [`Error::Input`] and [`Error::Io`] if a file that was read before has changed since.
pub fn write_scene(
    path: &Path,
    scene: &Scene,
    map: &IlluminationMap,
    paint: Option<Paint>,
    progress: &dyn Progress,
) -> Result<()> {
    let format = Format::of(path)?;
    let is_las = matches!(format, Format::Las | Format::Laz);
    let paint = paint.unwrap_or(if is_las { Paint::Keep } else { Paint::Lit });
    let lit = Lit::new(&scene.cloud, map, paint)?;
    let note = |line: String| progress.note(&line);
    if format == Format::Npy {
        note(format!(
            "{}: has the light alone, and nothing else of the input",
            path.display()
        ));
        return npy::write_lit(path, lit);
    }
    let compressed = format == Format::Laz;
    if is_las && let Some(copy) = LasCopy::of_scene(lit, scene, &note) {
        return copy.write(path, compressed);
    }
    let columns = Columns::of_scene(lit, scene, format, &note);
    match format {
        Format::Ply => ply::write_columns(path, columns),
        Format::Csv => csv::write_columns(path, columns),
        _ => las::write_columns(path, columns, compressed),
    }
}

/// The box around the positions that are finite; from infinity to minus infinity if none is.
fn finite_box(positions: &[DVec3]) -> (DVec3, DVec3) {
    let empty = || (DVec3::INFINITY, DVec3::NEG_INFINITY);
    positions
        .par_iter()
        .filter(|p| p.is_finite())
        .fold(empty, |(min, max), &p| (min.min(p), max.max(p)))
        .reduce(empty, |a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Writes the statistics of a solve as JSON.
pub fn write_stats(path: &Path, stats: &Stats) -> Result<()> {
    write_atomic(path, |writer| {
        serde_json::to_writer_pretty(&mut *writer, stats)?;
        writeln!(writer)
    })
}
