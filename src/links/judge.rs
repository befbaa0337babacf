//! What may become a link: bounds first, then samples.

use glam::Vec3A;
use rand::RngExt;

use super::{Accuracy, Facing, MIXED_ORDER};
use crate::expansion::{Indices, Surface, Workspace, coefficients, expected_error, least_order};
use crate::octree::{Facet, Octree};
use crate::random::{Purpose, stream};

/// Expansions hold where both radii together are at most this part of the distance.
const MAX_OPENING: f32 = 0.6;
/// Links that can bring at most this part of the allowed error need no refinement.
const NEGLIGIBLE: f32 = 0.5;
/// Standard deviation that samples may show, as a part of the allowed error.
///
/// Links whose few segments disagree are few, and most of the error is theirs: split from 0.1 on
/// instead of 0.3, the cave is off by 7% less for 3% more segments.
const MAX_DEVIATION: f32 = 0.1;
/// Segments that decide on a link: at least, and at most.
const SAMPLES: [f32; 2] = [4.0, 32.0];
/// Segments at least that measure it. Those that decided have said the same with few exceptions: with
/// 4 the error is 1% smaller, for 8 to 12% more segments.
const MEASURED: f32 = 2.0;
/// Larger facets are split before they become a mixed link, where parts of them may be settled.
const MIXED_SURFELS: usize = 24;
/// Segments of a link that brings too little to matter.
const NEGLIGIBLE_SAMPLES: usize = 2;
/// Largest weight of a far link: more means that the samples missed where the expansion is small.
const MAX_FRACTION: f32 = 2.0;

/// Two facets, the first of which takes light from the second.
#[derive(Clone, Copy)]
pub(super) struct Pair {
    pub target: u32,
    pub source: u32,
    /// Part of the whole work that it stands for.
    pub share: f32,
}

/// Two surfels, with the form factor between them.
#[derive(Clone, Copy)]
pub(super) struct Sample {
    pub target: u32,
    pub source: u32,
    pub weight: f32,
}

/// What is to be done with a pair of facets.
pub(super) enum Verdict {
    /// The facets do not face each other.
    Drop,
    /// There is no light.
    Dark,
    /// Look at the children of the larger facet.
    Split,
    /// Both are leaves: the surfels' form factors.
    Near(Vec<Sample>),
    /// Nothing is in the way and all face each other: an expansion of this order with this error.
    Expand(usize, f32),
    /// Nothing is in the way, but not all face each other: an expansion with this error.
    Mixed(f32),
    /// Nothing is in the way and both are leaves: surfel by surfel, by the point kernel where they
    /// are not near each other; these are the pairs that are.
    Pairs(Vec<Sample>),
    /// May become a link, if the samples agree.
    Candidate(Candidate),
}

pub(super) struct Candidate {
    pub samples: Vec<Sample>,
    /// The samples are all pairs of surfels.
    pub exhaustive: bool,
    /// Too little light to matter: accepted whatever the samples say.
    pub negligible: bool,
    /// Samples drawn, with those that do not face each other.
    pub drawn: usize,
    /// Samples to draw afresh.
    pub measured: usize,
    /// Largest irradiance that the source can cause at the target.
    pub bound: f32,
    pub allowed: f32,
    /// Both facets face each other entirely and an expansion is accurate enough.
    pub smooth: bool,
    /// Order of that expansion.
    pub order: usize,
    /// A mean kernel is accurate enough, if the samples agree.
    pub uniform: bool,
}

/// What the samples of a candidate say.
pub(super) enum Outcome {
    Drop,
    Split,
    Near,
    /// Weight, and whether nothing was seen in the way.
    Far(f32, bool),
    Sampled(f32),
}

/// Judges pairs of facets.
pub(super) struct Judge<'a> {
    pub surface: &'a Surface<f32>,
    pub octree: &'a Octree,
    pub accuracy: &'a Accuracy,
    /// Nothing can be in the way.
    pub open: bool,
}

