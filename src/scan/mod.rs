//! Scan files to point clouds.

pub mod ply;

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};
use crate::points::PointCloud;
use crate::progress::Progress;

/// Reads the points of a scan file, whose format is told by its content.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Input`] if it is no scan, is damaged, or has
/// no points, [`Error::TooLarge`] above 2³² - 1 points.
pub fn read(path: &Path, progress: &dyn Progress) -> Result<PointCloud> {
    let mut magic = Vec::new();
    open(path)?
        .take(4)
        .read_to_end(&mut magic)
        .map_err(|e| Error::io(path, "cannot be read", e))?;
    match magic[..] {
        [] => Err(Error::input(path, "the file is empty")),
        [b'p', b'l', b'y', end] if end.is_ascii_whitespace() => ply::read(path, progress),
        _ => Err(Error::input(
            path,
            "not a scan in a format that is understood: PLY (ascii or binary), \
             which begins with a line \"ply\"",
        )),
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
