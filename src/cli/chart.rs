//! `fmmgi-gpu chart`

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use fmmgi_gpu::chart::{Case, Charted, FILES, Machine, Measured, Plan, measure};
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice, OpenDevice};
use fmmgi_gpu::{Error, Progress, Result};
use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::terminal::{self, Terminal};
use super::{Done, values};

/// Scenes of a chart when none is named.
const SCENES: [&str; 3] = [
    "scenes/cornell.toml",
    "scenes/organic.toml",
    "scenes/cave.toml",
];

/// Measure every method on every backend, and draw speed against accuracy.
///
/// Tables (CSV, JSON) and pictures (SVG, PNG) come into a folder. What is finished stays there: the same
/// command goes on where it was stopped, on the same machine with the same version.
#[derive(clap::Args)]
pub struct Args {
    /// Scene files [default: cornell, organic and cave of the folder "scenes"]
    scenes: Vec<PathBuf>,
    /// Folder for all that comes out
    #[arg(short, long, value_name = "DIR", default_value = "chart")]
    output: PathBuf,
    /// Numbers of points [default: 2000,10000,50000, with --full up to 2000000]
    #[arg(long, value_name = "N,..", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(2..))]
    points: Vec<u32>,
    /// Tolerances [default: 0.1,0.03,0.01, with --full six down to 0.005]
    #[arg(long, value_name = "T,..", value_delimiter = ',', value_parser = values::tolerance)]
    tolerances: Vec<f64>,
    /// Leave out runs that are expected to take more seconds [default: 4, with --full 1000]
    #[arg(long, value_name = "S", value_parser = values::positive)]
    limit: Option<f64>,
    /// Hours instead of minutes: more sizes, tolerances and orders
    #[arg(long)]
    full: bool,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
    /// Run one case of a chart, and write its light to a file: what a chart calls itself with
    #[arg(long, hide = true, value_name = "CASE", requires = "light")]
    one: Option<String>,
    #[arg(long, hide = true, value_name = "FILE")]
    light: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<Done> {
    if let (Some(case), Some(light)) = (&args.one, &args.light) {
        return one(case, light);
    }
    let plan = args.plan();
    for scene in &plan.scenes {
        if !scene.is_file() {
            return Err(Error::Usage(format!(
                "{}: no such scene file; name one, or run this in a copy of the repository",
                scene.display()
            )));
        }
    }
    terminal::stop_on_ctrl_c();
    let progress = Terminal::new(args.quiet, false);
    let gpu = match adapter::open(&AdapterChoice::Any) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            progress.note(&format!("the CPU alone is charted: {error}"));
            None
        }
    };
    let machine = Machine::this(gpu.as_ref());
    progress.note(&machine.caption());
    let solver = |case: &Case| in_a_process_of_its_own(case, &progress);
    let charted = match plan.run(&args.output, &machine, gpu.as_ref(), &solver, &progress) {
        Err(Error::Interrupted) => {
            progress.finish();
            progress.note(&format!(
                "what is finished is kept in {}: the same command goes on there",
                args.output.display()
            ));
            return Err(Error::Interrupted);
        }
        other => other?,
    };
    charted.write(&args.output)?;
    progress.finish();
    if !args.quiet {
        super::print(&summary(&charted, &args.output))?;
    }
    Ok(Done::Well)
}

impl Args {
    fn plan(&self) -> Plan {
        let scenes = match self.scenes.is_empty() {
            true => SCENES.map(PathBuf::from).to_vec(),
            false => self.scenes.clone(),
        };
        let mut plan = match self.full {
            true => Plan::full(scenes),
            false => Plan::brief(scenes),
        };
        if !self.points.is_empty() {
            plan.points = self.points.iter().map(|&n| n as usize).collect();
            plan.points.sort_unstable();
            plan.points.dedup();
        }
        if !self.tolerances.is_empty() {
            plan.tolerances = self.tolerances.clone();
            plan.tolerances.sort_by(|a, b| b.total_cmp(a));
            plan.tolerances.dedup();
        }
        plan.limit = self.limit.unwrap_or(plan.limit);
        plan
    }
}

/// What a process tells of its case.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Told {
    Measured(Measured),
    /// It does not fit.
    Refused(String),
}

fn one(case: &str, light: &Path) -> Result<Done> {
    let case: Case = serde_json::from_str(case)
        .map_err(|e| Error::Usage(format!("--one takes a case of a chart: {e}")))?;
    let gpu: Option<OpenDevice> = match case.gpu {
        true => Some(adapter::open(&AdapterChoice::Any)?),
        false => None,
    };
    let told = match measure(&case, gpu.as_ref()) {
        Ok((measured, irradiance)) => {
            let bytes: &[u8] = bytemuck::cast_slice(&irradiance);
            fs::write(light, bytes).map_err(|e| Error::io(light, "cannot be written", e))?;
            Told::Measured(measured)
        }
        Err(Error::TooLarge(why)) => Told::Refused(why),
        Err(error) => return Err(error.about(&case.scene)),
    };
    let text = serde_json::to_string(&told).expect("numbers and words");
    super::print(&text)?;
    Ok(Done::Well)
}

/// Memory can be told of a whole process only.
fn in_a_process_of_its_own(case: &Case, progress: &dyn Progress) -> Result<(Measured, Vec<Vec3>)> {
    let failed = |what: String| Error::Invalid(format!("{}: {what}", case.describe()));
    let io = |e: std::io::Error| failed(format!("no process for it: {e}"));
    let light = tempfile::NamedTempFile::new().map_err(io)?;
    let text = serde_json::to_string(case).map_err(|e| failed(e.to_string()))?;
    let program = std::env::current_exe().map_err(io)?;
    let output = Command::new(program)
        .args(["chart", "--one", &text, "--light"])
        .arg(light.path())
        .stdin(Stdio::null())
        .output()
        .map_err(io)?;
    // Ctrl-C has gone to both.
    progress.check()?;
    if !output.status.success() {
        let words = String::from_utf8_lossy(&output.stderr);
        return Err(failed(match words.trim() {
            "" => format!("its process ended with {}", output.status),
            words => words.trim_start_matches("error: ").to_owned(),
        }));
    }
    match serde_json::from_slice(&output.stdout).map_err(|e| failed(e.to_string()))? {
        Told::Refused(why) => Err(Error::TooLarge(why)),
        Told::Measured(measured) => {
            let bytes = fs::read(light.path()).map_err(io)?;
            Ok((measured, bytemuck::pod_collect_to_vec(&bytes)))
        }
    }
}

/// What is seen at a glance.
fn summary(charted: &Charted, folder: &Path) -> String {
    let mut lines = vec![charted.machine.caption()];
    for growth in charted.growth() {
        if let (Some(time), Some((n, ..))) = (growth.time_exponent, growth.points.last()) {
            lines.push(format!(
                "{}: {} ({}) grows in time as N^{time:.2}{} up to {n} points",
                growth.scene,
                growth.curve,
                growth.setting,
                growth
                    .memory_exponent
                    .map_or(String::new(), |m| format!(", in memory as N^{m:.2}")),
            ));
        }
    }
    for choice in charted.choices() {
        lines.push(format!(
            "{}: {:.2} times the time of the best: {}",
            choice.case.describe(),
            choice.ratio,
            choice.best
        ));
    }
    if !charted.left_out.is_empty() {
        lines.push(format!(
            "{} runs left out, see chart.json",
            charted.left_out.len()
        ));
    }
    lines.push(format!("{}: {}", folder.display(), FILES.join(", ")));
    lines.join("\n")
}
