//! Pictures of a cloud.

use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{IlluminationMap, Progress, Result, Scene, Surfels, render};

use super::values::Size;

/// The bytes of a PNG file, taken with the scene's camera or one fitted to the cloud.
pub fn take(
    scene: &Scene,
    surfels: &Surfels,
    map: &IlluminationMap,
    size: Size,
    exposure: f32,
    progress: &dyn Progress,
) -> Result<Vec<u8>> {
    let camera = match scene.camera {
        Some(camera) => camera,
        None => {
            let occluders = Occluders::build(surfels);
            let visibility = CpuVisibility::<f32>::new(&occluders);
            let aspect = f64::from(size.width) / f64::from(size.height);
            render::fit(&scene.cloud, surfels, &visibility, aspect)?
        }
    };
    let image = render::picture(
        &scene.cloud,
        map,
        &camera,
        size.width,
        size.height,
        progress,
    )?;
    render::encode_png(&image, exposure)
}
