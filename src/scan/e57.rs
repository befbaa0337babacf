//! E57 files.

use std::path::Path;

use super::Scan;
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Reads a E57 file.
pub fn read(path: &Path, _progress: &dyn Progress) -> Result<Scan> {
    Err(Error::input(path, "E57 files are not understood yet"))
}
