//! What the work costs: seconds and bytes of its stages, from what is known beforehand.
//!
//! All constants are measured; `cargo bench --bench choices` holds them against what comes out.

use super::{MANY_RAYS, Sketch, Stage};
use crate::illuminate::{Method, RAYS, SPARED};
use crate::lights::{RECEIVERS, strata};

/// What the cost follows from.
#[derive(Clone)]
pub(super) struct Job {
    pub points: usize,
    pub surfels: usize,
    /// Whether normals have to be found first.
    pub normals: bool,
    pub tolerance: f64,
    pub open: bool,
    pub lamps: usize,
    pub threads: usize,
    /// Rays that are asked for.
    pub asked: Option<u32>,
    pub sketch: Sketch,
}

/// The stages with what they take.
pub(super) struct Cost {
    pub stages: Vec<Stage>,
}

/// Seconds of one core of an AMD EPYC, of which two were used. Where there are two values, the first is
/// for flat surfaces, the second for curved ones that are hidden from each other entirely.
mod seconds {
    /// A point whose normal is found.
    pub const NORMAL: f64 = 1e-5;
    /// A point that is prepared: neighbours, cell, noise.
    pub const PREPARE: f64 = 1.2e-5;
    /// A point that is thinned out.
    pub const THINNED: f64 = 4e-6;
    /// A point in the octree and among what is in the way.
    pub const OCTREE: f64 = 3e-6;
    /// A segment that lights take.
    pub const SEGMENT: [f64; 2] = [3.3e-7, 1.2e-6];
    /// A segment that links take, with those.
    pub const LINK: f64 = 1e-6;
    /// A point of 20,000 whose light is smoothed, with its neighbours; by this power of their number.
    pub const SMOOTH: f64 = 3.5e-5;
    pub const BY_SMOOTHED: f64 = -0.2;
    /// A point of 10,000 with its links where no segment is tested, at a tolerance of 0.03: of flat surfaces, and
    /// of curved ones; by these powers of their number and of 1 / tolerance. Where few shine, their light takes this
    /// part of it.
    pub const OPEN: [f64; 2] = [2.4e-5, 1e-4];
    pub const OPEN_BY_POINTS: [f64; 2] = [-0.4, -0.1];
    pub const OPEN_BY_TOLERANCE: f64 = 0.25;
    pub const OPEN_SHINING: f64 = 0.2;
    /// A point's light from 10,000 that all shine, at a tolerance of 0.03.
    pub const SHINING: f64 = 9e-5;
    /// A ray and its part in the solution, among 20,000 points; among more by this power of their number,
    /// as fewer of them are in the caches.
    pub const RAY: [f64; 2] = [9e-7, 1.2e-6];
    pub const BY_CACHES: f64 = 0.25;
    /// A pair of exact sums, and one where nothing is in the way of flat surfaces.
    pub const PAIR: [f64; 2] = [1.9e-7, 3.3e-7];
    pub const PAIR_IN_SIGHT: f64 = 1.3e-7;
    /// A verification at least, and a point of the parts that tell the error of the model.
    pub const VERIFIED: f64 = 0.08;
    pub const MODEL: f64 = 1.5e-5;
}

/// Bytes.
mod bytes {
    /// What the process has in any case.
    pub const LEAST: f64 = 10e6;
    /// A point while its cell is made, then the surfel; one that is thinned out.
    pub const PREPARE: f64 = 900.0;
    pub const THINNED: f64 = 120.0;
    /// A point in the octree and among what is in the way.
    pub const OCTREE: f64 = 240.0;
    /// A point whose light is smoothed, and a segment that links took, on average: most make none.
    pub const SMOOTH: f64 = 700.0;
    pub const SEGMENT: f64 = 4.0;
    /// A point's links where no segment is tested.
    pub const OPEN: f64 = 500.0;
    /// A point's light where all shine.
    pub const SHINING: f64 = 22e3;
    /// A ray: most meet a point that others meet too.
    pub const RAY: f64 = 17.0;
    /// A pair of exact sums.
    pub const PAIR: f64 = 4.0;
    /// A point of the parts that tell the error of the model.
    pub const MODEL: f64 = 1200.0;
}

