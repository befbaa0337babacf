//! Finding the links: a dual traversal of the octree, level by level.
//!
//! A pair of facets becomes a link once the error that it can make is small against what is
//! allowed; otherwise the larger facet is split. What stands between the facets is found by tested
//! segments: a few decide whether the link is accepted, and fresh ones measure it, because the
//! samples that accepted a link would be biased (narrow openings would vanish).
//!
//! The pairs of one level are judged together, so that their segments are tested in large batches
//! on whichever backend there is, and the result does not depend on the number of threads.

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

use super::{Entry, Facing, Links, Rows};
use crate::error::{Error, Result};
use crate::expansion::{Local, Moments, Surface};
use crate::octree::{Facet, Octree};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::{Segment, Visibility};

/// What the links may get wrong, and where it matters.
#[derive(Clone, Debug)]
pub struct Accuracy {
    /// Irradiance that a link may be off by, before the factors of the targets.
    pub error: f32,
    /// A facet: largest radiosity of a surfel in it.
    pub radiosity: Vec<f32>,
    /// A facet: factor on `error` for links that end there (dark places need more care).
    pub target_factor: Vec<f32>,
    /// Seed of the segments that are drawn.
    pub seed: u64,
}

/// Expansions hold where both radii together are at most this part of the distance.
const MAX_OPENING: f32 = 0.6;
/// Error of a first-order expansion, in units of opening² times the irradiance.
const TRUNCATION: f32 = 0.7;
/// Links that can bring at most this part of the allowed error need no refinement.
const NEGLIGIBLE: f32 = 0.5;
/// Standard deviation that samples may show, as a part of the allowed error.
const MAX_DEVIATION: f32 = 0.3;
/// Segments a link: at least, and at most.
const SAMPLES: [f32; 2] = [4.0, 32.0];
/// Segments of a link that brings too little to matter.
const NEGLIGIBLE_SAMPLES: usize = 2;
/// Largest weight of a far link: more means that the samples missed where the expansion is small.
const MAX_FRACTION: f32 = 2.0;
/// Pairs of facets judged in one batch.
const BATCH: usize = 1 << 15;

/// Finds the links of all surfels by the rules above.
pub fn build(
    surfels: &Surfels,
    octree: &Octree,
    accuracy: &Accuracy,
    visibility: &dyn Visibility,
    progress: &dyn Progress,
) -> Result<Links> {
    let surface = Surface::new(surfels);
    let mut traversal = Traversal {
        surfels,
        surface: &surface,
        octree,
        accuracy,
        visibility,
        far: Vec::new(),
        sampled: Vec::new(),
        near: Vec::new(),
        smooth: 0,
    };
    let mut level = vec![Pair {
        target: 0,
        source: 0,
    }];
    while !level.is_empty() {
        progress.stage("links", level.len() as u64);
        let mut next = Vec::new();
        for batch in level.chunks(BATCH) {
            progress.check()?;
            traversal.judge(batch, &mut next)?;
            progress.advance(batch.len() as u64);
        }
        level = next;
    }
    let lists = [&traversal.far, &traversal.sampled, &traversal.near];
    let entries = lists.iter().map(|l| l.len()).max().unwrap_or(0);
    if entries > u32::MAX as usize {
        return Err(Error::TooLarge(format!(
            "{entries} links are more than one operator can hold: ask for a larger tolerance"
        )));
    }
    let facets = octree.facets.len();
    Ok(Links {
        far: Rows::new(facets, traversal.far),
        sampled: Rows::new(facets, traversal.sampled),
        near: Rows::new(surfels.len(), traversal.near),
        smooth: traversal.smooth,
    })
}

/// Two facets, the first of which takes light from the second.
#[derive(Clone, Copy)]
struct Pair {
    target: u32,
    source: u32,
}

/// Two surfels, with the form factor between them.
#[derive(Clone, Copy)]
struct Sample {
    target: u32,
    source: u32,
    weight: f32,
}

/// What is to be done with a pair of facets.
enum Verdict {
    /// No light, or too little to count.
    Drop,
    /// Look at the children of the larger facet.
    Split,
    /// Both are leaves: the surfels' form factors.
    Near(Vec<Sample>),
    /// May become a link, if the samples agree.
    Candidate(Candidate),
}

struct Candidate {
    samples: Vec<Sample>,
    /// The samples are all pairs of surfels.
    exhaustive: bool,
    /// Too little light to matter: accepted whatever the samples say.
    negligible: bool,
    /// Samples drawn, with those that do not face each other.
    drawn: usize,
    /// Largest irradiance that the source can cause at the target.
    bound: f32,
    allowed: f32,
    /// Both facets face each other entirely and an expansion is accurate enough.
    smooth: bool,
    /// A mean kernel is accurate enough, if the samples agree.
    uniform: bool,
}

