//! What is to be lit, and how: the arguments that "solve" and "plan" have in common.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::ValueEnum;
use fmmgi_gpu::illuminate::RAYS;
use fmmgi_gpu::points::{Facing, Thinning};
use fmmgi_gpu::scene::{PointLight, SceneOptions};
use fmmgi_gpu::{Error, Method, Occlusion, Options, Progress, Result, Scene};
use glam::Vec3;

use super::backend::{self, Chosen};
use super::reading::Reading;
use super::{outputs, values};

#[derive(clap::Args)]
pub struct Asked {
    /// Scans, and at most one scene file (.toml)
    #[arg(required = true)]
    pub inputs: Vec<PathBuf>,
    /// Points to make on the shapes of a scene file, and on a mesh
    #[arg(long, value_name = "N")]
    points: Option<NonZeroUsize>,
    #[command(flatten)]
    reading: Reading,
    /// How the light is summed up
    #[arg(long, value_enum, default_value = "auto")]
    method: MethodArg,
    /// Where the work is done
    #[arg(long, value_enum, default_value = "auto")]
    backend: backend::Choice,
    /// GPU to use: its number in "adapters", or a part of its name
    #[arg(long, value_name = "NAME|INDEX")]
    adapter: Option<String>,
    /// Relative error to aim at, 1e-6 to 0.5 [default: the scene's, or 0.03]
    #[arg(long, value_name = "T", value_parser = values::tolerance, allow_hyphen_values = true)]
    tolerance: Option<f64>,
    /// Largest order of the expansions, up to 12, on a GPU to 6 [default: 1, as the tolerance
    /// needs without occlusion 3 to 6, for classic 2 to 6]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u8).range(0..=12))]
    order: Option<u8>,
    /// Rays from each point with --method gather, rounded up to a power of two [default: as many as the
    /// tolerance needs]
    #[arg(long, value_name = "N", value_parser = rays())]
    rays: Option<u32>,
    /// What stands in the way of light
    #[arg(long, value_enum, default_value = "surfels")]
    visibility: VisibilityArg,
    /// Bounces to follow; 0 is direct light alone [default: until nothing changes]
    #[arg(long, value_name = "N")]
    max_bounces: Option<u32>,
    /// Refine even where the points themselves allow no such accuracy
    #[arg(long)]
    below_model: bool,
    /// Threads to use [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Seed of everything random
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Add a point light with a radiant intensity (1,1,1 if left out); can be given several times
    #[arg(long, value_name = "point:X,Y,Z[:R,G,B]", value_parser = values::light)]
    pub light: Vec<PointLight>,
    /// Irradiance that an open plane gets from a uniform sky, instead of the scene's
    #[arg(long, value_name = "R,G,B", value_parser = values::rgb, allow_hyphen_values = true)]
    pub sky: Option<Vec3>,
    /// To which side the normals point that a scan lacks: auto, inward (a room), outward (an object),
    /// or viewpoint:X,Y,Z from where all was seen; where it lacks none, inward and outward turn all of
    /// them if need be
    #[arg(long, value_name = "SIDE", value_parser = values::facing, default_value = "auto")]
    pub normals: Facing,
    /// Thin out to this distance between points; those left out take the light of the others
    #[arg(long, value_name = "S", value_parser = values::positive)]
    spacing: Option<f64>,
    /// Thin out evenly to no more than this many points; without it, and without --spacing, clouds of many
    /// more points than the tolerance needs (300,000 at 0.03) are thinned out to as many
    #[arg(long, value_name = "N")]
    max_points: Option<NonZeroUsize>,
}

#[derive(Clone, Copy, ValueEnum)]
enum MethodArg {
    /// Exact sum over all pairs, for small clouds
    Direct,
    /// Fast multipole method
    Fmm,
    /// Multipole method with the visibility of Goradia's report, which tests all pairs of points
    Classic,
    /// Monte Carlo: rays from every point
    Gather,
    /// What is cheaper
    Auto,
}

#[derive(Clone, Copy, ValueEnum)]
enum VisibilityArg {
    /// The points' pieces of surface
    Surfels,
    /// Nothing
    None,
}

/// As many as a surfel can cast.
fn rays() -> clap::builder::RangedI64ValueParser<u32> {
    let [least, most] = [RAYS.start(), RAYS.end()].map(|&n| i64::from(n));
    clap::value_parser!(u32).range(least..=most)
}

impl Asked {
    pub fn options(&self) -> Options {
        Options {
            method: match self.method {
                MethodArg::Direct => Method::Direct,
                MethodArg::Fmm => Method::Fmm,
                MethodArg::Classic => Method::Classic,
                MethodArg::Gather => Method::Gather,
                MethodArg::Auto => Method::Auto,
            },
            occlusion: match self.visibility {
                VisibilityArg::Surfels => Occlusion::Surfels,
                VisibilityArg::None => Occlusion::None,
            },
            tolerance: self.tolerance,
            order: self.order.map(usize::from),
            max_bounces: self.max_bounces,
            below_model: self.below_model,
            rays: self.rays,
            seed: self.seed,
            thinning: Thinning {
                spacing: self.spacing,
                max_points: self.max_points.map(NonZeroUsize::get),
                ..Thinning::default()
            },
            facing: self.normals,
            half: None,
        }
    }

    /// Opens the backend, with so many threads as are asked for.
    pub fn open(&self, method: Method) -> Result<Chosen> {
        let chosen = backend::choose(self.backend, self.adapter.as_deref(), method)?;
        if let Some(threads) = self.threads {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads.into())
                .build_global()
                .map_err(|e| Error::TooLarge(format!("{threads} threads: {e}")))?;
        }
        Ok(chosen)
    }

    /// Reads the inputs.
    pub fn load(&self, progress: &dyn Progress) -> Result<Scene> {
        let options = SceneOptions {
            points: self.points.map(NonZeroUsize::get),
            seed: self.seed,
            ..self.reading.options()
        };
        Scene::load_all(&self.inputs, &options, progress)
    }

    /// The same error, with the names of the inputs.
    pub fn about(&self, error: Error) -> Error {
        error.about(outputs::names(&self.inputs))
    }
}
