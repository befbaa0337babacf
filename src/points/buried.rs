//! Points inside of bodies and behind walls.

use rand::RngExt;
use rayon::prelude::*;

use super::Surfels;
use crate::random::{Purpose, cosine_direction, stream};
use crate::visibility::{Occluders, first_hit};

/// Rays from a surfel; the first few tell for most: those of which fewer than this meet backs.
const RAYS: usize = 24;
const FIRST_RAYS: usize = 4;
const FIRST_BACKS: usize = 1;
/// A surfel is buried if more than this part of them meets the back of a surface.
const BACKS: f64 = 1.0 / 3.0;
/// Backs nearer than this many sizes of a cell are noise of the own surface.
const NEAR: f32 = 3.0;
/// Surfels that are looked at first.
const SAMPLE: usize = 2000;
/// If a smaller part of them is buried, none of the others is looked at.
const FEW: f64 = 0.002;
/// If a larger part is, there are no bodies to be inside of: the surface is full of holes.
const MANY: f64 = 0.1;

/// Indices of surfels that mostly see the backs of others: those inside of bodies and behind walls. They
/// would not only be lit wrongly, but spoil the visibility that they share with their neighbours.
pub fn buried(surfels: &Surfels, occluders: &Occluders) -> Vec<u32> {
    let n = surfels.len();
    let reach = surfels.reach();
    let is_buried = |i: &u32| is_buried(surfels, occluders, reach, *i as usize);
    let step = n.div_ceil(SAMPLE).max(1);
    let sample = (0..n as u32).into_par_iter().step_by(step);
    let looked_at = n.div_ceil(step);
    let share = sample.filter(is_buried).count() as f64 / looked_at as f64;
    if !(FEW..=MANY).contains(&share) {
        return Vec::new();
    }
    (0..n as u32).into_par_iter().filter(is_buried).collect()
}

fn is_buried(surfels: &Surfels, occluders: &Occluders, reach: f32, i: usize) -> bool {
    // By point, not by surfel: in whatever order.
    let mut random = stream(0, Purpose::Buried, u64::from(surfels.points[i]));
    let (normal, tangent) = (surfels.normals[i], surfels.cells.tangents[i]);
    let near = NEAR * surfels.areas[i].sqrt();
    let mut meets_back = || {
        let way = cosine_direction(normal, tangent, random.random(), random.random());
        let Some(hit) = first_hit::<f32>(occluders, &surfels.ray(i, way * reach)) else {
            return false;
        };
        let k = hit.surfel as usize;
        let other = surfels.normals[k];
        let distance = (surfels.below(k) - surfels.above(i)).dot(other) / way.dot(other);
        !hit.front && distance > near
    };
    let backs = (0..FIRST_RAYS).filter(|_| meets_back()).count();
    if backs < FIRST_BACKS {
        return false;
    }
    // So many of the others must, or must not.
    let mut wanted = (BACKS * RAYS as f64) as usize + 1;
    wanted = wanted.saturating_sub(backs);
    for left in (0..RAYS - FIRST_RAYS).rev() {
        if wanted == 0 || wanted > left + 1 {
            break;
        }
        wanted -= usize::from(meets_back());
    }
    wanted == 0
}
