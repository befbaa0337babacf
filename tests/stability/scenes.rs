//! What the cases are made of.

use fmmgi_gpu::{PointCloud, Scene};
use glam::{DVec3, Vec3};

use crate::clouds::cube;

/// Points along an edge of the room.
pub const K: usize = 11;

pub fn scene(cloud: PointCloud) -> Scene {
    Scene {
        cloud,
        ..Scene::default()
    }
}

/// The unit cube seen from inside, grey, with a lamp in the ceiling.
pub fn lit_room() -> PointCloud {
    with_lamp(cube(K, 0.5, true, 1), 5.0)
}

/// The cube with its lamp.
pub fn with_lamp(mut cloud: PointCloud, emission: f32) -> PointCloud {
    let middle = DVec3::new(0.5, 0.5, 1.0);
    for (p, e) in cloud.positions.iter().zip(&mut cloud.emission) {
        if (*p - middle).abs().max_element() < 0.2 {
            *e = Vec3::splat(emission);
        }
    }
    cloud
}

/// The same room with another reflectance.
pub fn painted(mut cloud: PointCloud, reflectance: f32) -> PointCloud {
    cloud.reflectance.fill(Vec3::splat(reflectance));
    cloud
}

/// Under a sky of 1.
pub fn under_sky(cloud: PointCloud) -> Scene {
    Scene {
        sky: Vec3::ONE,
        ..scene(cloud)
    }
}
