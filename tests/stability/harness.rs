//! Cases, the ways that they are lit by, and what is measured and expected of each.

use std::fmt;
use std::sync::Mutex;

use fmmgi_gpu::compare::compare;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Backend, Illumination, Method, Options, PointCloud, Result, Scene, illuminate};
use glam::Vec3;

use crate::common::gpu;

/// Tolerance of all cases.
pub const TOLERANCE: f64 = 0.03;

/// Bounds hold in 19 of 20 cases: a little above one is no fault.
const SLACK: f64 = 1.2;
/// An error that is not told from none.
const NOTHING: f64 = 1e-3;

/// A method on a backend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Way {
    Direct,
    Fmm,
    Device,
    Gather,
    Classic,
}

pub const WAYS: [Way; 5] = [
    Way::Direct,
    Way::Fmm,
    Way::Device,
    Way::Gather,
    Way::Classic,
];

impl fmt::Display for Way {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Way::Direct => "direct",
            Way::Fmm => "fmm",
            Way::Device => "fmm on a device",
            Way::Gather => "gather",
            Way::Classic => "classic",
        })
    }
}

impl Way {
    fn light(self, scene: &Scene, tolerance: f64) -> Result<Illumination> {
        let method = match self {
            Way::Direct => Method::Direct,
            Way::Fmm | Way::Device => Method::Fmm,
            Way::Gather => Method::Gather,
            Way::Classic => Method::Classic,
        };
        let options = Options {
            method,
            tolerance: Some(tolerance),
            below_model: true,
            seed: 1,
            ..Options::default()
        };
        let backend = match self {
            Way::Device => Backend::Gpu {
                device: &gpu().device,
                queue: &gpu().queue,
                adapter: "test",
            },
            _ => Backend::Cpu,
        };
        illuminate(scene, &options, backend, &Silent)
    }
}

/// Irradiance of a cloud by exact sums, red.
pub fn sums(cloud: &PointCloud) -> Vec<f64> {
    let scene = Scene {
        cloud: cloud.clone(),
        ..Scene::default()
    };
    let lit = Way::Direct.light(&scene, 1e-6).expect("a solution");
    lit.map.irradiance.iter().map(|h| f64::from(h.x)).collect()
}

/// What a case is measured against.
pub enum Truth {
    /// Exact sums over the same points.
    Sums,
    /// Irradiance of the points, the same in all channels; NaN where it is not compared.
    Known(Vec<f64>),
}

/// What is to be expected of a way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Expected {
    /// Solved, and the light off by at most this (relative L2).
    Within(f64),
    /// It says that the equation is not solved; what is written is light.
    Unsolved,
    /// It says that the tolerance is not met.
    NotMet,
    /// Refused with a message that has this in it.
    Refused(&'static str),
    /// A known issue: off by more than this, and called solved.
    Wrong(f64),
}

pub use Expected::*;

pub struct Case {
    pub name: String,
    pub scene: Scene,
    pub truth: Truth,
    /// By way.
    pub expected: [Expected; WAYS.len()],
    /// Why it is so, and what to do, in words.
    pub remedy: &'static str,
}

impl Case {
    pub fn new(name: impl Into<String>, scene: impl Into<Lit>, truth: Truth) -> Case {
        Case {
            name: name.into(),
            scene: scene.into().0,
            truth,
            expected: [Within(TOLERANCE); WAYS.len()],
            remedy: "",
        }
    }

    /// What is expected of all ways.
    pub fn expect(mut self, expected: Expected) -> Case {
        self.expected = [expected; WAYS.len()];
        self
    }

    /// What is expected of one.
    pub fn but(mut self, way: Way, expected: Expected) -> Case {
        self.expected[way as usize] = expected;
        self
    }

    pub fn is_known_issue(&self, way: Way) -> bool {
        matches!(self.expected[way as usize], Wrong(_))
    }

    pub fn remedy(mut self, remedy: &'static str) -> Case {
        self.remedy = remedy;
        self
    }
}

/// A scene, or a cloud that is one.
pub struct Lit(Scene);

impl From<Scene> for Lit {
    fn from(scene: Scene) -> Lit {
        Lit(scene)
    }
}

impl From<PointCloud> for Lit {
    fn from(cloud: PointCloud) -> Lit {
        Lit(Scene {
            cloud,
            ..Scene::default()
        })
    }
}

/// Relative L2, 99th percentile and bias of errors; where all should be dark, the most light.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    pub l2: f64,
    pub p99: f64,
    pub bias: f64,
}

/// What came of a case by one way.
pub struct Outcome {
    pub way: Way,
    pub found: std::result::Result<Found, String>,
    /// Processor seconds.
    pub seconds: f64,
}

pub struct Found {
    /// All of it is finite and none negative.
    pub is_light: bool,
    pub errors: Errors,
    /// Relative L2 error against exact sums over the same points.
    pub against_sums: Option<f64>,
    /// Upper bound of that error, by the solve itself.
    pub bound: Option<f64>,
    /// Mean part of its surroundings that a point sees.
    pub row_sum: Option<f64>,
    pub solved: bool,
    pub met: bool,
}

