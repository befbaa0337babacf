//! A picture in linear light, and its PNG.

use glam::Vec3;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

use super::tone::tone_map;
use crate::error::{Error, Result};

/// Display colour where no surfel is seen: dark and neutral, but not the black of unlit surfaces.
const BACKGROUND: [u8; 3] = [32, 33, 36];

/// Radiosity seen through each pixel, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    pub width: u32,
    pub height: u32,
    /// Mean linear RGB radiosity over the part of the pixel where a surfel is seen; zero on
    /// background.
    pub radiosity: Vec<Vec3>,
    /// Part of the pixel where a surfel is seen, 0 (background) to 1.
    pub coverage: Vec<f32>,
}

/// The picture as the bytes of an 8-bit sRGB PNG file, tone-mapped with `exposure`.
pub fn encode_png(image: &Image, exposure: f32) -> Result<Vec<u8>> {
    encode(image, |radiosity| tone_map(radiosity, exposure))
}

/// The same with sRGB bytes of any kind for a radiosity.
pub(super) fn encode(image: &Image, paint: impl Fn(Vec3) -> [u8; 3]) -> Result<Vec<u8>> {
    let mut rgb = Vec::with_capacity(3 * image.radiosity.len());
    for (&radiosity, &coverage) in image.radiosity.iter().zip(&image.coverage) {
        let surface = paint(radiosity);
        for (s, b) in surface.into_iter().zip(BACKGROUND) {
            let mixed = f32::from(b) + coverage * (f32::from(s) - f32::from(b));
            rgb.push((mixed + 0.5) as u8);
        }
    }
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&rgb, image.width, image.height, ExtendedColorType::Rgb8)
        .map_err(|e| Error::Invalid(format!("the picture cannot be encoded as PNG: {e}")))?;
    Ok(bytes)
}
