//! A lamp that moves through a room, frame by frame: the transport is found once, and what another
//! place of the lamp needs is added when it comes.
//!
//! ```sh
//! cargo run --release --example relight -- scenes/two_rooms.toml
//! ```

use std::path::PathBuf;
use std::time::Instant;

use fmmgi_gpu::glam::{Vec3, dvec3};
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::{Backend, Method, Options, Result, Scene, Transport};

const FRAMES: u32 = 24;

fn main() -> Result<()> {
    let input = std::env::args_os().nth(1).map(PathBuf::from);
    let input = input.unwrap_or("scenes/two_rooms.toml".into());
    let mut scene = Scene::load(&input, &SceneOptions::default(), &Silent)?;
    scene.cloud.emission.fill(Vec3::ZERO);

    // A renderer hands over the device that it has; the links stay there from frame to frame.
    let gpu = adapter::open(&AdapterChoice::Auto);
    let backend = match &gpu {
        Ok(gpu) => Backend::Gpu {
            device: &gpu.device,
            queue: &gpu.queue,
            adapter: &gpu.info.name,
        },
        Err(_) => Backend::Cpu,
    };
    let options = Options {
        method: Method::Fmm,
        ..Options::default()
    };
    let start = Instant::now();
    let mut transport = Transport::new(&scene, &options, backend, &Silent)?;
    println!("{} points in {:.2?}", scene.cloud.len(), start.elapsed());

    let inside = |t: f64| dvec3(1.0 + 6.0 * t, 1.2, 1.25);
    for frame in 0..FRAMES {
        scene.lights = vec![PointLight {
            position: inside(f64::from(frame) / f64::from(FRAMES - 1)),
            intensity: Vec3::new(2.0, 1.8, 1.5),
        }];
        let start = Instant::now();
        let lit = transport.illuminate(&scene, &Silent)?;
        println!(
            "frame {frame:2}: {:6.0} ms, {:7} segments, {} bounces at once",
            start.elapsed().as_secs_f64() * 1e3,
            lit.stats.segments,
            lit.stats.iterations
        );
    }
    Ok(())
}
