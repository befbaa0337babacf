//! `fmmgi-gpu compare`

use std::path::PathBuf;

use fmmgi_gpu::compare::compare_files;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Error, Result};

use super::Done;

/// Compare the irradiance in two outputs of "solve" for the same points.
///
/// The relative error of a point is |a - b| / max(|b|, 0.01 mean |b|), with B as the reference.
/// Printed are the relative L2 norm of all errors; median, 95th and 99th percentile and maximum
/// of the points' errors; and the bias, sum(a) / sum(b) - 1.
#[derive(clap::Args)]
pub struct Args {
    /// The map to be judged
    a: PathBuf,
    /// The reference
    b: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Done> {
    let comparison = compare_files(&args.a, &args.b, &Silent)?;
    let text = if args.json {
        serde_json::to_string_pretty(&comparison).map_err(|e| Error::Invalid(e.to_string()))?
    } else {
        comparison.to_string()
    };
    super::print(&text)?;
    Ok(Done::Well)
}
