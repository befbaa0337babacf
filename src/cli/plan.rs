//! `fmmgi-gpu plan`

use fmmgi_gpu::{Error, Plan, Result};

use super::Done;
use super::asked::Asked;
use super::terminal::{self, Terminal};

/// Tell how "solve" would go about it, why, and what time and memory that would take.
///
/// The inputs are read, and a thousand of their points looked at. Seconds and bytes are estimates, right
/// within a factor of 2 or so. What does not fit into memory fails, as "solve" would.
#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    asked: Asked,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Done> {
    let asked = &args.asked;
    let options = asked.options();
    let chosen = asked.open(options.method)?;
    terminal::stop_on_ctrl_c();
    let progress = Terminal::new(args.json, false);
    let mut scene = asked.load(&progress)?;
    scene.lights.extend(&asked.light);
    scene.sky = asked.sky.unwrap_or(scene.sky);
    let plan = Plan::new(&scene, &options, &chosen.backend()).map_err(|e| asked.about(e))?;
    progress.finish();
    let text = match args.json {
        true => serde_json::to_string_pretty(&plan)
            .map_err(|e| Error::Invalid(format!("the plan: {e}")))?,
        false => plan.to_string(),
    };
    super::print(&text)?;
    plan.check()?;
    Ok(Done::Well)
}
