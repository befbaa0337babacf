//! `fmmgi-gpu compare`

use std::path::PathBuf;

use fmmgi_gpu::compare::{compare_files, differences, read_pair};
use fmmgi_gpu::output::write_atomic;
use fmmgi_gpu::points::{Evidence, Thinning};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Error, IlluminationMap, Result, Scene, Surfels, render};

use super::values::{self, Size};
use super::{Done, outputs, picture};

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
    /// Write a picture of the relative differences in false colours: blue where A has less light than
    /// B, white where they agree, red where A has more
    #[arg(long, value_name = "OUT.png")]
    image: Option<PathBuf>,
    /// Relative difference that gets the darkest colours [default: that of the 99th percentile, rounded
    /// up]
    #[arg(long, value_name = "D", value_parser = values::tolerance, requires = "image")]
    scale: Option<f64>,
    /// Scene file whose camera takes the picture [default: one fitted to the points]
    #[arg(long, value_name = "SCENE.toml", requires = "image")]
    camera: Option<PathBuf>,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", value_parser = values::size, default_value = "1280x720")]
    size: Size,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Done> {
    if let Some(path) = &args.image {
        outputs::spare(&args.a, &[path])?;
        outputs::spare(&args.b, &[path])?;
    }
    let comparison = compare_files(&args.a, &args.b, &Silent)?;
    let text = if args.json {
        serde_json::to_string_pretty(&comparison).map_err(|e| Error::Invalid(e.to_string()))?
    } else {
        comparison.to_string()
    };
    super::print(&text)?;
    if let Some(path) = &args.image {
        let (png, scale) = paint(args)?;
        write_atomic(path, |writer| writer.write_all(&png))?;
        if !args.json {
            let percent = 100.0 * scale;
            super::print(&format!(
                "colours {percent}% less light is dark blue, as much is white, {percent}% more is dark red"
            ))?;
        }
    }
    Ok(Done::Well)
}

/// The bytes of a PNG file, and the difference that gets the darkest colours.
fn paint(args: &Args) -> Result<(Vec<u8>, f64)> {
    let (a, b) = read_pair(&args.a, &args.b, &Silent)?;
    let differences = differences(&a, &b);
    let scale = args.scale.unwrap_or_else(|| scale_of(&differences));
    let mut scene = Scene::load(&args.b, &SceneOptions::default(), &Silent)?;
    if let Some(path) = &args.camera {
        scene.camera = Scene::load(path, &SceneOptions::default(), &Silent)?.camera;
        if scene.camera.is_none() {
            return Err(Error::input(path, "has no camera"));
        }
    }
    let (evidence, thinning) = (Evidence::default(), Thinning::default());
    let prepared = Surfels::of_scan(&scene.cloud, &evidence, &thinning, &Silent)?;
    let places = prepared.places(&prepared.surfels).into_iter();
    let area = |place: Option<u32>| place.map_or(0.0, |k| prepared.surfels.areas[k as usize]);
    let value = |d: &f32| render::as_radiosity((f64::from(*d) / scale) as f32);
    let map = IlluminationMap {
        radius: places
            .map(|p| (area(p) / std::f32::consts::PI).sqrt())
            .collect(),
        radiosity: differences.iter().map(value).collect(),
        ..IlluminationMap::default()
    };
    let image = picture::take_image(&scene, &prepared.surfels, &map, args.size, &Silent)?;
    Ok((render::encode_false_colour(&image)?, scale))
}

/// The 99th percentile of the magnitudes, rounded up to 1, 2 or 5 times a power of ten.
fn scale_of(differences: &[f32]) -> f64 {
    let mut sizes: Vec<f32> = differences.iter().map(|d| d.abs()).collect();
    sizes.sort_unstable_by(f32::total_cmp);
    let largest = f64::from(sizes[(0.99 * (sizes.len() - 1) as f64).round() as usize]).max(1e-6);
    let power = 10f64.powf(largest.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    let enough = steps.into_iter().find(|&step| step >= largest);
    enough.unwrap_or(10.0 * power)
}
