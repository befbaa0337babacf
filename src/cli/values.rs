//! Values on the command line: parsed and checked.

use fmmgi_gpu::points::Facing;
use fmmgi_gpu::scene::{BRIGHTEST, LARGEST, PointLight, TOLERANCES};
use glam::{DVec3, Vec3};

/// Largest side of a picture in pixels.
const MAX_SIDE: u32 = 16_384;
/// Most pixels of a picture.
const MAX_PIXELS: u32 = 1 << 25;

/// Width and height of a picture.
#[derive(Clone, Copy, Debug)]
pub struct Size {
    pub width: u32,
    pub height: u32,
}

pub fn size(text: &str) -> Result<Size, String> {
    let (width, height) = text
        .split_once(['x', 'X'])
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)))
        .ok_or("must be WIDTHxHEIGHT in pixels, for instance 1280x720")?;
    let sides = 1..=MAX_SIDE;
    if !sides.contains(&width) || !sides.contains(&height) {
        return Err(format!("each side must have 1 to {MAX_SIDE} pixels"));
    }
    if width * height > MAX_PIXELS {
        return Err(format!("at most {MAX_PIXELS} pixels are possible"));
    }
    Ok(Size { width, height })
}

pub fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(tolerance) if TOLERANCES.contains(&tolerance) => Ok(tolerance),
        _ => Err("must be a number from 1e-6 to 0.5, for instance 0.03".to_owned()),
    }
}

/// A length or an area.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(number) if number > 0.0 && number <= LARGEST => Ok(number),
        _ => Err(format!("must be a number above 0, at most {LARGEST:e}")),
    }
}

/// To which side normals point.
pub fn facing(text: &str) -> Result<Facing, String> {
    match text {
        "auto" => Ok(Facing::Auto),
        "inward" => Ok(Facing::Inward),
        "outward" => Ok(Facing::Outward),
        _ => match text.strip_prefix("viewpoint:").map(place) {
            Some(viewpoint) => viewpoint.map(Facing::Viewpoint),
            None => Err("must be auto, inward, outward or viewpoint:X,Y,Z".to_owned()),
        },
    }
}

/// A place in the coordinates of the scan.
pub fn place(text: &str) -> Result<DVec3, String> {
    match three(text) {
        Some(place) if place.abs().cmple(DVec3::splat(LARGEST)).all() => Ok(place),
        _ => Err(format!(
            "must be three finite numbers X,Y,Z, at most {LARGEST:e}, for instance 0,1.5,-2"
        )),
    }
}

/// Linear RGB of a light.
pub fn rgb(text: &str) -> Result<Vec3, String> {
    let rgb = three(text)
        .ok_or("must be three numbers R,G,B, for instance 1,0.9,0.8")?
        .as_vec3();
    if rgb.min_element() < 0.0 {
        return Err("must not be negative: there is no dark light".to_owned());
    }
    if !rgb.cmple(Vec3::splat(BRIGHTEST)).all() {
        return Err(format!("must be finite, at most {BRIGHTEST:e}"));
    }
    Ok(rgb)
}

pub fn light(text: &str) -> Result<PointLight, String> {
    const SYNTAX: &str = "a light is point:X,Y,Z or point:X,Y,Z:R,G,B (place; radiant intensity, \
        1,1,1 if left out), for instance point:0,0,2.5:10,9,8";
    let parts: Vec<&str> = text.split(':').collect();
    let (place, intensity) = match parts[..] {
        ["point", place] => (place, Vec3::ONE),
        ["point", place, intensity] => (
            place,
            rgb(intensity).map_err(|what| format!("its intensity {what}; {SYNTAX}"))?,
        ),
        _ => return Err(SYNTAX.to_owned()),
    };
    match three(place) {
        Some(position) if position.abs().cmple(DVec3::splat(LARGEST)).all() => Ok(PointLight {
            position,
            intensity,
        }),
        _ => Err(format!(
            "its place must be three finite numbers, at most {LARGEST:e}; {SYNTAX}"
        )),
    }
}

fn three(text: &str) -> Option<DVec3> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|number| number.trim().parse().ok())
        .collect::<Option<_>>()?;
    <[f64; 3]>::try_from(numbers).ok().map(DVec3::from)
}
