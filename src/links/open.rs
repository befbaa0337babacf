//! Links where nothing is in the way: pure N-body sums, without any segment.

use super::{Accuracy, Links, build};
use crate::error::Result;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::NothingInTheWay;

/// Part of the expected error that is found at most. Measured in cornell, organic, the cave and at
/// random (`tests/open.rs`), for tolerances from 0.1 to 1e-4: 0.1 to 0.6.
const FOUND: f64 = 0.65;

/// Finds links whose errors are expected to be at most `accuracy.error` together, root mean square
/// over the surfels: that of each link, before the factors of the targets, follows from their number.
pub fn build_open(
    surfels: &Surfels,
    octree: &Octree,
    accuracy: &Accuracy,
    progress: &dyn Progress,
) -> Result<Links> {
    let allowed = f64::from(accuracy.error);
    let mut accuracy = Accuracy {
        error: 0.5 * accuracy.error,
        ..accuracy.clone()
    };
    loop {
        let links = build(surfels, octree, &accuracy, &NothingInTheWay, progress)?;
        let excess = FOUND * links.expected_error / allowed;
        // Numbers that are none, or too small, end it as well.
        if excess > 1.0 && accuracy.error.is_normal() {
            // Smaller errors take more links, which adds to their sum.
            accuracy.error /= (1.1 * excess.powf(1.3)) as f32;
        } else {
            return Ok(links);
        }
    }
}

/// Largest order of the expansions for a tolerance: 2 down to 0.003, 4 to 0.0003, then 6. Order 1
/// errs to one side.
pub fn order(tolerance: f64) -> usize {
    match tolerance {
        3e-3.. => 2,
        3e-4.. => 4,
        _ => 6,
    }
}

/// Surfels a leaf for expansions of an order: at least as many as make these pay. In small clouds
/// leaves are no larger than that, so that pairs of neighbouring leaves are few of all pairs.
pub fn leaf_size(order: usize, surfels: usize) -> usize {
    (surfels / 2500).min(32).max(4 << (order / 2))
}