impl Judge<'_> {
    /// What the bounds say of a pair of facets, before any segment is tested.
    pub fn classify(&self, pair: Pair) -> Verdict {
        let (a, b) = self.facets(pair);
        let radiosity = self.accuracy.radiosity[pair.source as usize];
        let facing = Facing::between(a, b);
        if facing.averted() {
            return Verdict::Drop;
        }
        if radiosity <= 0.0 {
            return Verdict::Dark;
        }
        let allowed = self.accuracy.allowed(pair.target);
        let [cos_a, cos_b] = facing.cosines();
        let solid_angle = b.area * cos_b / (facing.gap * facing.gap).max(f32::MIN_POSITIVE);
        let form_factor = cos_a * (solid_angle / std::f32::consts::PI).min(1.0);
        let bound = radiosity * form_factor;
        let opening = (a.radius + b.radius) / facing.distance.max(f32::MIN_POSITIVE);
        let apart = opening < MAX_OPENING;
        let [size_a, size_b] = [a, b].map(|f| f64::from(f.radius / facing.distance));
        let truncation = |order| expected_error(order, size_b, size_a) as f32 * bound;
        let order = match apart && !facing.near {
            true => least_order(self.accuracy.order, allowed.into(), |p| {
                truncation(p).into()
            }),
            false => None,
        };
        if let (true, Some(order)) = (self.open && facing.full(), order) {
            return Verdict::Expand(order, truncation(order));
        }
        let settled = a.len() + b.len() <= MIXED_SURFELS || !facing.cut_by_place(opening);
        if self.open && apart && !facing.near && settled {
            let radiance = radiosity / std::f32::consts::PI;
            let to_all = radiance * b.area / (facing.gap * facing.gap);
            let cut = (to_all * cos_b * facing.cut(facing.target, opening)
                + to_all * cos_a * facing.cut(facing.source, opening))
            .min(bound);
            let error = cut + truncation(self.accuracy.order.min(MIXED_ORDER));
            if error <= allowed {
                return Verdict::Mixed(error);
            }
        }
        let expandable = !self.open && order.is_some();
        let uniform = !self.open && apart && bound * opening.max(0.3) <= allowed;
        let negligible = bound <= NEGLIGIBLE * allowed;

        if negligible || expandable || (uniform && !facing.full()) {
            let pairs = a.len() * b.len();
            let [least, most] = SAMPLES;
            let samples = |least| (0.5 * bound / allowed).ceil().clamp(least, most) as usize;
            let wanted = match negligible {
                true => NEGLIGIBLE_SAMPLES,
                false => samples(least),
            };
            let measured = samples(MEASURED).min(pairs);
            let exhaustive = pairs <= wanted;
            let drawn = wanted.min(pairs);
            let samples = if exhaustive {
                self.all_pairs(pair)
            } else {
                self.draw(pair, drawn, Purpose::SelectLinks)
            };
            // Two samples of a negligible link cannot show that all face each other.
            let all_face = facing.full() || !negligible && samples.iter().all(|s| s.weight > 0.0);
            return Verdict::Candidate(Candidate {
                exhaustive,
                negligible,
                drawn,
                measured,
                bound,
                allowed,
                smooth: expandable && all_face,
                order: self.accuracy.order,
                uniform: uniform || negligible,
                samples,
            });
        }
        match (a.is_leaf() && b.is_leaf(), self.open) {
            (true, true) => Verdict::Pairs(self.near_pairs(pair, &facing)),
            (true, false) => Verdict::Near(self.all_pairs(pair)),
            (false, _) => Verdict::Split,
        }
    }

    /// What the tested samples say of a candidate.
    pub fn decide(
        &self,
        pair: Pair,
        c: &Candidate,
        visible: &[bool],
        trial: &mut Trial,
    ) -> Outcome {
        let none_face = c.samples.iter().all(|s| s.weight == 0.0);
        if none_face && (c.negligible || c.exhaustive) {
            return Outcome::Drop;
        }
        if c.smooth {
            let seen = visible_weight(&c.samples, visible);
            let fraction = seen / c.samples.iter().map(|s| s.weight).sum::<f32>();
            let deviation = (fraction * (1.0 - fraction)).max(0.0).sqrt();
            if c.negligible || c.bound * deviation <= MAX_DEVIATION * c.allowed {
                return self.far(pair, c.order, &c.samples, visible, trial);
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
    pub fn measure(
        &self,
        pair: Pair,
        c: &Candidate,
        accepted: Outcome,
        samples: &[Sample],
        visible: &[bool],
        trial: &mut Trial,
    ) -> Outcome {
        match accepted {
            Outcome::Far(..) => self.far(pair, c.order, samples, visible, trial),
            Outcome::Sampled(_) => {
                let mean = visible_weight(samples, visible) / samples.len() as f32;
                Outcome::Sampled(self.kernel(pair, mean))
            }
            kept => kept,
        }
    }

    /// A far link. Its weight is the light seen by the samples relative to what the expansions give
    /// for the same samples. So the error of truncation, which has the same sign in most links and
    /// adds up, is left in the noise of the samples, which has not.
    fn far(
        &self,
        pair: Pair,
        order: usize,
        samples: &[Sample],
        visible: &[bool],
        trial: &mut Trial,
    ) -> Outcome {
        let expanded: f32 = samples
            .iter()
            .map(|&sample| trial.irradiance(self, pair, order, sample))
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
    pub fn draw(&self, pair: Pair, count: usize, purpose: Purpose) -> Vec<Sample> {
        const GOLDEN: f32 = 0.618_034;
        let (a, b) = self.facets(pair);
        let item = u64::from(pair.target) << 32 | u64::from(pair.source);
        let mut random = stream(self.accuracy.seed, purpose, item);
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

    /// The pairs of surfels that are near each other, with their form factors.
    fn near_pairs(&self, pair: Pair, facing: &Facing) -> Vec<Sample> {
        if !facing.near {
            return Vec::new();
        }
        let mut pairs = self.all_pairs(pair);
        pairs.retain(|s| {
            s.weight > 0.0 && self.surface.is_near(s.target as usize, s.source as usize)
        });
        pairs
    }

    /// All pairs of surfels.
    pub fn all_pairs(&self, pair: Pair) -> Vec<Sample> {
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

    pub fn facets(&self, pair: Pair) -> (&Facet, &Facet) {
        let facets = &self.octree.facets;
        (&facets[pair.target as usize], &facets[pair.source as usize])
    }
}

/// One pair of surfels, expanded.
pub(super) struct Trial<'a> {
    workspace: Workspace<'a, f32>,
    moments: Vec<Vec3A>,
    local: Vec<Vec3A>,
}

impl<'a> Trial<'a> {
    pub fn new(indices: &'a Indices) -> Self {
        let zeros = vec![Vec3A::ZERO; coefficients(indices.order())];
        Trial {
            workspace: Workspace::new(indices),
            moments: zeros.clone(),
            local: zeros,
        }
    }

    /// What an expansion of this order between two facets gives for a pair of their surfels.
    fn irradiance(&mut self, judge: &Judge, pair: Pair, order: usize, sample: Sample) -> f32 {
        let (a, b) = judge.facets(pair);
        let s = judge.surface;
        let (i, j) = (sample.target as usize, sample.source as usize);
        let Trial {
            workspace,
            moments,
            local,
        } = self;
        moments.fill(Vec3A::ZERO);
        local.fill(Vec3A::ZERO);
        let place = (s.positions[j] - b.centre) / b.scale();
        workspace.p2m(Vec3A::splat(s.areas[j]), s.normals[j], place, moments);
        let way = a.centre - b.centre;
        workspace.m2l(order, moments, way, [b.scale(), a.scale()], 1.0, local);
        let place = (s.positions[i] - a.centre) / a.scale();
        workspace.l2p(local, s.normals[i], place).x
    }
}

impl Candidate {
    /// Was it the samples that decided? Then they must not measure the link as well.
    pub fn selected(&self) -> bool {
        !self.exhaustive && !self.negligible
    }
}

impl Verdict {
    pub fn samples(&self) -> &[Sample] {
        match self {
            Verdict::Near(samples) => samples,
            Verdict::Candidate(c) => &c.samples,
            Verdict::Drop
            | Verdict::Dark
            | Verdict::Split
            | Verdict::Expand(..)
            | Verdict::Mixed(_)
            | Verdict::Pairs(_) => &[],
        }
    }
}

/// Sum of the weights of the visible samples.
fn visible_weight(samples: &[Sample], visible: &[bool]) -> f32 {
    let seen = samples.iter().zip(visible).filter(|&(_, &v)| v);
    seen.map(|(s, _)| s.weight).sum()
}
