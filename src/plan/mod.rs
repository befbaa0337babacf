//! What a solve will do, why, and what it will take: decided before the work starts.
//!
//! [`illuminate()`](crate::illuminate()) follows a plan, and returns it in its
//! [`Stats`](crate::Stats); `fmmgi-gpu plan` prints it. It is made from the number of points, a look at
//! a thousand of them, and costs measured once (see `cost`).

mod choose;
mod cost;
mod sketch;

use std::collections::HashSet;
use std::fmt;

use serde::Serialize;

pub(crate) use self::choose::named;
use self::choose::{Way, choose, expansions};
use self::cost::{BY_RAYS, Job};
pub use self::sketch::Sketch;
use crate::error::{Error, Result};
use crate::illuminate::{Backend, Method, Occlusion, Options, check, tolerance};
use crate::memory;
use crate::points::Thinning;
use crate::scene::Scene;

/// What will be done, why, and what it will take.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Plan {
    /// Points of the cloud.
    pub points: usize,
    /// Points that are expected to take part in the transport, at most.
    pub surfels: usize,
    /// How the operator is applied, never `Auto`.
    pub method: Method,
    /// Relative error that is asked for.
    pub tolerance: f64,
    /// Largest order of the expansions, with the methods that have some.
    pub order: Option<usize>,
    /// Surfels in a leaf of the octree, at most.
    pub leaf_size: usize,
    /// Rays from each surfel that are expected, with the method `Gather`: as many are cast as the measured
    /// error asks for.
    pub rays: Option<u32>,
    /// Whether links are tested: they are not where nothing seems to be in the way.
    pub visibility: Occlusion,
    /// What follows rays that turn out to be in vain, or links without tests that something is in the way of, if
    /// the choice is ours.
    pub instead: Option<Method>,
    /// Rays from each surfel beyond which that follows in any case.
    pub most_rays: Option<u32>,
    /// Whether the light of bright spots is sampled apart from them.
    pub spots_apart: bool,
    /// Where the passes run: "cpu" or "gpu".
    pub backend: String,
    pub threads: usize,
    /// What was decided, each with its reason.
    pub choices: Vec<Choice>,
    /// What each stage takes, as they follow each other.
    pub stages: Vec<Stage>,
    /// Seconds that they take together.
    pub seconds: f64,
    /// Most memory that they hold at one time, beside the points.
    pub bytes: u64,
    /// Memory that is free, where the system tells.
    pub free_bytes: Option<u64>,
    /// Points that would fit into it, if these do not.
    pub points_that_fit: Option<usize>,
}

/// A decision.
#[derive(Clone, Debug, Serialize)]
pub struct Choice {
    /// What was to be decided.
    pub what: &'static str,
    pub taken: String,
    pub why: String,
}

/// A part of the work.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stage {
    /// As in [`Seconds`](crate::illuminate::stats::Seconds), where links hold their tests too.
    pub name: &'static str,
    pub seconds: f64,
    /// What it adds to the memory that is held.
    pub bytes: u64,
}

/// Order of the expansions of links whose visibility is sampled: that is what limits their accuracy.
pub(crate) const ORDER: usize = 1;
/// Rays that a cost is told for where no number of them is expected to do, and to begin with there at most.
const MANY_RAYS: u32 = 256;

impl Plan {
    /// Plans [`illuminate()`](crate::illuminate()), or the first light of a [`Transport`](crate::Transport), for a cloud, whose normals must be there.
    ///
    /// # Errors
    /// [`Error::Usage`] for options that do not fit together, [`Error::Invalid`] for numbers that no
    /// light can have.
    pub fn new(scene: &Scene, options: &Options, backend: &Backend) -> Result<Plan> {
        Plan::within(scene, options, backend, memory::available())
    }

