//! Checks of the files to be written, made before the work.

use std::fs;
use std::path::{Path, PathBuf};

use fmmgi_gpu::output::{Format, check_writable};
use fmmgi_gpu::{Error, Result};

/// The names of all inputs, as one for messages.
pub fn names(inputs: &[PathBuf]) -> String {
    let names: Vec<_> = inputs.iter().map(|input| input.to_string_lossy()).collect();
    names.join(", ")
}

/// Fails if an output is an input, two outputs are the same file, or one cannot be written.
pub fn check(inputs: &[PathBuf], outputs: &[&Path]) -> Result<()> {
    for input in inputs {
        spare(input, outputs)?;
    }
    for (i, output) in outputs.iter().enumerate() {
        if let Some(other) = outputs[..i].iter().find(|other| same_file(output, other)) {
            return Err(Error::Usage(format!(
                "{} and {} are the same file: give each output its own name",
                other.display(),
                output.display()
            )));
        }
        check_writable(output)?;
    }
    Ok(())
}

/// Fails if the ending of an output that is PLY stands for another format.
pub fn check_ply(output: &Path) -> Result<()> {
    match Format::of(output) {
        Ok(Format::Ply) => Ok(()),
        _ => Err(Error::Usage(format!(
            "{}: painted points are written as PLY, so the name must end with .ply",
            output.display()
        ))),
    }
}

/// Fails if the ending of a picture stands for another format.
pub fn check_png(output: &Path) -> Result<()> {
    let is_device = output.starts_with("/dev") || is_device(output);
    let is_png = output
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("png"));
    match is_png || is_device {
        true => Ok(()),
        false => Err(Error::Usage(format!(
            "{}: pictures are written as PNG, so the name must end with .png",
            output.display()
        ))),
    }
}

/// Fails if an output is a file that is read.
pub fn spare(input: &Path, outputs: &[&Path]) -> Result<()> {
    match outputs.iter().find(|output| same_file(output, input)) {
        None => Ok(()),
        Some(output) => Err(Error::Usage(format!(
            "{} is the input, which would be overwritten: give the output another name",
            output.display()
        ))),
    }
}

/// Whether a path leads to a device or a pipe.
fn is_device(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir())
}

/// Whether two paths lead to one file. Devices can take several outputs.
fn same_file(a: &Path, b: &Path) -> bool {
    match (resolved(a), resolved(b)) {
        (Some(a), Some(b)) => a == b && !is_device(&a),
        _ => false,
    }
}

/// The path without links and dots; the file itself need not be there yet.
fn resolved(path: &Path) -> Option<PathBuf> {
    fs::canonicalize(path).ok().or_else(|| {
        let parent = match path.parent()? {
            parent if parent == Path::new("") => Path::new("."),
            parent => parent,
        };
        Some(fs::canonicalize(parent).ok()?.join(path.file_name()?))
    })
}
