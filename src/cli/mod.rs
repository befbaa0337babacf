//! The command line.

mod adapters;
mod asked;
mod backend;
mod chart;
mod compare;
mod info;
mod outputs;
mod picture;
mod plan;
mod reading;
mod relight;
mod solve;
mod terminal;
mod values;
mod visible;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use fmmgi_gpu::{Error, Result};

/// Illumination maps of point clouds: diffuse light after all bounces, with occlusion.
#[derive(Parser)]
#[command(
    version,
    after_help = "Exit codes: 0 done; 1 failed; 2 wrong usage; 3 the backend asked \
    for is not there; 4 done, but not converged, or the tolerance not met (the result is written); 130 interrupted."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Solve(solve::Args),
    Relight(relight::Args),
    Visible(visible::Args),
    Plan(plan::Args),
    Info(info::Args),
    Compare(compare::Args),
    Chart(chart::Args),
    Adapters(adapters::Args),
}

/// How a command that did not fail ended.
enum Done {
    Well,
    NotConverged,
}

/// Runs the command that the arguments of the process ask for.
pub fn run() -> ExitCode {
    let result: Result<Done> = match Cli::parse().command {
        Command::Solve(args) => solve::run(&args),
        Command::Relight(args) => relight::run(&args),
        Command::Visible(args) => visible::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Chart(args) => chart::run(&args),
        Command::Adapters(_) => adapters::run(),
    };
    match result {
        Ok(Done::Well) => ExitCode::SUCCESS,
        Ok(Done::NotConverged) => ExitCode::from(4),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Prints to standard output; a reader that has gone away is no error.
fn print(text: &str) -> Result<()> {
    match writeln!(io::stdout(), "{text}") {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => {
            Err(Error::io("standard output", "cannot be written", e))
        }
        _ => Ok(()),
    }
}
