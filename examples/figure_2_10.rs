//! Figure 2.10 of Goradia's report: its multipole method beside the direct solution of the radiosity
//! equation and, which the report does not show, their difference times 10, at one exposure.
//!
//! ```sh
//! cargo run --release --example figure_2_10 -- figure.png 15000 scenes/cornell.toml
//! ```

use std::path::PathBuf;

use fmmgi_gpu::compare::compare;
use fmmgi_gpu::glam::Vec3;
use fmmgi_gpu::output::write_atomic;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::render::{self, Image};
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{
    Backend, Error, Illumination, IlluminationMap, Method, Options, Progress, Result, Scene,
    illuminate,
};

/// Factor of the difference.
const TIMES: f32 = 10.0;
/// Pixels along each side of the three pictures.
const SIZE: u32 = 480;

/// Notes on the terminal.
struct Notes;

impl Progress for Notes {
    fn note(&self, line: &str) {
        println!("{line}");
    }
}

fn main() -> Result<()> {
    let mut args = std::env::args().skip(1);
    let output = PathBuf::from(args.next().unwrap_or("figure_2_10.png".into()));
    let points = args.next().map_or(Ok(15_000), |n| n.parse());
    let points = points.map_err(|e| Error::Usage(format!("number of points: {e}")))?;
    let input = PathBuf::from(args.next().unwrap_or("scenes/cornell.toml".into()));
    let options = SceneOptions {
        points: Some(points),
        ..SceneOptions::default()
    };
    let scene = Scene::load(&input, &options, &Silent)?;

    let classic = solve(&scene, Method::Classic)?;
    let direct = solve(&scene, Method::Direct)?;
    println!(
        "{}",
        compare(&classic.map.irradiance, &direct.map.irradiance)?
    );

    let (a, b) = (&classic.map.radiosity, &direct.map.radiosity);
    let off = |(a, b): (&Vec3, &Vec3)| TIMES * (*a - *b).abs();
    let difference = IlluminationMap {
        radiosity: a.iter().zip(b).map(off).collect(),
        ..direct.map.clone()
    };
    let pictures = [&classic.map, &direct.map, &difference].map(|map| picture(&scene, map));
    let [classic, direct, difference] = pictures;
    let image = side_by_side(&[classic?, direct?, difference?]);
    let png = render::encode_png(&image, render::tone::exposure(b))?;
    write_atomic(&output, |writer| writer.write_all(&png))?;
    println!("{}", output.display());
    Ok(())
}

fn solve(scene: &Scene, method: Method) -> Result<Illumination> {
    let options = Options {
        method,
        ..Options::default()
    };
    let lit = illuminate(scene, &options, Backend::Cpu, &Notes)?;
    let stats = &lit.stats;
    let s = &stats.seconds;
    println!(
        "{method:?}: {} points, {} iterations, residual {:.1e}; visibility {:.1} s, links {:.1} s, \
         solve {:.1} s",
        stats.points, stats.iterations, stats.residual, s.visibility, s.links, s.solve
    );
    for (what, count) in &stats.links {
        println!("  {count:>12} {what}");
    }
    Ok(lit)
}

fn picture(scene: &Scene, map: &IlluminationMap) -> Result<Image> {
    let camera = scene
        .camera
        .ok_or_else(|| Error::Usage("the scene has no camera".into()))?;
    render::picture(&scene.cloud, map, &camera, SIZE, SIZE, &Silent)
}

fn side_by_side(images: &[Image]) -> Image {
    let mut all = Image {
        width: images.iter().map(|image| image.width).sum(),
        height: SIZE,
        radiosity: Vec::new(),
        coverage: Vec::new(),
    };
    for row in 0..SIZE as usize {
        for image in images {
            let pixels = row * image.width as usize..(row + 1) * image.width as usize;
            all.radiosity.extend(&image.radiosity[pixels.clone()]);
            all.coverage.extend(&image.coverage[pixels]);
        }
    }
    all
}