    /// The same where so many bytes of memory are free; `None` if that is not known.
    ///
    /// # Errors
    /// Those of [`new`](Plan::new).
    pub fn within(
        scene: &Scene,
        options: &Options,
        backend: &Backend,
        free: Option<u64>,
    ) -> Result<Plan> {
        check(scene, options, backend)?;
        let tolerance = tolerance(scene, options);
        let surfels = surfels(scene, &thinning(options, tolerance));
        let open = options.occlusion == Occlusion::None;
        let mut sketch = Sketch::of(scene, open, options.seed);
        if options.max_bounces.is_some() {
            sketch.left = 1.0; // then spots are not sampled apart
        }
        let job = Job {
            points: scene.cloud.len(),
            surfels,
            normals: scene.cloud.normals.len() < scene.cloud.len(),
            tolerance,
            open,
            lamps: scene.lights.len(),
            threads: rayon::current_num_threads(),
            asked: options.rays.map(u32::next_power_of_two),
            sketch,
        };
        let Way {
            method,
            visibility,
            instead,
            most_rays,
            why,
        } = choose(options, backend, &job, free);
        let job = Job {
            open: visibility == Occlusion::None,
            ..job
        };
        let (order, leaf_size) = expansions(options, method, &job, backend)?;
        let rays = job.rays().unwrap_or(MANY_RAYS);
        let cost = job.cost(method, rays);
        let plan = Plan {
            points: job.points,
            surfels,
            method,
            tolerance,
            order: expanded(method).then_some(order),
            leaf_size,
            rays: (method == Method::Gather).then(|| job.rays().unwrap_or_else(|| job.tried())),
            visibility,
            instead,
            most_rays,
            spots_apart: method == Method::Gather && job.apart(),
            backend: match backend {
                Backend::Cpu => "cpu".into(),
                Backend::Gpu { .. } => "gpu".into(),
            },
            threads: job.threads,
            choices: Vec::new(),
            seconds: cost.seconds(),
            bytes: cost.bytes(),
            points_that_fit: free
                .filter(|&free| cost.bytes() > free)
                .map(|free| job.most_points(method, rays, free)),
            stages: cost.stages,
            free_bytes: free,
        };
        Ok(Plan {
            choices: plan.explained(options, scene, &job, why),
            ..plan
        })
    }

    /// Fails with [`Error::TooLarge`] where the work would not fit into the memory that is free.
    pub fn check(&self) -> Result<()> {
        let (Some(free), Some(fit)) = (self.free_bytes, self.points_that_fit) else {
            return Ok(());
        };
        let way_out = match fit {
            0 => "preparing so many points alone does not fit".to_owned(),
            fit => format!("take fewer points (--max-points {fit} fits) or a larger tolerance"),
        };
        Err(Error::TooLarge(format!(
            "{} points to a tolerance of {} need about {} of memory, but only {} are free: {way_out}",
            self.surfels,
            self.tolerance,
            mebibytes(self.bytes),
            mebibytes(free)
        )))
    }

