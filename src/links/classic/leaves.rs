//! Leaves that see each other (2.2.4.3 and 2.2.4.4 of the report).

use std::borrow::Cow;
use std::time::Instant;

use super::Thresholds;
use super::cones::{Met, pairs};
use crate::error::Result;
use crate::octree::{Facet, Octree};
use crate::progress::Progress;
use crate::visibility::PointVisibility;

/// Pairs of surfels in the first batch, which tells how fast they are tested, and in others.
const BATCH: [usize; 2] = [1 << 16, 1 << 18];

/// Pairs of leaves, each in one order, a leaf with itself among them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// All of them.
    pub pairs: u64,
    /// Those that the cones prune, and pairs of facets as which they are pruned.
    pub pruned: u64,
    pub pruned_facets: u64,
    /// Pairs of surfels of the others, which are tested.
    pub tested: u64,
    /// Pairs that see each other.
    pub visible: u64,
    /// Seconds that the tests took.
    pub seconds: f64,
}

impl Tally {
    /// What there is to test.
    fn ahead(octree: &Octree, progress: &dyn Progress) -> Result<Tally> {
        let facets = &octree.facets;
        let leaves = leaves_below(octree);
        let mut tally = Tally::default();
        for (k, (i, j, met)) in pairs(octree).enumerate() {
            if k % BATCH[1] == 0 {
                progress.check()?;
            }
            let (i, j) = (i as usize, j as usize);
            let below = match i == j {
                true => leaves[i] * (leaves[i] + 1) / 2,
                false => leaves[i] * leaves[j],
            };
            tally.pairs += below;
            match met {
                Met::Pruned => {
                    tally.pruned += below;
                    tally.pruned_facets += 1;
                }
                Met::Leaves => tally.tested += pair_count([&facets[i], &facets[j]]) as u64,
            }
        }
        Ok(tally)
    }

    /// Says what is ahead, by the seconds that the first pairs took.
    fn tell(&self, tested: usize, progress: &dyn Progress) {
        let share = self.tested as f64 / tested.max(1) as f64;
        progress.note(&format!(
            "classic: tests {} pairs of surfels, about {:.0} s; cones prune {:.0}% of the pairs \
             of leaves",
            self.tested,
            (self.seconds * share).ceil(),
            100.0 * self.pruned as f64 / self.pairs as f64
        ));
    }
}

/// Number of leaves below each facet; 1 of a leaf.
fn leaves_below(octree: &Octree) -> Vec<u64> {
    let mut leaves = vec![0; octree.facets.len()];
    for (f, facet) in octree.facets.iter().enumerate().rev() {
        leaves[f] += u64::from(facet.is_leaf());
        if f > 0 {
            leaves[facet.parent as usize] += leaves[f];
        }
    }
    leaves
}

/// Finds the pairs of leaves that see each other and hands them to `sees`, in one order.
pub(super) fn find(
    octree: &Octree,
    thresholds: &Thresholds,
    points: &dyn PointVisibility,
    progress: &dyn Progress,
    mut sees: impl FnMut(u32, u32),
) -> Result<Tally> {
    let mut tally = Tally::ahead(octree, progress)?;
    progress.stage("visibility", tally.tested);
    let mut left = pairs(octree).filter(|&(.., met)| met == Met::Leaves);
    let mut size = BATCH[0];
    loop {
        progress.check()?;
        let (mut leaves, mut surfels) = (Vec::new(), Vec::new());
        while surfels.len() < size
            && let Some((i, j, _)) = left.next()
        {
            let facets = [i, j].map(|f| &octree.facets[f as usize]);
            leaves.push((i, j));
            surfels.extend(surfel_pairs(facets));
        }
        if leaves.is_empty() {
            return Ok(tally);
        }
        let start = Instant::now();
        let visible = points.visible(&surfels)?;
        tally.seconds += start.elapsed().as_secs_f64();
        if size == BATCH[0] {
            tally.tell(surfels.len(), progress);
        }
        let mut answers = visible.as_slice();
        for (i, j) in leaves {
            let facets = [i, j].map(|f| &octree.facets[f as usize]);
            let points = facets[0].len();
            let (tested, others) = answers.split_at(pair_count(facets));
            let of_pair = match i == j {
                true => Cow::Owned(both_ways(points, tested)),
                false => Cow::Borrowed(tested),
            };
            if thresholds.leaves_see(points, &of_pair) {
                tally.visible += 1;
                sees(i, j);
            }
            answers = others;
        }
        progress.advance(surfels.len() as u64);
        size = BATCH[1];
    }
}

/// All surfels of one facet with all of another, or each with each other of the same one; a pair
/// once, in the order of its numbers.
fn surfel_pairs([a, b]: [&Facet; 2]) -> impl Iterator<Item = [u32; 2]> {
    let (same, second) = (a.begin == b.begin, b.begin..b.end);
    (a.begin..a.end).flat_map(move |i| {
        let first = if same { i + 1 } else { second.start };
        (first..second.end).map(move |j| [i.min(j), i.max(j)])
    })
}

/// How many pairs [`surfel_pairs`] gives.
fn pair_count([a, b]: [&Facet; 2]) -> usize {
    match a.begin == b.begin {
        true => a.len() * a.len().saturating_sub(1) / 2,
        false => a.len() * b.len(),
    }
}

/// What was tested of each pair of a leaf's points once, for all pairs, row by row; no point sees
/// itself.
fn both_ways(points: usize, tested: &[bool]) -> Vec<bool> {
    let mut all = vec![false; points * points];
    let pairs = (0..points).flat_map(|i| (i + 1..points).map(move |j| (i, j)));
    for ((i, j), &visible) in pairs.zip(tested) {
        all[i * points + j] = visible;
        all[j * points + i] = visible;
    }
    all
}

impl Thresholds {
    /// Whether two leaves see each other, the first of which has so many points. `visible` says it
    /// for all pairs of points, row by row of the first leaf.
    fn leaves_see(&self, points: usize, visible: &[bool]) -> bool {
        let others = visible.len() / points;
        let see = |seen: usize, all: usize| seen as f32 > self.point_leaf * all as f32;
        let rows = visible.chunks_exact(others);
        let first = rows.filter(|row| see(row.iter().filter(|&&v| v).count(), others));
        let second = (0..others).filter(|&column| {
            let seen = visible[column..].iter().step_by(others);
            see(seen.filter(|&&v| v).count(), points)
        });
        let see_leaf = first.count() + second.count();
        see_leaf as f32 > self.leaf_leaf * (points + others) as f32
    }
}