/// What the samples of a candidate say.
enum Outcome {
    Drop,
    Split,
    Near,
    /// Weight, and whether nothing was seen in the way.
    Far(f32, bool),
    Sampled(f32),
}

struct Traversal<'a> {
    surfels: &'a Surfels,
    surface: &'a Surface<f32>,
    octree: &'a Octree,
    accuracy: &'a Accuracy,
    visibility: &'a dyn Visibility,
    far: Vec<Entry>,
    sampled: Vec<Entry>,
    near: Vec<Entry>,
    smooth: u64,
}

impl Traversal<'_> {
    /// Judges a batch of pairs: links go to the lists, pairs of children to `next`.
    fn judge(&mut self, batch: &[Pair], next: &mut Vec<Pair>) -> Result<()> {
        let verdicts: Vec<Verdict> = batch.par_iter().map(|&p| self.classify(p)).collect();
        let visible = self.test(verdicts.iter().map(Verdict::samples))?;

        let outcomes: Vec<Outcome> = verdicts
            .par_iter()
            .zip(&visible)
            .zip(batch)
            .map(|((verdict, visible), &pair)| match verdict {
                Verdict::Candidate(c) => self.decide(pair, c, visible),
                _ => Outcome::Drop,
            })
            .collect();

        // Links that their samples selected are measured afresh; leaves whose samples disagree
        // exchange light surfel by surfel.
        let fresh: Vec<Vec<Sample>> = verdicts
            .par_iter()
            .zip(&outcomes)
            .zip(batch)
            .map(|((verdict, outcome), &pair)| match (verdict, outcome) {
                (Verdict::Candidate(c), Outcome::Far(..) | Outcome::Sampled(_)) if c.selected() => {
                    self.draw(pair, c.drawn, 1)
                }
                (Verdict::Candidate(_), Outcome::Near) => self.all_pairs(pair),
                _ => Vec::new(),
            })
            .collect();
        let fresh_visible = self.test(fresh.iter().map(Vec::as_slice))?;

        for (k, (verdict, outcome)) in verdicts.into_iter().zip(outcomes).enumerate() {
            let pair = batch[k];
            match (verdict, outcome) {
                (Verdict::Drop, _) | (Verdict::Candidate(_), Outcome::Drop) => {}
                (Verdict::Near(samples), _) => self.add_near(&samples, &visible[k]),
                (Verdict::Candidate(_), Outcome::Near) => {
                    self.add_near(&fresh[k], &fresh_visible[k]);
                }
                (Verdict::Split, _) | (Verdict::Candidate(_), Outcome::Split) => {
                    self.split(pair, next);
                }
                (Verdict::Candidate(c), mut outcome) => {
                    if c.selected() {
                        outcome = self.measure(pair, &c, outcome, &fresh[k], &fresh_visible[k]);
                    }
                    let entry = |weight| Entry {
                        target: pair.target,
                        source: pair.source,
                        weight,
                    };
                    match outcome {
                        Outcome::Far(fraction, smooth) if fraction > 0.0 => {
                            self.far.push(entry(fraction));
                            self.smooth += u64::from(smooth);
                        }
                        Outcome::Sampled(kernel) if kernel > 0.0 => {
                            self.sampled.push(entry(kernel));
                        }
                        _ => {}
                    }
                }
            }
        }
        Ok(())
    }

    fn add_near(&mut self, samples: &[Sample], visible: &[bool]) {
        let seen = samples.iter().zip(visible).filter(|&(_, &v)| v);
        self.near.extend(seen.map(|(s, _)| Entry {
            target: s.target,
            source: s.source,
            weight: s.weight,
        }));
    }

    /// What the bounds say of a pair of facets, before any segment is tested.
    fn classify(&self, pair: Pair) -> Verdict {
        let (a, b) = self.facets(pair);
        let radiosity = self.accuracy.radiosity[pair.source as usize];
        let facing = Facing::between(a, b);
        if radiosity <= 0.0 || facing.averted() {
            return Verdict::Drop;
        }
        let allowed = self.accuracy.error * self.accuracy.target_factor[pair.target as usize];
        let [cos_a, cos_b] = facing.cosines();
        let solid_angle = b.area * cos_b / (facing.gap * facing.gap).max(f32::MIN_POSITIVE);
        let form_factor = cos_a * (solid_angle / std::f32::consts::PI).min(1.0);
        let bound = radiosity * form_factor;
        let opening = (a.radius + b.radius) / facing.distance.max(f32::MIN_POSITIVE);
        let apart = opening < MAX_OPENING;
        let expandable = apart && !facing.near && TRUNCATION * opening * opening * bound <= allowed;
        let uniform = apart && bound * opening.max(0.3) <= allowed;
        let negligible = bound <= NEGLIGIBLE * allowed;

        if negligible || expandable || (uniform && !facing.full()) {
            let pairs = a.len() * b.len();
            let wanted = if negligible {
                NEGLIGIBLE_SAMPLES
            } else {
                (0.5 * bound / allowed).ceil().clamp(SAMPLES[0], SAMPLES[1]) as usize
            };
            let exhaustive = pairs <= wanted;
            let drawn = wanted.min(pairs);
            let samples = if exhaustive {
                self.all_pairs(pair)
            } else {
                self.draw(pair, drawn, 0)
            };
            // Two samples of a negligible link cannot show that all face each other.
            let all_face = facing.full() || !negligible && samples.iter().all(|s| s.weight > 0.0);
            return Verdict::Candidate(Candidate {
                exhaustive,
                negligible,
                drawn,
                bound,
                allowed,
                smooth: expandable && all_face,
                uniform: uniform || negligible,
                samples,
            });
        }
        if a.is_leaf() && b.is_leaf() {
            return Verdict::Near(self.all_pairs(pair));
        }
        Verdict::Split
    }

    /// What the tested samples say of a candidate.
    fn decide(&self, pair: Pair, c: &Candidate, visible: &[bool]) -> Outcome {
        let none_face = c.samples.iter().all(|s| s.weight == 0.0);
        if none_face && (c.negligible || c.exhaustive) {
            return Outcome::Drop;
        }
        if c.smooth {
            let seen = visible_weight(&c.samples, visible);
            let fraction = seen / c.samples.iter().map(|s| s.weight).sum::<f32>();
            let deviation = (fraction * (1.0 - fraction)).max(0.0).sqrt();
            if c.negligible || c.bound * deviation <= MAX_DEVIATION * c.allowed {
                return self.far(pair, &c.samples, visible);
            }
        } else if c.uniform {
            let (mean, square) = c
                .samples
                .iter()
                .zip(visible)
                .filter(|&(_, &v)| v)
                .fold((0.0, 0.0), |(m, q), (s, _)| {
                    (m + s.weight, q + s.weight * s.weight)
                });
            let (mean, square) = (mean / c.drawn as f32, square / c.drawn as f32);
            // One sample stands for as many times its own power as the facet has surfels.
            let source = &self.octree.facets[pair.source as usize];
            let power = source.len() as f32 * self.accuracy.radiosity[pair.source as usize];
            let deviation = (square - mean * mean).max(0.0).sqrt() * power;
            if c.negligible || deviation <= MAX_DEVIATION * c.allowed {
                return Outcome::Sampled(self.kernel(pair, mean));
            }
        }
        let (a, b) = self.facets(pair);
        if a.is_leaf() && b.is_leaf() {
            Outcome::Near
        } else {
            Outcome::Split
        }
    }

    /// The weight of an accepted link, from fresh samples.
    fn measure(
        &self,
        pair: Pair,
        c: &Candidate,
        accepted: Outcome,
        samples: &[Sample],
        visible: &[bool],
    ) -> Outcome {
        match accepted {
            Outcome::Far(..) => self.far(pair, samples, visible),
            Outcome::Sampled(_) => {
                let mean = visible_weight(samples, visible) / c.drawn as f32;
                Outcome::Sampled(self.kernel(pair, mean))
            }
            kept => kept,
        }
    }

    /// A far link. Its weight is the light seen by the samples relative to what the expansions give
    /// for the same samples. So the error of truncation, which has the same sign in most links and
    /// adds up, is left in the noise of the samples, which has not.
    fn far(&self, pair: Pair, samples: &[Sample], visible: &[bool]) -> Outcome {
        let (a, b) = self.facets(pair);
        let s = self.surface;
        let way = a.centre - b.centre;
        let distance = way.length();
        let expanded: f32 = samples
            .iter()
            .map(|sample| {
                let (i, j) = (sample.target as usize, sample.source as usize);
                let mut moments = Moments::<f32>::default();
                let place = (s.positions[j] - b.centre) / b.scale();
                moments.add_surfel(Vec3::splat(s.areas[j]), s.normals[j], place);
                let mut local = Local::default();
                local.add_moments(
                    &moments,
                    way / distance,
                    distance,
                    b.scale() / distance,
                    a.scale() / distance,
                    1.0,
                );
                let place = (s.positions[i] - a.centre) / a.scale();
                local.irradiance(s.normals[i], place).x
            })
            .sum();
        let fraction = match expanded > 0.0 {
            true => (visible_weight(samples, visible) / expanded).min(MAX_FRACTION),
            false => 0.0,
        };
        let facing = samples.iter().filter(|s| s.weight > 0.0).count();
        let smooth = visible.iter().filter(|&&v| v).count() == facing;
        Outcome::Far(fraction, smooth)
    }

    /// Kernel that acts on the source's power, from the mean weight of one pair of surfels.
    fn kernel(&self, pair: Pair, mean: f32) -> f32 {
        let source = &self.octree.facets[pair.source as usize];
        mean / source.mean_area()
    }

    /// Draws pairs of surfels, spread over both facets.
    fn draw(&self, pair: Pair, count: usize, round: u64) -> Vec<Sample> {
        const GOLDEN: f32 = 0.618_034;
        let (a, b) = self.facets(pair);
        let key = u64::from(pair.target) << 32 | u64::from(pair.source);
        let seed = self.accuracy.seed.wrapping_mul(2).wrapping_add(round);
        let stream = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15); // spreads small numbers over all bits
        let mut random = Pcg64Mcg::seed_from_u64(key ^ stream);
        let shift: f32 = random.random();
        let at = |part: f32, facet: &Facet| {
            let n = facet.len();
            facet.begin as usize + ((part * n as f32) as usize).min(n - 1)
        };
        (0..count)
            .map(|q| {
                let q = q as f32;
                let u = (q + random.random::<f32>()) / count as f32;
                let v = (q * GOLDEN + shift + random.random::<f32>() / count as f32).fract();
                let (i, j) = (at(u, a), at(v, b));
                Sample {
                    target: i as u32,
                    source: j as u32,
                    weight: self.surface.form_factor(i, j),
                }
            })
            .collect()
    }

    /// All pairs of surfels.
    fn all_pairs(&self, pair: Pair) -> Vec<Sample> {
        let (a, b) = self.facets(pair);
        a.surfels()
            .flat_map(|i| b.surfels().map(move |j| (i, j)))
            .map(|(i, j)| Sample {
                target: i as u32,
                source: j as u32,
                weight: self.surface.form_factor(i, j),
            })
            .collect()
    }

    /// The children of the larger facet with the other one.
    fn split(&self, pair: Pair, next: &mut Vec<Pair>) {
        let (a, b) = self.facets(pair);
        if b.is_leaf() || (!a.is_leaf() && a.radius >= b.radius) {
            next.extend(a.children().map(|target| Pair { target, ..pair }));
        } else {
            next.extend(b.children().map(|source| Pair { source, ..pair }));
        }
    }

    /// Which samples see each other, in their groups; those that do not face each other are not
    /// tested.
    fn test<'s>(
        &self,
        groups: impl Iterator<Item = &'s [Sample]> + Clone,
    ) -> Result<Vec<Vec<bool>>> {
        let segments: Vec<Segment> = groups
            .clone()
            .flatten()
            .filter(|s| s.weight > 0.0)
            .map(|s| self.surfels.segment(s.target as usize, s.source as usize))
            .collect();
        let mut answers = self.visibility.visible(&segments)?.into_iter();
        Ok(groups
            .map(|g| {
                g.iter()
                    .map(|s| s.weight > 0.0 && answers.next() == Some(true))
                    .collect()
            })
            .collect())
    }

    fn facets(&self, pair: Pair) -> (&Facet, &Facet) {
        let facets = &self.octree.facets;
        (&facets[pair.target as usize], &facets[pair.source as usize])
    }
}

impl Candidate {
    /// Was it the samples that decided? Then they must not measure the link as well.
    fn selected(&self) -> bool {
        !self.exhaustive && !self.negligible
    }
}

impl Verdict {
    fn samples(&self) -> &[Sample] {
        match self {
            Verdict::Near(samples) => samples,
            Verdict::Candidate(c) => &c.samples,
            Verdict::Drop | Verdict::Split => &[],
        }
    }
}

/// Sum of the weights of the visible samples.
fn visible_weight(samples: &[Sample], visible: &[bool]) -> f32 {
    let seen = samples.iter().zip(visible).filter(|&(_, &v)| v);
    seen.map(|(s, _)| s.weight).sum()
}