/// Segments a point of 20,000 that links take at a tolerance of 0.03 and a contrast of 1: of flat
/// surfaces, of curved ones, and what of those grows with the fourth power of what is hidden.
const SEGMENTS: [f64; 3] = [30.0, 95.0, 15_000.0];
/// They grow as this power of the contrast,
const BY_CONTRAST: f64 = 0.6;
/// and fall as this power of the number of points, the less, the more of what is curved is hidden.
const BY_POINTS: f64 = 0.55;
const BY_HOLLOW: f64 = 0.57;
/// They grow as this power of 1 / tolerance, down to 0.03 and below, where more rounds are needed.
const BY_TOLERANCE: [f64; 2] = [0.7, 1.6];
/// Segments a point for light from surfels that shine.
const EMITTED: f64 = 5.0;
/// Light of surfaces that shine all over takes longer by these powers of 1 / tolerance and of the number
/// of points, and by the square of their part of all.
const BY_SHINING: [f64; 2] = [0.25, 0.3];
/// Upper bound of the error of the reflected light that one ray leaves, in units of the contrast, when what
/// it brings is smoothed over 10,000 points, and the powers of their number by which it falls: up to there, and
/// beyond.
const NOISE: f64 = 0.65;
const BY_SMOOTHING: [f64; 2] = [0.2, 0.1];
/// The noise of bright spots is not made smooth that well: it counts so many times.
const SPOTS: f64 = 1.04;
/// The noise of rays falls as this power of their number.
pub(super) const BY_RAYS: f64 = 0.75;
/// What rays without number are off by among 3,000 points where all is curved and hidden, the power of what
/// is hidden, and that of the number of points by which it falls, which is the less the more is hidden. With spots
/// apart 5% in the cave of 1,750 points, 2.7% in that of 10,500, 2% in that of 17,500; 2.3% in organic of 3,000,
/// 1.4% of 5,000, .5% of 10,000.
const LIMIT: f64 = 0.097;
const BY_HIDDEN: f64 = 0.7;
const LIMIT_FALLS: [f64; 2] = [1.85, 3.1];
const LEAST_FALL: f64 = 0.3;
/// When bright spots are sampled apart, no less than this part of it is left.
const LEAST_LEFT: f64 = 0.75;
/// Part of the tolerance that this may be.
const LARGEST_LIMIT: f64 = 0.8;
/// Fewest rays that are worth while.
const LEAST_RAYS: f64 = 16.0;
/// Points of the parts that tell the error of the model, at most.
const MODEL: f64 = 10_000.0;

impl Cost {
    pub fn seconds(&self) -> f64 {
        self.stages.iter().map(|stage| stage.seconds).sum()
    }

    pub fn bytes(&self) -> u64 {
        self.stages.iter().map(|stage| stage.bytes).sum()
    }
}

impl Job {
    /// Rays from each surfel that bring the error within the tolerance; `None` where none do: rays see
    /// cells, which stand out from hollows and bumps as points do not.
    pub fn rays(&self) -> Option<u32> {
        self.asked.or_else(|| self.rays_for(self.apart()))
    }

    /// The same where spots are sampled apart, or not.
    fn rays_for(&self, apart: bool) -> Option<u32> {
        let Sketch {
            hidden,
            curved,
            contrast,
            left,
            ..
        } = self.sketch;
        let limit = LIMIT * curved * hidden.powf(BY_HIDDEN);
        let limit = limit * if apart { left.max(LEAST_LEFT) } else { 1.0 };
        let [smooth, rough] = LIMIT_FALLS;
        let falls = (smooth - rough * hidden).max(LEAST_FALL);
        let limit = limit * (self.surfels as f64 / 3e3).powf(-falls);
        let tolerance = self.of_reflected();
        if contrast == 0.0 || limit > LARGEST_LIMIT * tolerance {
            return None;
        }
        let noise = (tolerance * tolerance - limit * limit).sqrt();
        let rays = self.for_noise(noise, apart);
        (rays <= f64::from(*RAYS.end())).then_some(rays as u32)
    }

