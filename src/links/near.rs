//! Form factors of surfels nearby.

use rayon::prelude::*;

use super::Rows;
use super::csr::Part;
use crate::error::Result;
use crate::expansion::Surface;
use crate::memory::Budget;
use crate::octree::Octree;
use crate::points::Surfels;

/// Links surfel by surfel where facets are linked by `parts`: those near each other that have a form
/// factor. P2P takes the others.
pub(super) fn near(
    octree: &Octree,
    surfels: &Surfels,
    parts: &[Part],
    budget: &Budget,
) -> Result<Rows> {
    let is_near = |surface: &Surface<f32>, i, j| surface.is_near(i, j);
    let linked = form_factors(octree, surfels, parts, budget, is_near)?;
    Rows::gather(surfels.len(), linked)
}

/// The form factors of surfels of facets linked by `parts`, where there is one and `wanted` holds.
pub(super) fn form_factors(
    octree: &Octree,
    surfels: &Surfels,
    parts: &[Part],
    budget: &Budget,
    wanted: impl Fn(&Surface<f32>, usize, usize) -> bool + Sync,
) -> Result<Vec<Part>> {
    // Surfaces take memory: only those of facets that take part are made.
    let facets = &octree.facets;
    let mut place = vec![None; facets.len()];
    let mut order: Vec<u32> = Vec::new();
    let targets = parts.iter().flat_map(|p| p.rows.iter().map(|&(t, _)| t));
    let sources = parts.iter().flat_map(|p| p.sources.iter().copied());
    for f in targets.chain(sources).map(|f| f as usize) {
        if place[f].is_none() {
            place[f] = Some(order.len());
            order.extend(facets[f].begin..facets[f].end);
        }
    }
    let surface = Surface::<f32>::new(&surfels.reordered(&order));
    let places = |f: u32| {
        let begin = place[f as usize].unwrap_or(0);
        begin..begin + facets[f as usize].len()
    };
    let link = |part: &Part| {
        let mut linked = Part::default();
        let mut begin = 0;
        for &(target, count) in &part.rows {
            let sources = &part.sources[begin..begin + count as usize];
            begin += count as usize;
            for i in places(target) {
                for j in sources.iter().flat_map(|&source| places(source)) {
                    let form_factor = surface.form_factor(i, j);
                    if form_factor > 0.0 && wanted(&surface, i, j) {
                        linked.push(order[i], order[j]);
                        linked.weights.push(form_factor);
                    }
                }
            }
        }
        budget.take(linked.bytes())?;
        Ok(linked)
    };
    parts.par_iter().map(link).collect()
}
