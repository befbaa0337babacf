//! The cell of a surfel: the piece of surface that it stands for.
//!
//! A cell is the Voronoi polygon of a point among its neighbours of similar normal, in the
//! tangent plane, clipped where the surface folds (by the planes of neighbours of another
//! orientation) and where it ends (open borders). Cells tile the surface: as sources they leave
//! no gap in the near field, as occluders they neither leak nor stick out.

use std::f64::consts::PI;

use glam::{DVec2, DVec3, Vec2, Vec3};

use super::neighbours::Neighbour;
use super::rule::SurfaceRule;

/// Largest number of edges of a cell, so that a GPU can hold it.
pub const MAX_EDGES: usize = 8;

/// Convex polygons, one a surfel, in the tangent plane through the surfel's position.
///
/// A corner (a, b) lies at `position + a * tangent + b * (normal × tangent)`. Corners go round
/// counter-clockwise seen from the tip of the normal; unused ones repeat the last corner, so that
/// an edge between them has no length and a loop over all [`MAX_EDGES`] needs no count.
#[derive(Clone, Debug, Default)]
pub struct Cells {
    /// Unit vectors orthogonal to the surfel's normal.
    pub tangents: Vec<Vec3>,
    /// Corners in the frame of tangent and bitangent, in the scan's unit.
    pub corners: Vec<[Vec2; MAX_EDGES]>,
}

/// One cell with what follows from it.
#[derive(Clone, Default)]
pub(super) struct Cell {
    pub tangent: DVec3,
    pub corners: [Vec2; MAX_EDGES],
    pub area: f64,
    /// How far below the tangent plane the surface lies at the corners.
    pub depth: f64,
    /// Mean distance of the six nearest neighbours of similar normal.
    pub spacing: f64,
    /// Mean distance of the six nearest neighbours of any normal.
    pub crowd: f64,
    /// How far positions and normals of those of similar one disagree, as a slope; 1 without any.
    pub slope: f64,
    /// Distance of the farthest neighbour.
    pub reach: f64,
}

/// A cell reaches no farther than this many spacings: as far as cells of random points do.
const REACH: f64 = 1.3;
/// An angle without a neighbour that is wider than this is an open border.
const BORDER_GAP: f64 = 130.0 / 180.0 * PI;
/// Neighbours as near as this, in spacings, count for that: a gap in a smaller circle may be the
/// chance of random points.
const BORDER_RANGE: f64 = 3.0;
/// Neighbours as near as this, in spacings, are the same place seen twice, as by two scans.
const TWIN: f64 = 0.5;
/// Neighbours that face away further than this belong to the other side of a thin wall.
const OTHER_SIDE: f64 = -0.9;
/// Square of the distance of its corners from the middle of a regular hexagon, in its area: 2 / 3√3.
const HEXAGON: f64 = 0.384_900;
/// Neighbours that tell how the surface bends.
const BENT: usize = 8;
/// A corner that cuts off no more than this part of the area is none.
const SLIVER: f64 = 1e-4;

