//! Points that are no surface: single ones in the air, edges of depth images, steam.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::cells::Cell;
use super::neighbours::Neighbours;
use super::plane::Plane;
use super::rule::median;
use crate::error::Result;

/// A point may be a stray if its neighbours are this many medians away.
const FAR: f64 = 3.0;
/// Or if positions and normals disagree by this slope, and by so many times what is usual.
const STEEP: f64 = 0.4;
const STEEPER: f64 = 4.0;
/// Points of about the same spacing, so many and so near (in spacings), that make a surface if they lie
/// on a plane but for this part of the spacing.
const SUPPORT: usize = 6;
const SUPPORT_REACH: f64 = 3.0;
/// Points nearer than this part of the spacing lie at one place. Flecks in the air are few places.
const ONE_PLACE: f64 = 0.3;
/// Neighbours among which the places are looked for.
const SUPPORTERS: usize = 48;
const SUPPORT_FLAT: f64 = 0.3;
/// And whose variance across is less than this part of that along it.
const SUPPORT_THIN: f64 = 0.1;
/// Spacings are about the same within this factor.
const SAME_SCALE: f64 = 3.0;
/// Neighbours among which steep points are looked at.
const AROUND: usize = 24;
/// A body of points where the variance across is more than this part of that along: no surface.
const BODY: f64 = 0.4;
/// A point this many times farther off the plane of its neighbours than they are does not belong to it.
const OFF: f64 = 5.0;
/// Unless as many of them as this are.
const COMPANY: usize = 4;

/// Indices of the strays.
pub(super) fn strays(
    positions: &[Vec3],
    neighbours: &Neighbours,
    cells: &[Cell],
    roughness: f64,
) -> Result<Vec<u32>> {
    let step = cells.len().div_ceil(20_000);
    let spacings = cells.iter().step_by(step).map(|c| c.crowd).collect();
    let Some(usual) = median(spacings) else {
        return Ok(Vec::new());
    };
    let steep = STEEP.max(STEEPER * roughness);
    let choose = |choose: &(dyn Fn(&Cell) -> bool + Sync)| -> Vec<u32> {
        let chosen = (0..cells.len() as u32).into_par_iter();
        chosen.filter(|&i| choose(&cells[i as usize])).collect()
    };
    let far = choose(&|c| c.crowd > FAR * usual);
    let off = choose(&|c| c.crowd <= FAR * usual && c.slope > steep);
    let mut strays = off;
    strays = strays
        .into_par_iter()
        .filter(|&i| is_off(i as usize, neighbours))
        .collect();
    if far.len() > SUPPORT {
        let places: Vec<Vec3> = far.iter().map(|&i| positions[i as usize]).collect();
        let others = Neighbours::new(&places)?;
        let isolated = |k: &usize| !supported(*k, &others, |k| cells[far[k] as usize].crowd);
        let found = (0..far.len()).into_par_iter().filter(isolated);
        strays.par_extend(found.map(|k| far[k]));
    } else {
        strays.extend(far);
    }
    strays.sort_unstable();
    Ok(strays)
}

/// Whether a point among those of wide spacing has others beside it that make a surface with it.
fn supported(k: usize, others: &Neighbours, spacing: impl Fn(usize) -> f64) -> bool {
    let own = spacing(k);
    let mut near = Vec::new();
    others.nearest(k, SUPPORTERS, &mut near);
    let mut places = vec![DVec3::ZERO];
    for (j, offset) in near {
        let other = spacing(j as usize);
        let alike = other < SAME_SCALE * own && own < SAME_SCALE * other;
        let apart = |p: &DVec3| p.distance(offset) > ONE_PLACE * own;
        if offset.length() > SUPPORT_REACH * own || places.len() > SUPPORT {
            break;
        }
        if alike && places.iter().all(apart) {
            places.push(offset);
        }
    }
    if places.len() <= SUPPORT {
        return false;
    }
    let plane = Plane::fit(places.into_iter());
    plane.rms() < SUPPORT_FLAT * own && plane.variances[0] < SUPPORT_THIN * plane.variances[1]
}

/// Whether the neighbours of a point make no surface, or one that it is not on.
fn is_off(i: usize, neighbours: &Neighbours) -> bool {
    let (mut near, mut heights) = (Vec::new(), Vec::new());
    neighbours.nearest(i, AROUND, &mut near);
    if near.len() < AROUND {
        return false;
    }
    let places: Vec<DVec3> = near.iter().map(|n| n.1).collect();
    let plane = Plane::robust(&places, &mut heights);
    if plane.variances[0] > BODY * plane.variances[1] {
        return true;
    }
    let own = plane.height(DVec3::ZERO);
    let company = places
        .iter()
        .filter(|&&p| plane.height(p) / own > 0.5)
        .count();
    own.abs() > OFF * plane.rms() && company < COMPANY
}
