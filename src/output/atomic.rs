//! Files that appear under their names only when they are complete.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::error::{Error, Result};

/// Writes a file through a temporary one in the same directory, which takes its name at the end.
/// What is at `path` before stays as it is until then, and stays if `write` fails.
///
/// Devices and pipes (such as `/dev/stdout`) are written to as they are.
///
/// # Errors
/// [`Error::Io`] if the directory is missing or cannot be written, or the disk is full.
pub fn write_atomic(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<()> {
    match Target::of(path)? {
        Target::Stream => OpenOptions::new()
            .write(true)
            .open(path)
            .and_then(|stream| buffered(stream, write)),
        Target::File(target) => whole(&target, |file| buffered(file, write)),
    }
    .map_err(|e| failed(path, e))
}

/// The error of writing to a file, or that of an input from which it is written.
fn failed(path: &Path, error: io::Error) -> Error {
    match error.downcast::<Error>() {
        Ok(error) => error,
        Err(error) => Error::io(path, "cannot be written", error),
    }
}

/// As [`write_atomic`], for what has to go back in its file, and so only to files.
pub fn write_atomic_file(path: &Path, write: impl FnOnce(&File) -> io::Result<()>) -> Result<()> {
    match Target::of(path)? {
        Target::Stream => Err(Error::input(
            path,
            "is no regular file, which this format needs",
        )),
        Target::File(target) => whole(&target, write).map_err(|e| failed(path, e)),
    }
}

fn whole(target: &Path, write: impl FnOnce(&File) -> io::Result<()>) -> io::Result<()> {
    let file = temporary(target)?;
    write(file.as_file())?;
    file.persist(target)?;
    Ok(())
}

/// Fails if [`write_atomic`] could not write to `path`, so that it is known before the work.
pub fn check_writable(path: &Path) -> Result<()> {
    if let Target::File(target) = Target::of(path)? {
        temporary(&target).map_err(|e| Error::io(path, "cannot be written", e))?;
    }
    Ok(())
}

enum Target {
    File(PathBuf),
    Stream,
}

impl Target {
    fn of(path: &Path) -> Result<Self> {
        match fs::metadata(path) {
            Ok(metadata) if metadata.is_dir() => {
                Err(Error::input(path, "is a directory; a file name is needed"))
            }
            Ok(metadata) if !metadata.is_file() => Ok(Target::Stream),
            // A link to a file stays a link.
            Ok(_) => fs::canonicalize(path)
                .map(Target::File)
                .map_err(|e| Error::io(path, "cannot be written", e)),
            Err(_) if path.file_name().is_none() => Err(Error::input(path, "is not a file name")),
            Err(_) => Ok(Target::File(path.to_owned())),
        }
    }
}

/// What the names of temporary files begin with.
const TEMPORARY: &str = ".fmmgi-";

/// Removes the temporary files that writers left in a folder as they were killed.
pub(crate) fn remove_temporary(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(TEMPORARY) {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

fn temporary(target: &Path) -> io::Result<NamedTempFile> {
    let directory = match target.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY);
    // The permissions of an ordinary new file, not those of a secret.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(directory).map_err(|e| {
        // The error names the temporary file, which means nothing to the user.
        match e.kind() {
            io::ErrorKind::NotFound => {
                io::Error::new(e.kind(), format!("no directory {}", directory.display()))
            }
            io::ErrorKind::PermissionDenied => io::Error::new(
                e.kind(),
                format!("no permission to write in {}", directory.display()),
            ),
            kind => io::Error::new(kind, format!("in {}: {kind}", directory.display())),
        }
    })
}

fn buffered(
    target: impl Write,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut writer = BufWriter::with_capacity(1 << 16, target);
    write(&mut writer)?;
    writer.flush()
}