impl Cell {
    /// The cell of a point with unit `normal` among its `neighbours` (nearest first); a neighbour
    /// belongs to the same smooth surface if the cosine between the normals exceeds the rule's
    /// `crease`.
    /// Without any neighbour the cell is of the order of `size`; it stands for a spacing of no more than
    /// `widest`. Where the surface ends, it goes as far as `end` says of a direction, or half of a spacing.
    pub fn new(
        normal: DVec3,
        neighbours: &[Neighbour],
        rule: &SurfaceRule,
        size: f64,
        widest: f64,
        end: Option<&dyn Fn(DVec3) -> f64>,
    ) -> Cell {
        let crease = rule.crease;
        let similar = |n: &&Neighbour| n.normal.dot(normal) > crease;
        let nearest = neighbours.first().map_or(size, |n| n.offset.length());
        let (sum, count) = neighbours
            .iter()
            .filter(similar)
            .take(6)
            .fold((0.0, 0), |(s, c), n| (s + n.offset.length(), c + 1));
        // A point alone in its orientation gets a small cell.
        let spacing = if count > 0 {
            sum / count as f64
        } else {
            0.5 * nearest
        };
        let spacing = spacing.min(rule.largest_spacing).min(widest);
        let (tangent, bitangent) = tangent_frame(normal, neighbours);
        let flat = |v: DVec3| DVec2::new(v.dot(tangent), v.dot(bitangent));

        let mut polygon = Polygon::regular(12, REACH * spacing);
        for n in neighbours.iter().filter(similar) {
            let height = n.offset.dot(normal);
            let t = flat(n.offset);
            let length = n.offset.length();
            // What lies across the surface, unless it is the same place twice, which both share.
            if height.abs() < 0.7 * length || length < TWIN * spacing {
                polygon.clip(t, 0.5 * t.length_squared());
            }
        }
        for n in neighbours
            .iter()
            .filter(|n| folds(n, normal, crease, spacing))
        {
            // Keep the side of the neighbour's plane on which the point itself lies.
            let side = -n.offset.dot(n.normal);
            let across = flat(n.normal) * -side.signum();
            if side.abs() > 1e-3 * spacing {
                polygon.clip(across, side.abs());
            }
        }
        for (direction, distance) in borders(neighbours, &flat, normal, crease, spacing) {
            let along = direction.x * tangent + direction.y * bitangent;
            polygon.clip(
                direction,
                end.map_or(distance, |end| end(along).max(distance)),
            );
        }
        let area = polygon.area();
        let bend = bend(normal, neighbours.iter().filter(similar));
        let six = neighbours.iter().take(6).map(|n| n.offset.length());
        let crowd = six.sum::<f64>() / neighbours.len().clamp(1, 6) as f64;
        let slopes = neighbours
            .iter()
            .filter(similar)
            .take(6)
            .map(|n| 0.5 * (normal + n.normal).dot(n.offset).abs() / n.offset.length());
        Cell {
            reach: neighbours.last().map_or(0.0, |n| n.offset.length()),
            depth: (HEXAGON * area * bend).max(0.0),
            tangent,
            corners: polygon.bounded(),
            area,
            spacing,
            crowd,
            slope: if count > 0 {
                slopes.sum::<f64>() / count as f64
            } else {
                1.0
            },
        }
    }
}

/// A neighbour across a crease: another orientation, close by, and not the back of a thin wall.
fn folds(n: &Neighbour, normal: DVec3, crease: f64, spacing: f64) -> bool {
    let cos = n.normal.dot(normal);
    cos <= crease && cos > OTHER_SIDE && n.offset.length() < 1.6 * spacing
}

/// Depth of the surface below its tangent plane over the square of the distance, from the nearest
/// neighbours: half of the mean curvature, positive where the surface is convex.
fn bend<'a>(normal: DVec3, similar: impl Iterator<Item = &'a Neighbour>) -> f64 {
    let (depths, squares) = similar.take(BENT).fold((0.0, 0.0), |(d, s), n| {
        (d - n.offset.dot(normal), s + n.offset.length_squared())
    });
    if squares > 0.0 { depths / squares } else { 0.0 }
}

/// Half-planes (unit direction, distance) that end the cell where the surface ends: in a wide
/// angle without neighbours the border runs along the neighbours at its two sides, half a spacing
/// out.
fn borders(
    neighbours: &[Neighbour],
    flat: &impl Fn(DVec3) -> DVec2,
    normal: DVec3,
    crease: f64,
    spacing: f64,
) -> Vec<(DVec2, f64)> {
    let around = |n: &&Neighbour| {
        let cos = n.normal.dot(normal);
        cos > OTHER_SIDE
            && n.offset.length() < if cos > crease { BORDER_RANGE } else { 1.6 } * spacing
    };
    let mut angles: Vec<f64> = neighbours
        .iter()
        .filter(around)
        .map(|n| flat(n.offset))
        .filter(|t| t.length_squared() > 0.0)
        .map(|t| t.y.atan2(t.x))
        .collect();
    if angles.len() < 2 {
        return Vec::new();
    }
    angles.sort_by(f64::total_cmp);
    let (sum, count) = neighbours
        .iter()
        .filter(|n| n.normal.dot(normal) > crease)
        .take(3)
        .fold((0.0, 0), |(s, c), n| (s + n.offset.length(), c + 1));
    let half = 0.5 * sum / f64::from(count.max(1));
    let mut planes = Vec::new();
    for (k, &from) in angles.iter().enumerate() {
        let to = match angles.get(k + 1) {
            Some(&next) => next,
            None => angles[0] + 2.0 * PI,
        };
        if half > 0.0 && to - from > BORDER_GAP {
            planes.push((DVec2::from_angle(from + 0.5 * PI), half));
            planes.push((DVec2::from_angle(to - 0.5 * PI), half));
        }
    }
    planes
}