    /// Rays to begin with where no number of them is expected to do: as many as would do with the largest limit.
    pub fn tried(&self) -> u32 {
        let noise = self.of_reflected() * (1.0 - LARGEST_LIMIT * LARGEST_LIMIT).sqrt();
        self.for_noise(noise, true).min(f64::from(MANY_RAYS)) as u32
    }

    /// Rays whose noise is no more than this.
    fn for_noise(&self, noise: f64, apart: bool) -> f64 {
        let Sketch { contrast, left, .. } = self.sketch;
        let points = self.surfels as f64 / 1e4;
        let [below, above] = BY_SMOOTHING;
        let smoothed = points.powf(if points < 1.0 { -below } else { -above });
        let of_spots = match apart {
            true => 0.0,
            false => SPOTS * (1.0 - left * left).sqrt(),
        };
        let of_one = NOISE * contrast * of_spots.hypot(smoothed * left);
        let rays = (of_one / noise).powf(1.0 / BY_RAYS);
        rays.max(LEAST_RAYS).log2().round().exp2()
    }

    /// The tolerance of reflected light, relative to itself.
    fn of_reflected(&self) -> f64 {
        self.tolerance / self.sketch.reflected.max(self.tolerance)
    }

    /// Whether nothing seems to be in the way.
    pub fn in_sight(&self) -> bool {
        self.sketch.hidden == 0.0
    }

    /// Whether bright spots are sampled apart, so that fewer rays do.
    pub fn apart(&self) -> bool {
        let spared = 1.0 - self.sketch.left.powf(1.0 / BY_RAYS);
        let rays = self
            .asked
            .or_else(|| self.rays_for(false))
            .unwrap_or(*RAYS.end());
        self.sketch.contrast > 0.0 && f64::from(rays) * spared >= SPARED
    }

    /// What a method takes.
    pub fn cost(&self, method: Method, rays: u32) -> Cost {
        let (points, n) = (self.points as f64, self.surfels as f64);
        let thinned = points - n;
        let hollow = self.sketch.curved * self.sketch.hidden;
        let between = |[flat, all]: [f64; 2]| flat + (all - flat) * hollow;
        let lights = n * self.lights();
        let shining = match self.open {
            true => 0.0,
            false => n * self.sketch.shining.powi(2),
        };
        let clusters = (0.03 / self.tolerance).powf(BY_SHINING[0]) * (n / 1e4).powf(BY_SHINING[1]);
        let segment = between(seconds::SEGMENT);
        let reflects = self.sketch.contrast > 0.0;
        let pair = match self.in_sight() && self.sketch.curved == 0.0 {
            true => seconds::PAIR_IN_SIGHT,
            false => between(seconds::PAIR),
        };
        let (work, held) = match method {
            Method::Direct => (n * n * pair, n * n * bytes::PAIR),
            Method::Classic => (2.0 * n * n * pair, n * n * bytes::PAIR),
            Method::Gather => {
                let spots = if self.apart() { SPARED } else { 0.0 };
                let ray = between(seconds::RAY) * (n / 2e4).max(1.0).powf(seconds::BY_CACHES);
                let rays = f64::from(rays);
                (n * (rays + spots) * ray, n * rays * bytes::RAY)
            }
            Method::Fmm | Method::Auto if self.open => {
                // What shines has links of its own.
                let [reflected, emitted] = [reflects, self.sketch.shining > 0.0].map(f64::from);
                let few = seconds::OPEN_SHINING;
                let shining = emitted * (few + (1.0 - few) * self.sketch.shining);
                let links = n * (reflected + emitted);
                (
                    n * (reflected + shining) * self.without_tests(),
                    links * bytes::OPEN,
                )
            }
            Method::Fmm | Method::Auto if !reflects => (0.0, 0.0),
            Method::Fmm | Method::Auto => {
                let segments = n * self.segments();
                (segments * seconds::LINK, segments * bytes::SEGMENT)
            }
        };
        let smoothed = match method {
            Method::Fmm | Method::Gather if reflects && !self.open => n,
            _ => 0.0,
        };
        let smooth = seconds::SMOOTH * (n / 2e4).powf(seconds::BY_SMOOTHED);
        let model = match method {
            Method::Fmm | Method::Gather => n.min(MODEL),
            _ => 0.0,
        };
        let verified = match method {
            Method::Fmm | Method::Gather => seconds::VERIFIED + model * seconds::MODEL,
            _ => 0.0,
        };
        let stage = |name, seconds: f64, bytes: f64| Stage {
            name,
            seconds: seconds / self.threads as f64,
            bytes: bytes as u64,
        };
        let mut stages = vec![
            stage(
                "prepare",
                n * seconds::PREPARE + thinned * seconds::THINNED,
                bytes::LEAST + n * bytes::PREPARE + thinned * bytes::THINNED,
            ),
            stage("octree", n * seconds::OCTREE, n * bytes::OCTREE),
            stage(
                "lights",
                lights * segment + shining * clusters * seconds::SHINING,
                shining.min(RECEIVERS as f64) * clusters * bytes::SHINING,
            ),
            stage("links", work, held),
            stage("smoothing", smoothed * smooth, smoothed * bytes::SMOOTH),
            stage("verification", verified, model * bytes::MODEL),
        ];
        if self.normals {
            stages.insert(0, stage("normals", points * seconds::NORMAL, 0.0));
        }
        Cost { stages }
    }

