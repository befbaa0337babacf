//! `fmmgi-gpu info`

use std::path::PathBuf;

use fmmgi_gpu::points::{Facing, Openness, Quality, Survey};
use fmmgi_gpu::scene::Source;
use fmmgi_gpu::{Backend, Options, Progress, Result, Scene, Transport};
use glam::{DVec3, Vec3};
use serde::Serialize;

use super::Done;
use super::reading::Reading;
use super::terminal::{self, Terminal};
use super::values;

/// Tell what is in scans and scene files, what is missing, and what "solve" would do about it.
///
/// Lengths are in the unit of the file. A file that cannot be read does not keep the others from
/// being told.
#[derive(clap::Args)]
pub struct Args {
    /// Scans and scene files (.toml)
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    #[command(flatten)]
    reading: Reading,
    /// Prepare the points as "solve" does, and tell how good they are as a surface; with the last file of a
    /// scene for all of it
    #[arg(long)]
    quality: bool,
    /// To which side the normals point, as for "solve"
    #[arg(long, value_name = "SIDE", value_parser = values::facing, default_value = "auto", requires = "quality")]
    normals: Facing,
    /// Print JSON: a list with an entry for each file, of those in a scene file too
    #[arg(long)]
    json: bool,
}

/// A file and what is in it.
#[derive(Serialize)]
struct Report {
    file: String,
    format: String,
    fields: Vec<String>,
    /// What of it was taken for what.
    taken: String,
    #[serde(flatten)]
    survey: Survey,
    /// Mended while the file was read.
    repairs: Vec<String>,
    /// What is missing, and what is done about it.
    notes: Vec<String>,
    /// What preparation made of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    quality: Option<Found>,
}

/// What preparation makes of the points of a scene, step by step.
#[derive(Serialize)]
struct Found {
    /// What was mended, merged and left out.
    steps: Vec<String>,
    #[serde(flatten)]
    quality: Quality,
    open: Option<Openness>,
}

pub fn run(args: &Args) -> Result<Done> {
    terminal::stop_on_ctrl_c();
    let progress = Terminal::new(args.json, false);
    let options = args.reading.options();
    let mut reports = Vec::new();
    let mut failure = None;
    for path in &args.inputs {
        let looked = Scene::load(path, &options, &progress).and_then(|mut scene| {
            let mut reports = look(&scene)?;
            if let Some(report) = reports.last_mut().filter(|_| args.quality) {
                report.quality = Some(found(&mut scene, &args.normals, &progress)?);
            }
            Ok(reports)
        });
        progress.finish();
        match looked {
            Ok(of_file) if args.json => reports.extend(of_file),
            Ok(of_file) => {
                for report in of_file {
                    super::print(&report.in_words())?;
                }
            }
            Err(error) => {
                // The last one is told by the caller.
                if let Some(earlier) = failure.replace(error) {
                    eprintln!("error: {earlier}");
                }
            }
        }
    }
    if args.json {
        let json = serde_json::to_string_pretty(&reports)
            .map_err(|e| fmmgi_gpu::Error::Invalid(format!("the report: {e}")))?;
        super::print(&json)?;
    }
    failure.map_or(Ok(Done::Well), Err)
}

/// All files of a scene.
fn look(scene: &Scene) -> Result<Vec<Report>> {
    let dark = scene.lights.is_empty() && scene.sky == Vec3::ZERO;
    let report = |(i, source): (usize, &Source)| {
        let survey = Survey::of(&scene.cloud, source.points.clone())?;
        let mut notes = match source.points.is_empty() {
            true => Vec::new(),
            false => survey.notes(),
        };
        if i + 1 == scene.sources.len() {
            notes.extend(scene.doubts()?);
        }
        if dark && survey.shining == 0 && i + 1 == scene.sources.len() {
            notes.push("nothing gives light: add --light or --sky".to_owned());
        }
        Ok(Report {
            file: source.path.display().to_string(),
            format: source.format.clone(),
            fields: source.fields.clone(),
            taken: source.taken.clone(),
            survey,
            repairs: match i {
                0 => scene.cloud.repairs.clone(),
                _ => Vec::new(),
            },
            notes,
            quality: None,
        })
    };
    scene.sources.iter().enumerate().map(report).collect()
}

/// Prepares a scene as "solve" does.
fn found(scene: &mut Scene, facing: &Facing, progress: &dyn Progress) -> Result<Found> {
    let options = Options {
        facing: *facing,
        ..Options::default()
    };
    let transport = Transport::new(scene, &options, Backend::Cpu, progress)?;
    Ok(Found {
        steps: transport.repairs().to_vec(),
        quality: transport.quality().cloned().unwrap_or_default(),
        open: transport.openness(),
    })
}

impl Found {
    fn lines(&self) -> Vec<String> {
        let mut lines = self.steps.clone();
        lines.extend(self.quality.lines());
        lines.extend(self.open.map(|open| open.line()));
        lines
    }
}

impl Report {
    fn in_words(&self) -> String {
        let survey = &self.survey;
        let mut lines = vec![
            self.file.clone(),
            format!("  format    {}", self.format),
            format!("  points    {}", survey.points),
        ];
        if !self.fields.is_empty() {
            lines.push(format!("  fields    {}", self.fields.join(" ")));
        }
        if !self.taken.is_empty() {
            lines.push(format!("  taken     {}", self.taken));
        }
        let bounds = survey.bounds.map(|ends| ends.map(DVec3::from));
        let [min, max] = bounds.unwrap_or_default();
        let digits = decimals((max - min).max_element());
        let place = |p: DVec3| format!("{:.digits$} {:.digits$} {:.digits$}", p.x, p.y, p.z);
        if bounds.is_some() {
            lines.push(format!("  box       {} .. {}", place(min), place(max)));
            lines.push(format!("  size      {}", place(max - min)));
        }
        if let Some(spacing) = survey.spacing {
            lines.push(format!(
                "  spacing   {spacing:.3e}, to the nearest point (median)"
            ));
        }
        for &scanner in &survey.scanners {
            lines.push(format!("  scanner   {}", place(scanner.into())));
        }
        let quality = self.quality.as_ref().map(Found::lines).unwrap_or_default();
        for (word, texts) in [
            ("repaired", &self.repairs),
            ("note", &self.notes),
            ("quality", &quality),
        ] {
            lines.extend(texts.iter().map(|text| format!("  {word:<9} {text}")));
        }
        lines.join("\n")
    }
}

/// Digits behind the point that resolve a ten-thousandth of a length.
fn decimals(length: f64) -> usize {
    let whole = length.max(f64::MIN_POSITIVE).log10().floor();
    (4.0 - whole).clamp(0.0, 12.0) as usize
}