/// Tangent and bitangent; the tangent points to the nearest neighbour, so that a cell turns with
/// the cloud.
fn tangent_frame(normal: DVec3, neighbours: &[Neighbour]) -> (DVec3, DVec3) {
    let tangent = neighbours
        .iter()
        .map(|n| (n.offset - normal * n.offset.dot(normal)) / n.offset.length())
        .find(|t| t.length() > 0.3)
        .map_or_else(|| normal.any_orthonormal_vector(), DVec3::normalize);
    (tangent, normal.cross(tangent))
}

/// A convex polygon around the origin, counter-clockwise.
struct Polygon(Vec<DVec2>);

impl Polygon {
    fn regular(corners: usize, radius: f64) -> Polygon {
        let angle = |k: usize| (k as f64 + 0.5) * 2.0 * PI / corners as f64;
        Polygon(
            (0..corners)
                .map(|k| DVec2::from_angle(angle(k)) * radius)
                .collect(),
        )
    }

    /// Keeps the part where `direction · p <= limit`, with a positive limit: the origin stays in.
    fn clip(&mut self, direction: DVec2, limit: f64) {
        let inside = |p: DVec2| limit - direction.dot(p);
        if self.0.iter().all(|&p| inside(p) >= 0.0) {
            return;
        }
        let mut kept = Vec::with_capacity(self.0.len() + 1);
        for (k, &a) in self.0.iter().enumerate() {
            let b = self.0[(k + 1) % self.0.len()];
            let (fa, fb) = (inside(a), inside(b));
            if fa >= 0.0 {
                kept.push(a);
            }
            if (fa >= 0.0) != (fb >= 0.0) {
                kept.push(a + (b - a) * (fa / (fa - fb)));
            }
        }
        self.0 = kept;
    }

    fn area(&self) -> f64 {
        let n = self.0.len();
        0.5 * (0..n)
            .map(|k| self.0[k].perp_dot(self.0[(k + 1) % n]))
            .sum::<f64>()
    }

    /// At most [`MAX_EDGES`] corners: the ones that cut off the least area go. So do those that cut
    /// off next to nothing: rounded to f32, an edge so short would point anywhere.
    fn bounded(mut self) -> [Vec2; MAX_EDGES] {
        let least = 2.0 * SLIVER * self.area();
        while self.0.len() > 3 {
            let n = self.0.len();
            let cut = |k: usize| {
                let (a, b, c) = (self.0[(k + n - 1) % n], self.0[k], self.0[(k + 1) % n]);
                // The point itself stays in, however close to a corner it lies.
                if (c - a).perp_dot(-a) < 0.0 {
                    return f64::INFINITY;
                }
                (b - a).perp_dot(c - b)
            };
            let (k, area) = (0..n)
                .map(|k| (k, cut(k)))
                .min_by(|a, b| a.1.total_cmp(&b.1))
                .unwrap_or_default();
            if n <= MAX_EDGES && area > least {
                break;
            }
            self.0.remove(k);
        }
        let last = self.0[self.0.len() - 1];
        std::array::from_fn(|k| self.0.get(k).copied().unwrap_or(last).as_vec2())
    }
}
