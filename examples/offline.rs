//! Lights a scene or a scan and writes its illumination map: the library in a few lines.
//!
//! ```sh
//! cargo run --release --example offline -- scenes/cornell.toml lit.ply
//! ```

use std::path::PathBuf;

use fmmgi_gpu::glam::Vec3;
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Backend, Options, Result, Scene, illuminate, output};

fn main() -> Result<()> {
    let mut args = std::env::args_os().skip(1).map(PathBuf::from);
    let input = args.next().unwrap_or("scenes/cornell.toml".into());
    let output = args.next().unwrap_or("lit.ply".into());

    let mut scene = Scene::load(&input, &SceneOptions::default(), &Silent)?;
    if input.extension().is_some_and(|e| e == "ply") {
        // A scan brings no lights along.
        scene.sky = Vec3::ONE;
    }

    // A renderer hands over the device that it has; this program opens one if there is a GPU.
    let gpu = adapter::open(&AdapterChoice::Auto);
    let backend = match &gpu {
        Ok(gpu) => Backend::Gpu {
            device: &gpu.device,
            queue: &gpu.queue,
            adapter: &gpu.info.name,
        },
        Err(_) => Backend::Cpu,
    };

    let lit = illuminate(&scene, &Options::default(), backend, &Silent)?;
    output::write_ply(&output, &scene.cloud, &lit.map)?;

    let stats = &lit.stats;
    println!(
        "{} points on the {} in {} iterations, residual {:.1e}: {}",
        stats.points,
        stats.backend,
        stats.iterations,
        stats.residual,
        output.display()
    );
    Ok(())
}
