//! `fmmgi-gpu relight`

use fmmgi_gpu::{Error, Result};

use super::{Done, solve};

/// Compute the light of other lamps with a kept operator: "solve" with --operator, where lights on
/// the command line hang instead of those of the scene.
///
/// Only lights, sky, emission and reflectance may differ from what the operator was made with.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    solve: solve::Args,
}

pub fn run(args: &Args) -> Result<Done> {
    let args = &args.solve;
    if args.operator.is_none() {
        return Err(Error::Usage(
            "relight needs --operator FILE, which solve --save-operator FILE makes".into(),
        ));
    }
    solve::run_with(args, |scene| {
        if !args.asked.light.is_empty() {
            scene.lights.clone_from(&args.asked.light);
        }
    })
}
