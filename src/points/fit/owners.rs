//! Which surfel each point is a measurement of.

use glam::Vec3;
use rayon::prelude::*;

use super::cover::Patch;
use super::samples::Samples;
use crate::error::Result;
use crate::points::PointCloud;
use crate::points::neighbours::Neighbours;
use crate::progress::Progress;

/// Surfels among which a point's is looked for.
const NEAR: usize = 10;
/// A point farther from a surfel than this many of its sizes is none of its own.
const FAR: f32 = 1.5;
/// Or farther beside its plane than this many times what its surface allows.
const BESIDE: f32 = 1.5;

/// For each sample its surfel, and whether it lies on it or only gets its light.
pub(super) struct Owners {
    owners: Vec<(u32, bool)>,
    count: usize,
}

impl Owners {
    /// Finds them, and moves the patches onto the middle of their points.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::Error::Interrupted) if `progress` asks to stop.
    pub fn of(
        samples: &Samples,
        patches: &mut [Patch],
        progress: &dyn Progress,
    ) -> Result<Owners> {
        let places: Vec<Vec3> = patches.iter().map(|p| p.position).collect();
        let tree = Neighbours::new(&places)?;
        let owner = |&place: &Vec3| {
            let near = tree.around(place, NEAR);
            let own = near.iter().filter_map(|&k| {
                let patch = &patches[k as usize];
                let (far, beside) = (place.distance(patch.position) / patch.size, patch.beside(place));
                (far < FAR && beside < BESIDE).then_some((k, far * far + beside * beside))
            });
            match own.min_by(|a, b| a.1.total_cmp(&b.1)) {
                Some((k, _)) => (k, true),
                None => (near.first().copied().unwrap_or(0), false),
            }
        };
        let mut owners: Vec<(u32, bool)> = samples.positions.par_iter().map(owner).collect();
        (0..).zip(&*patches).for_each(|(k, patch)| owners[patch.sample as usize] = (k, true));
        drop(tree);
        progress.check()?;
        let owners = Owners {
            owners,
            count: patches.len(),
        };
        owners.settle(samples, patches);
        Ok(owners)
    }

    /// Moves patches along their normals onto the mean of their points.
    fn settle(&self, samples: &Samples, patches: &mut [Patch]) {
        let mut sums = vec![(0.0, 0.0); patches.len()];
        for (k, owner) in self.iter() {
            let patch = &patches[owner as usize];
            let (sum, count) = &mut sums[owner as usize];
            *sum += patch.normal.dot(samples.positions[k] - patch.position);
            *count += 1.0;
        }
        for (patch, (sum, count)) in patches.iter_mut().zip(sums) {
            // The plane itself knows as much as its points around do.
            patch.position += patch.normal * (sum / (count + AS_SURE));
        }
    }

    /// Samples on a surface, with their surfels.
    pub fn iter(&self) -> impl Iterator<Item = (usize, u32)> {
        let on = self.owners.iter().enumerate().filter(|(_, owner)| owner.1);
        on.map(|(k, owner)| (k, owner.0))
    }

    /// How many points are on no surface.
    pub fn strays(&self) -> usize {
        self.owners.iter().filter(|owner| !owner.1).count()
    }

    /// For each point of the cloud its surfel, if the point has a place.
    pub fn of_points(&self, points: usize, samples: &Samples) -> Vec<Option<u32>> {
        let mut of = vec![None; points];
        for (&point, owner) in samples.points.iter().zip(&self.owners) {
            of[point as usize] = Some(owner.0);
        }
        of
    }

    /// Means of reflectance and emission.
    pub fn colours(&self, cloud: &PointCloud, samples: &Samples) -> (Vec<Vec3>, Vec<Vec3>) {
        let mut sums = vec![(Vec3::ZERO, Vec3::ZERO, 0.0_f32); self.count];
        for (k, owner) in self.iter() {
            let point = samples.points[k] as usize;
            let (reflectance, emission, count) = &mut sums[owner as usize];
            *reflectance += cloud.reflectance[point];
            *emission += cloud.emission[point];
            *count += 1.0;
        }
        let means = sums.into_iter().map(|(r, e, n)| (r / n.max(1.0), e / n.max(1.0)));
        means.unzip()
    }
}

/// Points that a plane by itself counts for.
const AS_SURE: f32 = 6.0;
