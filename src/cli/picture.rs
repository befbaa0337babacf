//! Pictures of a cloud.

use fmmgi_gpu::render::Image;
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
    let image = take_image(scene, surfels, map, size, progress)?;
    render::encode_png(&image, exposure)
}

/// The picture itself.
pub fn take_image(
    scene: &Scene,
    surfels: &Surfels,
    map: &IlluminationMap,
    size: Size,
    progress: &dyn Progress,
) -> Result<Image> {
    let camera = match scene.camera {
        Some(camera) => camera,
        None => {
            let occluders = Occluders::build(surfels);
            let visibility = CpuVisibility::<f32>::new(&occluders);
            let aspect = f64::from(size.width) / f64::from(size.height);
            render::fit(&scene.cloud, surfels, &visibility, aspect)?
        }
    };
    render::picture(
        &scene.cloud,
        map,
        &camera,
        size.width,
        size.height,
        progress,
    )
}
