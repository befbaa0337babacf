//! What can be asked for, and what is refused.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::RAYS;
use crate::error::{Error, Result};
use crate::points::{Facing, Half, Thinning};
use crate::scene::{BRIGHTEST, LARGEST, Scene, TOLERANCES};

/// How the transport operator is applied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Exact sum over all pairs of surfels, in f64 on the CPU: the truth, for small clouds.
    Direct,
    /// Links between facets, expansions, tested visibility.
    Fmm,
    /// The adaptive lists and the hierarchical visibility of Goradia's report: tests all pairs.
    Classic,
    /// Rays from every surfel, whose hits are kept for all bounces. Surfels are as large as their
    /// cells: areas given in the file do not count. The rays are cast on the CPU on every backend.
    Gather,
    /// What is expected to be cheapest of `Direct`, `Gather` and `Fmm`, see [`Plan`](crate::Plan). The
    /// tolerance is kept: rays that no longer help are followed by the cheaper of the others. Links go
    /// without tests where nothing seems to be in the way; with them if something is after all.
    #[default]
    Auto,
}

/// What stands in the way of light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Occlusion {
    /// The cells of the surfels.
    #[default]
    Surfels,
    /// Nothing.
    None,
}

/// What is asked for.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// How the operator is applied.
    pub method: Method,
    /// What blocks light.
    pub occlusion: Occlusion,
    /// Relative error asked for; `None` takes the scene's, or 0.03.
    pub tolerance: Option<f64>,
    /// Largest order of the expansions; `None` takes 1, and without occlusion or by the classic method
    /// what the tolerance needs.
    pub order: Option<usize>,
    /// Bounces to follow; `None` goes on until the solution stands.
    pub max_bounces: Option<u32>,
    /// Rays from each surfel with the method `Gather`, rounded up to a power of two; `None` casts as
    /// many as the tolerance needs.
    pub rays: Option<u32>,
    /// Refine until the tolerance is met even where the points allow no such accuracy: otherwise a
    /// third of the estimated error of the model is enough.
    pub below_model: bool,
    /// Seed of all samples: the same seed gives the same bits.
    pub seed: u64,
    /// Fewer points to do the work with.
    pub thinning: Thinning,
    /// Which side of a surface is lit, where the points have no normals.
    pub facing: Facing,
    /// Points that a surface is fitted to, if not all; see [`surface_error`](super::surface_error).
    pub half: Option<Half>,
}

impl Options {
    /// Fails with [`Error::Usage`] where there is no operator to keep. (Without occlusion links take
    /// next to no time; other methods find nothing that can be refined.)
    pub fn check_keeping(&self) -> Result<()> {
        match (self.method, self.occlusion) {
            (Method::Fmm | Method::Auto, Occlusion::Surfels) => Ok(()),
            _ => Err(Error::Usage(
                "operators are kept of the fmm method with occlusion alone: ask for that method, and \
                 leave out the visibility"
                    .into(),
            )),
        }
    }
}

/// Where the passes run.
#[derive(Clone, Copy)]
pub enum Backend<'a> {
    /// f32 on all threads of the current rayon pool.
    Cpu,
    /// WGSL on a device that the caller made.
    Gpu {
        /// Large clouds need the buffer limits (`max_buffer_size` and
        /// `max_storage_buffer_binding_size`) that the adapter offers, not the default ones.
        device: &'a wgpu::Device,
        /// The device's queue.
        queue: &'a wgpu::Queue,
        /// Its name, for the stats.
        adapter: &'a str,
    },
}

/// Default of [`Options::tolerance`].
pub const DEFAULT_TOLERANCE: f64 = 0.03;

/// Refuses what cannot be done.
pub(crate) fn check(scene: &Scene, options: &Options, backend: &Backend) -> Result<()> {
    check_scene(scene, tolerance(scene, options))?;
    check_options(options, backend)
}

/// Relative error that is asked for.
pub(crate) fn tolerance(scene: &Scene, options: &Options) -> f64 {
    let wanted = options.tolerance.or(scene.tolerance);
    wanted.unwrap_or(DEFAULT_TOLERANCE)
}

/// Refuses what the method cannot do, or would ignore.
fn check_options(options: &Options, backend: &Backend) -> Result<()> {
    let usage = |what: String| Err(Error::Usage(what));
    let method = options.method;
    if method == Method::Gather && options.occlusion == Occlusion::None {
        return usage(
            "the gather method follows rays to the surface that they meet, which is in the way of \
             all behind it: without occlusion use another method"
                .into(),
        );
    }
    if options.rays.is_some() && method != Method::Gather {
        return usage("rays belong to the gather method: use --method gather".into());
    }
    if options.rays.is_some_and(|n| !RAYS.contains(&n)) {
        return usage(format!(
            "a surfel casts from {} to {} rays",
            RAYS.start(),
            RAYS.end()
        ));
    }
    if options.order.is_some() && matches!(method, Method::Gather | Method::Direct) {
        return usage(
            "an order belongs to expansions: the methods direct and gather have none".into(),
        );
    }
    match (method, backend) {
        (Method::Direct, Backend::Gpu { .. }) => usage(
            "the direct method is the reference in f64 and runs on the CPU only: use --backend \
             cpu, or --method fmm"
                .into(),
        ),
        _ => Ok(()),
    }
}

/// Numbers that no light can have.
pub(super) fn check_scene(scene: &Scene, tolerance: f64) -> Result<()> {
    let invalid = |what: String| Err(Error::Invalid(what));
    if !TOLERANCES.contains(&tolerance) {
        return invalid(format!(
            "tolerance {tolerance}: must lie between {} and {}",
            TOLERANCES.start(),
            TOLERANCES.end()
        ));
    }
    let shines = |rgb: Vec3| rgb.cmpge(Vec3::ZERO).all() && rgb.cmple(Vec3::splat(BRIGHTEST)).all();
    for (k, light) in scene.lights.iter().enumerate() {
        if !(light.position.abs().cmple(DVec3::splat(LARGEST)).all() && shines(light.intensity)) {
            return invalid(format!(
                "light {k} at {} with intensity {}: numbers must be finite, intensities not \
                 negative",
                light.position, light.intensity
            ));
        }
    }
    if !shines(scene.sky) {
        return invalid(format!(
            "sky {}: must be finite and not negative",
            scene.sky
        ));
    }
    Ok(())
}