impl Found {
    fn new(case: &Case, lit: &Illumination, sums: Option<&[Vec3]>) -> Found {
        let light = &lit.map.irradiance;
        let against_sums = sums.map(|sums| errors(light, sums));
        Found {
            is_light: light
                .iter()
                .all(|h| h.is_finite() && h.min_element() >= 0.0),
            errors: match &case.truth {
                Truth::Sums => against_sums.expect("exact sums"),
                Truth::Known(truth) => {
                    let truth: Vec<Vec3> = truth.iter().map(|&h| Vec3::splat(h as f32)).collect();
                    errors(light, &truth)
                }
            },
            against_sums: against_sums.map(|e| e.l2),
            bound: lit.stats.error.map(|e| e.bound()),
            row_sum: lit.stats.row_sum.map(|sum| sum.mean),
            solved: lit.stats.converged,
            met: lit.stats.met(),
        }
    }
}

fn errors(found: &[Vec3], truth: &[Vec3]) -> Errors {
    let pairs = found.iter().zip(truth).filter(|(_, h)| !h.is_nan());
    let (found, truth): (Vec<Vec3>, Vec<Vec3>) = pairs.unzip();
    match compare(&found, &truth) {
        Ok(c) => Errors {
            l2: c.rel_l2,
            p99: c.p99,
            bias: c.bias,
        },
        Err(_) => {
            let most = found.iter().map(|h| f64::from(h.max_element()));
            let most = most.fold(0.0, f64::max);
            Errors {
                l2: most,
                p99: most,
                bias: most,
            }
        }
    }
}

/// Processor seconds of this process.
fn cpu_seconds() -> f64 {
    // SAFETY: the structure is plain numbers, which the call fills.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_SELF, &mut usage);
        usage
    };
    let seconds = |t: libc::timeval| t.tv_sec as f64 + 1e-6 * t.tv_usec as f64;
    seconds(usage.ru_utime) + seconds(usage.ru_stime)
}

/// Lights a case by all ways.
pub fn run(case: &Case) -> Vec<Outcome> {
    // One at a time, so that their seconds are their own.
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE
        .lock()
        .unwrap_or_else(|poisoned| poisoned.into_inner());
    let sums = Way::Direct.light(&case.scene, 1e-6);
    let sums = sums.ok().map(|lit| lit.map.irradiance);
    let outcome = |&way: &Way| {
        let before = cpu_seconds();
        let lit = way.light(&case.scene, TOLERANCE);
        let seconds = cpu_seconds() - before;
        let found = lit
            .map(|lit| Found::new(case, &lit, sums.as_deref()))
            .map_err(|error| error.to_string());
        Outcome {
            way,
            found,
            seconds,
        }
    };
    WAYS.iter().map(outcome).collect()
}

impl Outcome {
    /// One line.
    pub fn line(&self, case: &Case) -> String {
        let what = match &self.found {
            Err(refused) => format!("refused: {refused}"),
            Ok(found) => {
                let Errors { l2, p99, bias } = found.errors;
                let or_none = |x: Option<f64>| x.map_or("-".into(), |x| format!("{x:.1e}"));
                let [sums, bound, row_sum] =
                    [found.against_sums, found.bound, found.row_sum].map(or_none);
                let solved = if found.solved { "" } else { ", not solved" };
                let met = if found.met { "" } else { ", tolerance not met" };
                format!(
                    "L2 {l2:.1e}, p99 {p99:.1e}, bias {bias:+.1e}; against sums {sums}, said at most \
                     {bound}, row sum {row_sum}{solved}{met}"
                )
            }
        };
        format!(
            "{} | {}: {what} | {:.2} s CPU",
            case.name, self.way, self.seconds
        )
    }

    /// What came out otherwise than expected.
    pub fn complaint(&self, case: &Case) -> Option<String> {
        let expected = case.expected[self.way as usize];
        let complain = |what: &str| Some(format!("{}: {what}, {expected:?}", self.line(case)));
        let found = match (&self.found, expected) {
            (Err(message), Refused(text)) if message.contains(text) => return None,
            (Err(_), _) => return complain("refused"),
            (Ok(found), _) => found,
        };
        let as_expected = match expected {
            Within(most) => found.solved && found.errors.l2 <= most,
            Unsolved => !found.solved,
            NotMet => !found.met,
            Wrong(least) => found.solved && found.errors.l2 > least,
            Refused(_) => false,
        };
        if !as_expected {
            return complain("not as expected (a known issue that is mended is none any more)");
        }
        if !found.is_light && !case.is_known_issue(self.way) {
            return complain("no light");
        }
        // What fmm says of its own error is true, whatever comes out.
        let (true, Some(sums), Some(bound)) = (
            matches!(self.way, Way::Fmm | Way::Device) && found.solved && found.is_light,
            found.against_sums,
            found.bound,
        ) else {
            return None;
        };
        if sums > SLACK * bound.max(NOTHING) {
            return complain("its error is underrated");
        }
        match found.met && sums > TOLERANCE {
            true => complain("said to be met"),
            false => None,
        }
    }
}
