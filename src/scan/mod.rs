//! Scan files to point clouds.

mod e57;
mod las;
pub mod ply;

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};
use crate::points::PointCloud;
use crate::progress::Progress;

/// A file of points, read.
#[derive(Clone, Debug, Default)]
pub struct Scan {
    /// What kind of file it is, for example "PCD, binary_compressed".
    pub format: String,
    /// What the file says of each point, in the names of the file.
    pub fields: Vec<String>,
    /// Whether the points were made on triangles.
    pub sampled: bool,
    pub cloud: PointCloud,
}

/// How files that have triangles are read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeshOptions {
    /// Takes the faces of a PLY file as the surface, and samples them; otherwise its vertices are
    /// the points. (An OBJ file with faces is always sampled.)
    pub faces: bool,
    /// Number of samples; `None` takes that of the spacing, or 20000.
    pub points: Option<usize>,
    /// Mean distance of samples: each stands for its square, where `points` is `None`.
    pub spacing: Option<f64>,
    /// Moves the samples within their strata.
    pub seed: u64,
}

/// The formats that are understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ply,
    Las,
    E57,
}

/// Reads the points of a file whose format is told by its content, with the default options for
/// meshes. See [`Scan::read`].
pub fn read(path: &Path, progress: &dyn Progress) -> Result<PointCloud> {
    Ok(Scan::read(path, &MeshOptions::default(), progress)?.cloud)
}

impl Scan {
    /// Reads a file of points, or of triangles, on which points are made.
    ///
    /// The format is told by the content, and by the ending where the content alone does not tell.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read, [`Error::Input`] if it is no scan, is damaged, or
    /// has no points, [`Error::TooLarge`] above 2³² - 1 points.
    pub fn read(path: &Path, _mesh: &MeshOptions, progress: &dyn Progress) -> Result<Scan> {
        match Format::of(path)? {
            Format::Ply => Ok(Scan {
                cloud: ply::read(path, progress)?,
                ..Scan::default()
            }),
            Format::Las => las::read(path, progress),
            Format::E57 => e57::read(path, progress),
        }
    }
}

/// Bytes at the start of a file that tell its format.
const HEAD: u64 = 4096;

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let mut head = Vec::new();
        open(path)?
            .take(HEAD)
            .read_to_end(&mut head)
            .map_err(|e| Error::io(path, "cannot be read", e))?;
        match head[..] {
            [] => Err(Error::input(path, "the file is empty")),
            [b'p', b'l', b'y', end, ..] if end.is_ascii_whitespace() => Ok(Format::Ply),
            _ if head.starts_with(b"LASF") => Ok(Format::Las),
            _ if head.starts_with(b"ASTM-E57") => Ok(Format::E57),
            _ => Err(Error::input(
                path,
                "not a scan in a format that is understood: PLY, LAS, LAZ, E57",
            )),
        }
    }
}

/// Opens a regular file; a pipe or a device could keep its reader waiting for ever.
pub(crate) fn open(path: &Path) -> Result<File> {
    let failed = |e| Error::io(path, "cannot be opened", e);
    let metadata = fs::metadata(path).map_err(failed)?;
    if metadata.is_dir() {
        return Err(Error::input(path, "is a directory, not a file"));
    }
    if !metadata.is_file() {
        return Err(Error::input(
            path,
            "not a regular file (pipes and devices cannot be read; save the data to a file first)",
        ));
    }
    File::open(path).map_err(failed)
}