    /// Segments a point that its lights take.
    fn lights(&self) -> f64 {
        let sky = if self.sketch.sky {
            strata(self.tolerance, true).pow(2) as f64
        } else {
            0.0
        };
        let emitted = if self.sketch.shining > 0.0 {
            EMITTED
        } else {
            0.0
        };
        self.lamps as f64 + sky + emitted
    }

    /// Seconds of a point's links where no segment is tested.
    fn without_tests(&self) -> f64 {
        let curved = self.sketch.curved;
        let [flat, bent] = seconds::OPEN;
        let [of_flat, of_bent] = seconds::OPEN_BY_POINTS;
        let by_points = of_flat + (of_bent - of_flat) * curved;
        flat.powf(1.0 - curved)
            * bent.powf(curved)
            * (self.surfels as f64 / 1e4).powf(by_points)
            * (0.03 / self.tolerance).powf(seconds::OPEN_BY_TOLERANCE)
    }

    /// Segments a point that links take.
    fn segments(&self) -> f64 {
        let Sketch {
            hidden,
            curved,
            contrast,
            ..
        } = self.sketch;
        let [flat, bent, of_hidden] = SEGMENTS;
        let bent = bent + of_hidden * hidden.powi(4);
        let by_points = (BY_POINTS - BY_HOLLOW * curved * hidden).max(0.0);
        let of_scene = flat.powf(1.0 - curved)
            * bent.powf(curved)
            * (self.surfels as f64 / 2e4).powf(-by_points)
            * contrast.powf(BY_CONTRAST);
        let ratio = 0.03 / self.of_reflected();
        let [above, below] = BY_TOLERANCE;
        let by_tolerance = ratio.powf(if ratio > 1.0 { below } else { above });
        // More than all pairs there are not.
        (of_scene * by_tolerance).min(0.5 * self.surfels as f64)
    }

    /// The most points, thinned out of these, for which a method takes no more than so much memory.
    pub fn most_points(&self, method: Method, rays: u32, free: u64) -> usize {
        let fits = |surfels: usize| {
            let job = Job {
                surfels,
                ..self.clone()
            };
            job.cost(method, rays).bytes() <= free
        };
        let (mut fit, mut too_many) = (0, self.surfels);
        while too_many - fit > 1 {
            let middle = fit.midpoint(too_many);
            match fits(middle) {
                true => fit = middle,
                false => too_many = middle,
            }
        }
        fit
    }
}
