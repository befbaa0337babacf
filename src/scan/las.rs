//! LAS files.

use std::path::Path;

use super::Scan;
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Reads a LAS file.
pub fn read(path: &Path, _progress: &dyn Progress) -> Result<Scan> {
    Err(Error::input(path, "LAS files are not understood yet"))
}