    /// The decisions in words.
    fn explained(&self, options: &Options, scene: &Scene, job: &Job, why: String) -> Vec<Choice> {
        let choice = |what, taken: &dyn fmt::Display, why: &str| Choice {
            what,
            taken: taken.to_string(),
            why: why.to_owned(),
        };
        let mut choices = vec![Choice {
            what: "method",
            taken: format!("{:?}", self.method).to_lowercase(),
            why,
        }];
        if let Some(order) = self.order {
            choices.push(choice(
                "order",
                &order,
                match (options.order, job.open || self.method == Method::Classic) {
                    (Some(_), _) => "asked for",
                    (None, true) => "what the tolerance needs",
                    (None, false) => "tested visibility limits the accuracy, not the expansion",
                },
            ));
            choices.push(choice(
                "leaf size",
                &self.leaf_size,
                match job.open {
                    true => "expansions of this order cost as much as so many surfels",
                    false => "larger leaves would have shadows within",
                },
            ));
        }
        if let Some(rays) = self.rays {
            choices.push(match options.rays {
                Some(_) => choice("rays", &rays, "asked for"),
                None => choice(
                    "rays",
                    &rays,
                    &format!(
                        "or as many as the measured error asks for: the light of one deviates {:.1} times \
                         from that of all",
                        job.sketch.contrast
                    ),
                ),
            });
        }
        if self.spots_apart {
            let more = job.sketch.left.powf(-1.0 / BY_RAYS);
            let why = format!("with them it would take {more:.1} times as many rays");
            choices.push(choice("spots", &"apart", &why));
        }
        choices.push(match (job.open, options.occlusion) {
            (true, Occlusion::None) => choice("visibility", &"none", "asked for"),
            (true, Occlusion::Surfels) => choice(
                "visibility",
                &"none",
                "nothing seems to be in the way, and tests would take longer; the verification has them",
            ),
            (false, _) => choice(
                "visibility",
                &"surfels",
                &match job.sketch.hidden {
                    0.0 => {
                        "nothing seems to be in the way, and then tests take next to no time".into()
                    }
                    hidden => format!(
                        "{:.0}% of the lines between points that face each other are blocked",
                        100.0 * hidden
                    ),
                },
            ),
        });
        choices.push(match options.max_bounces {
            Some(bounces) => choice("bounces", &bounces, "asked for"),
            None if job.sketch.contrast == 0.0 => choice("bounces", &0, "no light is reflected"),
            None => choice(
                "bounces",
                &"all",
                "until what is left is small against the tolerance",
            ),
        });
        let has_use = matches!(self.method, Method::Fmm | Method::Gather) && self.backend == "cpu";
        let (colours, why) = match (scene.is_grey(), has_use) {
            (true, true) => ("one", "all light and all surfaces are grey"),
            (true, false) => (
                "three",
                "all is grey, but only links and rays on the CPU have use for that",
            ),
            (false, _) => ("three", "not all is grey"),
        };
        choices.push(choice("colours", &colours, why));
        choices.push(match self.method {
            Method::Direct => choice("precision", &"f64", "exact sums are the reference"),
            _ => choice("precision", &"f32", "it rounds light by a millionth or so"),
        });
        choices
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(
            f,
            "points      {}, of which {} are expected to take part in the transport",
            self.points, self.surfels
        )?;
        writeln!(f, "tolerance   {}", self.tolerance)?;
        for choice in &self.choices {
            writeln!(f, "{:<11} {}: {}", choice.what, choice.taken, choice.why)?;
        }
        writeln!(f, "backend     {}, {} threads", self.backend, self.threads)?;
        let stages: Vec<String> = (self.stages.iter())
            .map(|stage| format!("{} {:.2}", stage.name, stage.seconds))
            .collect();
        writeln!(
            f,
            "time        about {:.2} s ({})",
            self.seconds,
            stages.join(", ")
        )?;
        let free = self.free_bytes.map_or(String::new(), |free| {
            format!(", of {} that are free", mebibytes(free))
        });
        write!(
            f,
            "memory      about {} beside the points{free}",
            mebibytes(self.bytes)
        )
    }
}

fn mebibytes(bytes: u64) -> String {
    format!("{} MiB", bytes.div_ceil(1 << 20))
}

/// Whether a method has expansions.
pub(crate) fn expanded(method: Method) -> bool {
    matches!(method, Method::Fmm | Method::Classic)
}

/// Part of the cells of a grid on a surface that thinning to its spacing leaves a point in: measured are
/// 0.54 to 0.62 in cornell and organic.
const LEFT: f64 = 0.58;

/// Fewer points to do the work with: where nothing is told, as many as are enough. Without occlusion, a
/// point more takes next to nothing.
pub(crate) fn thinning(options: &Options, tolerance: f64) -> Thinning {
    Thinning {
        enough_for: (options.occlusion == Occlusion::Surfels).then_some(tolerance),
        ..options.thinning
    }
}

/// Points that are expected to take part in the transport.
fn surfels(scene: &Scene, thinning: &Thinning) -> usize {
    let positions = &scene.cloud.positions;
    let most = thinning.most(positions.len());
    let most = most.unwrap_or(usize::MAX).min(positions.len());
    match thinning.spacing {
        None => most,
        Some(spacing) => {
            let cells: HashSet<_> = (positions.iter())
                .map(|p| (*p / spacing).floor().as_i64vec3())
                .collect();
            most.min((LEFT * cells.len() as f64).ceil() as usize)
        }
    }
}
