//! Results to files. A file appears under its name only when it is complete.

mod atomic;
mod ply;

use std::path::Path;

pub use atomic::{check_writable, write_atomic};
pub use ply::{needs_double, write_painted, write_ply};

use crate::error::Result;
use crate::illuminate::stats::Stats;

/// Writes the statistics of a solve as JSON.
pub fn write_stats(path: &Path, stats: &Stats) -> Result<()> {
    write_atomic(path, |writer| {
        serde_json::to_writer_pretty(&mut *writer, stats)?;
        writeln!(writer)
    })
}
