//! Results to files. A file appears under its name only when it is complete.

mod atomic;
mod csv;
mod las;
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

use crate::error::{Error, Result};
use crate::illuminate::stats::Stats;
use crate::map::IlluminationMap;
use crate::points::PointCloud;

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
