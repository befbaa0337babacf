//! The error of expansions against their order, where nothing is in the way: one application of the
//! operator by the Cartesian tensors and by the spherical basis of the report, by the same links.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::usage::{Clock, median};
use crate::error::Result;
use crate::illuminate::prepared;
use crate::links::{self, CLAMPED, Links, Mac, THETA};
use crate::octree::Octree;
use crate::operator::{Fields, Fmm, Hausner, TransportOperator, exact_irradiance};
use crate::points::Surfels;
use crate::progress::{Progress, Silent};
use crate::scene::Scene;
use crate::visibility::NothingInTheWay;

/// Surfels in a leaf, at most.
const LEAF_SIZE: usize = 32;
/// Receivers at which the error is found.
const RECEIVERS: usize = 300;
/// Applications of which the time is the median, and seconds after which there are no more.
const RUNS: usize = 3;
const ENOUGH: f64 = 1.0;

/// One application at one order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OrderRow {
    pub scene: String,
    pub surfels: usize,
    /// "tensors, f64", "tensors, f32" or "spherical, f64".
    pub basis: String,
    /// "dual traversal" or "adaptive lists".
    pub lists: String,
    pub order: usize,
    /// Relative L2 against exact sums.
    pub error: f64,
    /// Of one application.
    pub seconds: f64,
}

/// A scene without occlusion, and its exact light at some receivers.
pub struct Open {
    name: String,
    octree: Octree,
    surfels: Surfels,
    radiosity: Vec<DVec3>,
    receivers: Vec<usize>,
    exact: Vec<DVec3>,
}

impl Open {
    /// The light that is sent out is what is reflected of an even light, and the lamps as far as they
    /// are no brighter.
    pub fn new(name: &str, scene: &Scene, progress: &dyn Progress) -> Result<Open> {
        let (octree, surfels) = Octree::build(&prepared(scene, progress)?.0, LEAF_SIZE);
        let colours = surfels.reflectance.iter().zip(&surfels.emission);
        let radiosity: Vec<DVec3> = colours
            .map(|(r, e)| (*r + e.min(Vec3::ONE)).as_dvec3())
            .collect();
        let n = surfels.len();
        let count = RECEIVERS.min(n);
        let receivers: Vec<usize> = (0..count).map(|k| (2 * k + 1) * n / (2 * count)).collect();
        let exact = exact_irradiance(&surfels, &NothingInTheWay, &receivers, &radiosity)?;
        Ok(Open {
            name: name.to_owned(),
            octree,
            radiosity,
            receivers,
            exact: exact.into_iter().map(|(h, _)| h).collect(),
            surfels,
        })
    }

    /// All bases and lists at one order.
    pub fn at(&self, order: usize) -> Result<Vec<OrderRow>> {
        let (octree, surfels) = (&self.octree, &self.surfels);
        let mac = Mac {
            theta: THETA,
            order,
            cosines: CLAMPED,
        };
        let facets = &octree.facets;
        let judge = |t: u32, s: u32| mac.judge(&facets[t as usize], &facets[s as usize]);
        let mut rows = Vec::new();
        for (lists, links) in [
            (
                "dual traversal",
                links::dual(octree, surfels, order, judge, &Silent)?,
            ),
            (
                "adaptive lists",
                links::adaptive(octree, surfels, CLAMPED, order, &Silent)?,
            ),
        ] {
            let links: &Links = &links;
            let double = Fmm::<f64>::new(surfels, octree, links);
            rows.push(self.row(&double, "tensors, f64", lists, order)?);
            let single = Fmm::<f32>::new(surfels, octree, links);
            rows.push(self.row(&single, "tensors, f32", lists, order)?);
            let spherical = Hausner::new(surfels, octree, links, order);
            rows.push(self.row(&spherical, "spherical, f64", lists, order)?);
        }
        Ok(rows)
    }

    fn row<O: TransportOperator>(
        &self,
        operator: &O,
        basis: &str,
        lists: &str,
        order: usize,
    ) -> Result<OrderRow> {
        let fields = operator.fields();
        let radiosity = fields.upload(&self.radiosity)?;
        let mut times = Vec::new();
        let mut found = Vec::new();
        let all = Clock::start();
        while times.len() < RUNS && (times.is_empty() || all.spent().wall < ENOUGH) {
            let clock = Clock::start();
            let irradiance = operator.apply(&radiosity)?;
            times.push(clock.spent().wall);
            found = fields.download(&irradiance)?;
        }
        let pairs = self.receivers.iter().zip(&self.exact);
        let (error, norm) = pairs.fold((0.0, 0.0), |(e, n), (&i, h)| {
            (e + (found[i] - *h).length_squared(), n + h.length_squared())
        });
        Ok(OrderRow {
            scene: self.name.clone(),
            surfels: self.surfels.len(),
            basis: basis.to_owned(),
            lists: lists.to_owned(),
            order,
            error: (error / norm).sqrt(),
            seconds: median(&times),
        })
    }
}
