//! Which surfel each point is a measurement of.

use glam::Vec3;
use rayon::prelude::*;

use super::patch::Patch;
use super::samples::Samples;
use crate::error::Result;
use crate::points::PointCloud;
use crate::points::neighbours::Neighbours;
use crate::progress::Progress;

/// Surfels among which a point's is looked for.
const NEAR: usize = 10;
/// Surfels around one among which those of its many points are looked for.
const BESIDE_IT: usize = 14;
/// A point farther from a surfel than this many of its sizes is none of its own.
const FAR: f32 = 1.5;
/// Or farther beside its plane than this many times what its surface allows.
const BESIDE: f32 = 1.5;

/// Of two surfels that a point lies on as well, the nearer one has it: the square of a distance of one size counts
/// as much as that of this many deviations.
const NEARER: f32 = 0.2;

/// Deviations of a colour beyond which it is one that a surface may have somewhere.
const STRANGEST: f32 = 3.0;

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
    pub fn of(samples: &Samples, patches: &mut [Patch], progress: &dyn Progress) -> Result<Owners> {
        let mut owners = Owners::nearest_to(samples, patches)?;
        progress.check()?;
        owners.settle(samples, patches);
        let nearest = owners.nearest(samples, patches);
        (patches.iter_mut().zip(nearest)).for_each(|(patch, k)| patch.sample = k);
        Ok(owners)
    }

    /// The same for patches that stay as they are.
    pub fn nearest_to(samples: &Samples, patches: &[Patch]) -> Result<Owners> {
        let places: Vec<Vec3> = patches.iter().map(|p| p.position).collect();
        let tree = Neighbours::new(&places)?;
        let shared = tree.shared(BESIDE_IT, samples.len());
        let owner = |(sample, &place): (usize, &Vec3)| {
            let nearest = tree.around(place, if shared.is_some() { 1 } else { NEAR });
            let near = match (&shared, nearest.first()) {
                (Some(shared), Some(k)) => &shared[*k as usize],
                _ => &nearest,
            };
            let own = near.iter().filter_map(|&k| {
                let patch = &patches[k as usize];
                let far = place.distance(patch.position) / patch.size;
                let beside = patch.beside(place);
                let deviations = patch.deviations(place);
                let strange = patch.strange(samples.colours[sample]).min(STRANGEST);
                let seen = patch.is_seen_with(samples, sample as u32);
                let off = NEARER * far * far + deviations * deviations + strange * strange;
                (seen && far < FAR && beside < BESIDE).then_some((k, off))
            });
            match own.min_by(|a, b| a.1.total_cmp(&b.1)) {
                Some((k, _)) => (k, true),
                None => (near.first().copied().unwrap_or(0), false),
            }
        };
        let owners: Vec<(u32, bool)> = samples
            .positions
            .par_iter()
            .enumerate()
            .map(owner)
            .collect();
        Ok(Owners {
            owners,
            count: patches.len(),
        })
    }

    /// Of each patch the sample nearest to it among its own. One that has none takes that which it was fitted at.
    fn nearest(&mut self, samples: &Samples, patches: &[Patch]) -> Vec<u32> {
        loop {
            let mut nearest: Vec<Option<(f32, u32)>> = vec![None; patches.len()];
            for (k, owner) in self.iter() {
                let far = patches[owner as usize]
                    .position
                    .distance_squared(samples.positions[k]);
                let nearest = &mut nearest[owner as usize];
                if nearest.is_none_or(|n| far < n.0) {
                    *nearest = Some((far, k as u32));
                }
            }
            if nearest.iter().all(Option::is_some) {
                return nearest.into_iter().flatten().map(|n| n.1).collect();
            }
            for (k, patch) in (0..).zip(patches) {
                if nearest[k as usize].is_none() {
                    self.owners[patch.sample as usize] = (k, true);
                }
            }
        }
    }

    /// Moves patches to the middle of their points: one that was begun at an edge lies beside it.
    fn settle(&self, samples: &Samples, patches: &mut [Patch]) {
        let mut sums = vec![(Vec3::ZERO, 0.0); patches.len()];
        for (k, owner) in self.iter() {
            let (sum, count) = &mut sums[owner as usize];
            *sum += samples.positions[k] - patches[owner as usize].position;
            *count += 1.0;
        }
        for (patch, (sum, count)) in patches.iter_mut().zip(sums) {
            if patch.round.is_some() {
                continue;
            }
            let up = patch.normal.dot(sum);
            // The plane itself knows as much as its points around do.
            let up_by = up / (count + AS_SURE) * patch.normal;
            patch.position += match patch.flat {
                true => up_by + (sum - up * patch.normal) / (count + FEW),
                false => up_by,
            };
        }
    }

    /// Samples on a surface, with their surfels.
    pub fn iter(&self) -> impl Iterator<Item = (usize, u32)> {
        let on = self.owners.iter().enumerate().filter(|(_, owner)| owner.1);
        on.map(|(k, owner)| (k, owner.0))
    }

    /// Where the points of each surfel lie.
    pub fn extents(&self, samples: &Samples, patches: &[Patch]) -> Extents {
        let mut begins = vec![0; patches.len() + 1];
        self.iter()
            .for_each(|(_, owner)| begins[owner as usize + 1] += 1);
        for k in 0..patches.len() {
            begins[k + 1] += begins[k];
        }
        let mut next = begins.clone();
        let mut offsets = vec![Vec3::ZERO; begins[patches.len()] as usize];
        for (k, owner) in self.iter() {
            let owner = owner as usize;
            offsets[next[owner] as usize] = samples.positions[k] - patches[owner].position;
            next[owner] += 1;
        }
        Extents {
            begins,
            offsets,
            spacings: patches.iter().map(|p| p.spacing).collect(),
        }
    }

    /// How many points are on no surface.
    pub fn strays(&self) -> usize {
        self.owners.iter().filter(|owner| !owner.1).count()
    }

    /// How many points each surfel has.
    pub fn counts(&self) -> Vec<u32> {
        let mut counts = vec![0; self.count];
        self.iter()
            .for_each(|(_, owner)| counts[owner as usize] += 1);
        counts
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
        let means = sums
            .into_iter()
            .map(|(r, e, n)| (r / n.max(1.0), e / n.max(1.0)));
        means.unzip()
    }
}

/// How far the points of surfels reach.
#[derive(Default)]
pub(in crate::points) struct Extents {
    /// First point of each surfel, and the number of all.
    begins: Vec<u32>,
    /// From the surfel to its points.
    offsets: Vec<Vec3>,
    spacings: Vec<f32>,
}

impl Extents {
    /// How far the surface of a surfel goes in a direction: half a spacing beyond its last point.
    pub fn reach(&self, i: usize, direction: Vec3) -> f32 {
        let [begin, end] = [i, i + 1].map(|k| self.begins[k] as usize);
        let along = self.offsets[begin..end].iter().map(|o| o.dot(direction));
        along.fold(0.0, f32::max) + 0.5 * self.spacings[i]
    }
}

/// Fewer points than this do not tell the middle of a surfel.
const FEW: f32 = 3.0;
/// Points that a plane by itself counts for.
const AS_SURE: f32 = 6.0;
