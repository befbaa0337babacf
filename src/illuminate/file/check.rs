//! What must be true of the arrays of a file before they are used.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::NO_SURFEL;
use crate::links::{Kept, Rows};
use crate::points::Surfels;
use crate::scene::LARGEST;

type Checked = Result<(), &'static str>;

fn ensure(fits: bool, what: &'static str) -> Checked {
    if fits { Ok(()) } else { Err(what) }
}

/// Unit vectors may be off by this.
const SLACK: f32 = 1e-3;

/// Surfels, and the places of the points among them.
pub fn surfels(surfels: &Surfels, places: &[u32]) -> Checked {
    let n = surfels.len();
    let far = 2.0 * LARGEST;
    let near = |v: Vec3| v.abs().cmple(Vec3::splat(far as f32)).all();
    let unit = |v: Vec3| (v.length_squared() - 1.0).abs() < SLACK;
    let length = |x: f32| (0.0..=far as f32).contains(&x);
    let all = |fits: &(dyn Fn(usize) -> bool + Sync)| (0..n).into_par_iter().all(fits);
    let frame = |i: usize| {
        let (normal, tangent) = (surfels.normals[i], surfels.cells.tangents[i]);
        unit(normal) && unit(tangent) && normal.dot(tangent).abs() < SLACK
    };
    ensure(n > 0, "no surfels")?;
    let origin = surfels.origin.abs().cmple(DVec3::splat(LARGEST)).all();
    ensure(origin, "an origin that is no place")?;
    ensure(
        (0.0..100.0).contains(&surfels.occluder_scale),
        "a scale of cells that cannot be",
    )?;
    ensure(
        all(&|i| near(surfels.positions[i])),
        "positions that are no places",
    )?;
    ensure(all(&frame), "normals or tangents that are no directions")?;
    ensure(
        all(&|i| surfels.areas[i] > 0.0 && surfels.areas[i].is_finite()),
        "areas that are not positive",
    )?;
    let corners = |i: usize| surfels.cells.corners[i].iter().all(|c| near(c.extend(0.0)));
    ensure(all(&corners), "corners that are no places")?;
    ensure(
        all(&|i| length(surfels.offsets[i]) && length(surfels.depths[i])),
        "offsets or depths that are no lengths",
    )?;
    ensure(
        places
            .par_iter()
            .all(|&p| p == NO_SURFEL || (p as usize) < n),
        "points with surfels that are not there",
    )?;
    let backs = |i: usize| match surfels.backs[i] {
        NO_SURFEL => true,
        back => back != i as u32 && surfels.backs.get(back as usize) == Some(&(i as u32)),
    };
    ensure(all(&backs), "backs that are not each other's")?;
    let own = |i: usize| {
        let place = places.get(surfels.points[i] as usize);
        place.is_some_and(|&place| place == i as u32 || place == surfels.backs[i])
    };
    ensure(all(&own), "surfels with points that are not theirs")
}

/// Links between so many facets and so many surfels.
pub fn links(kept: &Kept, facets: usize, surfels: usize) -> Checked {
    let links = &kept.links;
    for (list, demands) in links.m2l.iter().zip(&kept.m2l) {
        rows(list, facets)?;
        positive(demands)?;
    }
    rows(&links.sampled, facets)?;
    positive(&kept.sampled)?;
    rows(&kept.left_out, facets)?;
    rows(&links.near, surfels)
}

fn rows(rows: &Rows, count: usize) -> Checked {
    ensure(
        rows.offsets.first() == Some(&0)
            && rows.offsets.is_sorted()
            && rows.offsets.last().map(|end| *end as usize) == Some(rows.len()),
        "rows of links that are not in order",
    )?;
    ensure(
        rows.sources.par_iter().all(|&s| (s as usize) < count),
        "links to what is not there",
    )?;
    positive(&rows.weights)
}

fn positive(values: &[f32]) -> Checked {
    ensure(
        values.par_iter().all(|&x| x >= 0.0 && x.is_finite()),
        "weights of links that are negative or no numbers",
    )
}
