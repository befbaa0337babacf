//! Which way of solving is taken, and why: the cheapest that is expected to do, and what follows where it does not.

use super::cost::{Cost, Job};
use super::{MANY_RAYS, ORDER};
use crate::error::{Error, Result};
use crate::illuminate::{Backend, Method, Occlusion, Options, RAYS};
use crate::links;
use crate::octree::LEAF_SIZE;
use crate::passes::gpu;

/// Highest order on the CPU. In f32 rounding leaves nothing to gain beyond.
const MAX_ORDER: usize = 12;

/// Links that are tested may take more rounds than expected, while more rays add to those that are there, and exact
/// sums take one: links count so many times, and exact sums.
const BY_LINKS: f64 = 1.25;
const BY_SUMS: f64 = 0.82;
/// Where all is curved, and rough as scans are, a round more can take ten times as long, but twice as many rays
/// only twice: where these are expected to do, so much is added for links, by the square of what is curved.
const BY_CURVED: f64 = 0.4;
/// Rays that are not expected to do count so many times: they may do all the same, and are tried where that
/// adds little to what else it takes.
const RAYS_TRIED: f64 = 4.8;
/// Rays are given up where they would take more than this part of what then follows; those that are expected to do,
/// before links, where they would take so many times as long: where surfaces are rougher than they look, links
/// take longer, too.
const GIVEN_UP: f64 = 0.5;
const GIVEN_UP_LATE: f64 = 8.0;

/// How to solve, and why.
pub(super) struct Way {
    pub method: Method,
    /// Whether links are tested.
    pub visibility: Occlusion,
    /// What follows where that is in vain, and the number of rays beyond which it does in any case.
    pub instead: Option<Method>,
    pub most_rays: Option<u32>,
    pub why: String,
}

impl Way {
    fn only(method: Method, visibility: Occlusion, why: &str) -> Way {
        Way {
            method,
            visibility,
            instead: None,
            most_rays: None,
            why: why.into(),
        }
    }
}

/// Who asks for an order wants expansions.
pub(super) fn choose(options: &Options, backend: &Backend, job: &Job, free: Option<u64>) -> Way {
    let asked = options.occlusion;
    if options.method != Method::Auto {
        return Way::only(options.method, asked, "asked for");
    }
    if options.order.is_some() {
        return Way::only(Method::Fmm, asked, "an order belongs to expansions");
    }
    let untested = Job {
        open: true,
        ..job.clone()
    };
    let [with_tests, without_tests] = [job, &untested].map(|job| job.cost(Method::Fmm, 0));
    let visibility =
        match job.in_sight() && !job.sketch.sky && without_tests.seconds() < with_tests.seconds() {
            true => Occlusion::None,
            false => asked,
        };
    // Links with tests, if something is in the way after all.
    let tested = (visibility != asked).then_some(Method::Fmm);
    if matches!(backend, Backend::Gpu { .. }) {
        let why = "on a device; the other methods work on the CPU";
        return Way {
            instead: tested,
            ..Way::only(Method::Fmm, visibility, why)
        };
    }
    let mut candidates = vec![(Method::Direct, 0), (Method::Fmm, 0)];
    let bounces = options.max_bounces != Some(0);
    let expected = job.rays();
    if job.sketch.contrast > 0.0 && !job.open && bounces {
        candidates.push((Method::Gather, expected.unwrap_or(MANY_RAYS)));
    }
    let mut costs: Vec<(Method, Cost)> = (candidates.into_iter())
        .map(|(method, rays)| match (method, visibility) {
            (Method::Fmm, Occlusion::None) => (method, untested.cost(method, rays)),
            _ => (method, job.cost(method, rays)),
        })
        .collect();
    // What does not fit comes last.
    let order = |(method, cost): &(Method, Cost)| {
        let too_large = free.is_some_and(|free| cost.bytes() > free);
        let weight = match method {
            Method::Gather if expected.is_none() => RAYS_TRIED,
            Method::Fmm if visibility == Occlusion::None => 1.0,
            Method::Fmm if expected.is_some() => BY_LINKS + BY_CURVED * job.sketch.curved.powi(2),
            Method::Fmm => BY_LINKS,
            Method::Direct => BY_SUMS,
            _ => 1.0,
        };
        (too_large, weight * cost.seconds())
    };
    costs.sort_by(|a, b| {
        let (a, b) = (order(a), order(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let told: Vec<String> = (costs.iter())
        .map(|(method, cost)| {
            let hope = match method {
                Method::Gather if expected.is_none() => ", if they do,",
                _ => "",
            };
            format!("{}{hope} {:.2} s", named(*method), cost.seconds())
        })
        .collect();
    let method = costs[0].0;
    let (instead, after) = &costs[1];
    // Links may take longer than expected, and so may expected rays: those may need one more round.
    let given_up = match expected.is_none() || *instead == Method::Direct {
        true => GIVEN_UP,
        false => GIVEN_UP_LATE,
    };
    let at_least = expected.map_or_else(|| job.tried(), |rays| 2 * rays);
    let dearer = |rays: &u32| job.cost(method, 2 * rays).seconds() > given_up * after.seconds();
    Way {
        method,
        visibility: match method {
            Method::Fmm => visibility,
            _ => asked,
        },
        instead: match method {
            Method::Gather => Some(*instead),
            Method::Fmm => tested,
            _ => None,
        },
        most_rays: (method == Method::Gather).then(|| {
            let more = std::iter::successors(Some(at_least), |rays| Some(2 * rays));
            more.take_while(|rays| rays <= RAYS.end())
                .find(dearer)
                .unwrap_or(*RAYS.end())
        }),
        why: format!("expected are {}", told.join(", ")),
    }
}

/// What a method that `auto` may take works with.
pub(crate) fn named(method: Method) -> &'static str {
    match method {
        Method::Direct => "exact sums",
        Method::Gather => "rays",
        _ => "links",
    }
}

/// Largest order of the expansions, and the size of the leaves for it.
pub(super) fn expansions(
    options: &Options,
    method: Method,
    job: &Job,
    backend: &Backend,
) -> Result<(usize, usize)> {
    let classic = method == Method::Classic;
    let order = options.order.unwrap_or(match (job.open, classic) {
        (_, true) => links::classic_order(job.tolerance),
        (true, false) => links::open::order(job.tolerance),
        (false, false) => ORDER,
    });
    let (most, place) = match backend {
        Backend::Cpu => (MAX_ORDER, "on the CPU"),
        Backend::Gpu { .. } => (gpu::MAX_ORDER, "on a GPU"),
    };
    if order > most {
        return Err(Error::Usage(format!(
            "order {order}: expansions {place} have orders up to {most}"
        )));
    }
    let leaf_size = match (job.open, classic) {
        (true, _) => links::open::leaf_size(order, job.surfels),
        (false, true) => links::CLASSIC_LEAF_SIZE,
        (false, false) => LEAF_SIZE,
    };
    Ok((order, leaf_size))
}
