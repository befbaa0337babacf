//! A camera as a frame of axes, and its rays.

use glam::DVec3;

use crate::error::{Error, Result};
use crate::scene::Camera;

/// Right-handed screen axes, and the height of the screen at distance 1.
///
/// Camera coordinates are (right, up, forward), relative to the camera's position, in f64: a large
/// offset of the scan (UTM) cancels before anything is rounded.
#[derive(Clone, Copy, Debug)]
pub struct View {
    pub right: DVec3,
    pub up: DVec3,
    pub forward: DVec3,
    position: DVec3,
    /// Half the height of the screen at distance 1.
    pub half_height: f64,
}

impl View {
    /// Fails where the camera looks nowhere. An `up` along the view gives way to another axis, so
    /// that looking straight down is no special case.
    pub fn new(camera: &Camera) -> Result<Self> {
        let invalid = |what: &str| Err(Error::Invalid(format!("camera: {what}")));
        if !(camera.position.is_finite() && camera.look_at.is_finite() && camera.up.is_finite()) {
            return invalid("position, look_at and up must be finite numbers");
        }
        if !(camera.fov > 0.0 && camera.fov < 180.0) {
            return invalid(&format!(
                "fov must lie between 0 and 180 degrees, not {}",
                camera.fov
            ));
        }
        let Some(forward) = (camera.look_at - camera.position).try_normalize() else {
            return invalid("position and look_at must be different points");
        };
        let right = [camera.up.normalize_or_zero(), DVec3::Y, DVec3::X]
            .into_iter()
            .map(|up| forward.cross(up))
            .find(|right| right.length() > 1e-6)
            .expect("y and x cannot both lie along the view");
        let right = right.normalize();
        Ok(Self {
            right,
            up: right.cross(forward),
            forward,
            position: camera.position,
            half_height: (camera.fov.to_radians() / 2.0).tan(),
        })
    }

    /// A place in camera coordinates.
    pub fn place(&self, p: DVec3) -> DVec3 {
        self.direction(p - self.position)
    }

    /// A direction in camera coordinates.
    pub fn direction(&self, d: DVec3) -> DVec3 {
        DVec3::new(d.dot(self.right), d.dot(self.up), d.dot(self.forward))
    }
}
