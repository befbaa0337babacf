//! Whether two points see each other, judged by the points between them: section 2.2.4.1 of the
//! report. `shaders/point_visible.wgsl` does the same in the same order.
//!
//! Possible occluders are the points in a cylinder around the segment whose tangent planes it
//! crosses. Each is a piece of its plane, opaque in the middle and clear from the distance Δ on.
//! One that alone brings the visibility down to the threshold blocks, whatever its rank: so the
//! search may end with the first that is met, in any order. Else, of the k closest to the segment,
//! the product of the three that are crossed closest to their middle decides. (The report takes the
//! k closest first and then asks for the planes. But a segment that leaves a wall at a flat angle
//! has more points of this wall beside it than any small k, and they would crowd out the
//! occluders.)
//!
//! Segments start and end a little above the surfels, as everywhere ([`Surfels::segment`]), so that
//! the noise of normals casts no shadow. And a point stands for the surface only where it is nearer
//! than the ends of the segment: what is nearer to an end is the end's own piece of surface. On a
//! plane and outside of a sphere this excludes the neighbours of an end exactly (what a segment
//! crosses of the tangent plane of a neighbour, above the tangent plane of the end, is on the end's
//! side of the bisector); inside of a sphere no tangent plane is crossed at all. What is crossed
//! within Δ and nearer than the ends lies in the cylinder, which need not be tested.

use std::marker::PhantomData;

use bytemuck::{Pod, Zeroable};
use glam::Vec3A;
use rayon::prelude::*;

use crate::error::Result;
use crate::math::{Real, Vector};
use crate::points::Surfels;

use super::bvh::{Item, hierarchy};
use super::pairs::of_facing;
use super::segment::{ends, excludes, line, vector};
use super::wide::{WideNode, walk, widened};
use super::{Node, PointVisibility, Segment};

/// Entries of the look-up table.
pub const LOOKUP: usize = 6;
/// Most occluders of a pair that products are made of.
pub const MAX_CLOSEST: usize = 16;
/// Square of a distance, in spacings, from which on nothing is in the way, however it is rounded.
const FAR: f32 = 1e30;

/// The parameters of the test.
///
/// The defaults balance holes against swollen shadows. Against the cells of cornell, two_rooms and
/// organic, 0.06 to 0.5% of the pairs that face each other are seen through cells and 1 to 3% are
/// blocked by none at 3,000 points, up to 0.05% and 0.4% at 20,000. Of segments through a single
/// layer of points that lie anywhere in their strata, 9% find a hole. A larger Δ or threshold closes
/// holes and swells shadows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointTest {
    /// How many possible occluders, those closest to the segment, may make up the product: k, up to
    /// [`MAX_CLOSEST`]. One that is enough alone blocks even if it is none of them.
    pub closest: u32,
    /// Radius of the cylinder around the segment, in spacings (square roots of the area) of the
    /// point that lies in it or not: Δ.
    pub radius: f32,
    /// Visibility past an occluder, by the distance in its plane from it to the segment: entries at
    /// equal steps from 0 to Δ, linear between them. From Δ on, and where there is no occluder, it
    /// is 1, whatever the last entry.
    pub lookup: [f32; LOOKUP],
    /// The product of the three visibilities must exceed this: t1. Below 0 everything does.
    pub threshold: f32,
}

impl Default for PointTest {
    fn default() -> Self {
        PointTest {
            closest: 8,
            radius: 1.25,
            // About the square root of the distance over Δ.
            lookup: [0.0, 0.45, 0.63, 0.77, 0.89, 1.0],
            threshold: 0.5,
        }
    }
}

/// A point as an occluder; two texels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PointOccluder {
    pub position: [f32; 3],
    pub surfel: u32,
    pub normal: [f32; 3],
    /// One over the square of its spacing.
    pub inverse_area: f32,
}

/// The points of a cloud under a hierarchy that finds those around a segment.
#[derive(Clone, Debug)]
pub struct PointTree {
    /// Over the discs of radius Δ around the points.
    /// Devices walk them.
    pub nodes: Vec<Node>,
    /// The same hierarchy for the CPU.
    pub wide: Vec<WideNode>,
    /// In the order of the leaves.
    pub points: Vec<PointOccluder>,
}

impl PointTree {
    /// Points without an area are in nobody's way.
    pub fn build(surfels: &Surfels, radius: f32) -> PointTree {
        let discs = (0..surfels.len()).into_par_iter().map(|i| {
            let centre = Vec3A::from(surfels.positions[i]);
            let normal = Vec3A::from(surfels.normals[i]);
            let slope = (Vec3A::ONE - normal * normal).max(Vec3A::ZERO);
            let reach = slope.map(f32::sqrt) * (radius * surfels.areas[i].sqrt());
            Item {
                min: centre - reach,
                max: centre + reach,
                surfel: i as u32,
            }
        });
        let (nodes, discs) = hierarchy(discs.collect());
        let point = |disc: &Item| {
            let i = disc.surfel as usize;
            PointOccluder {
                position: surfels.positions[i].to_array(),
                surfel: disc.surfel,
                normal: surfels.normals[i].to_array(),
                inverse_area: 1.0 / surfels.areas[i],
            }
        };
        PointTree {
            wide: widened(&nodes),
            nodes,
            points: discs.par_iter().map(point).collect(),
        }
    }
}

/// Decides pairs on all threads of the current rayon pool, in `T`: f64 is the reference, f32 the
/// product.
pub struct CpuPointVisibility<'a, T> {
    surfels: &'a Surfels,
    test: PointTest,
    points: PointTree,
    real: PhantomData<T>,
}

impl<'a, T: Real> CpuPointVisibility<'a, T> {
    pub fn new(surfels: &'a Surfels, test: PointTest) -> Self {
        CpuPointVisibility {
            surfels,
            test,
            points: PointTree::build(surfels, test.radius),
            real: PhantomData,
        }
    }
}

impl<T: Real> PointVisibility for CpuPointVisibility<'_, T> {
    fn visible(&self, pairs: &[[u32; 2]]) -> Result<Vec<bool>> {
        of_facing(self.surfels, pairs, |facing| {
            Ok(facing
                .par_iter()
                .with_min_len(64)
                .map(|&pair| {
                    let segment = segment_of(self.surfels, pair);
                    self.test.passes::<T>(&self.points, &segment)
                })
                .collect())
        })
    }
}

impl PointTest {
    /// Everything that faces is visible.
    pub fn is_open(&self) -> bool {
        self.threshold < 0.0
    }

    /// Δ², in squares of the spacing.
    pub fn limit(&self) -> f32 {
        self.radius * self.radius
    }

    /// Entries of the look-up table a spacing.
    pub fn steps(&self) -> f32 {
        (LOOKUP - 1) as f32 / self.radius
    }

    /// Whether two points that face each other also see each other, by the segment between them.
    pub fn passes<T: Real>(&self, points: &PointTree, segment: &Segment) -> bool {
        if self.is_open() {
            return true;
        }
        let threshold = T::from_f32(self.threshold);
        let limit = T::from_f32(self.limit());
        let (p, q) = ends::<T>(segment);
        let ends = Ends::<T>::new(p, q);
        let mut closest = Closest::<T>::new(self.closest);
        let mut part = 1.0;
        walk::<false>(
            &points.wide,
            &line(segment),
            &mut part,
            &mut |part, range| {
                for point in &points.points[range] {
                    let crossing = ends.crossing(point, limit);
                    if crossing >= limit || excludes(segment, point.surfel) {
                        continue;
                    }
                    // What alone is enough needs no others.
                    if self.look_up(crossing.sqrt()) <= threshold {
                        *part = -1.0;
                        return;
                    }
                    closest.add(Occluder {
                        distance: ends.distance(point),
                        surfel: point.surfel,
                        crossing,
                    });
                }
            },
        );
        part >= 0.0 && closest.visibility(self) > threshold
    }

    /// Visibility past an occluder whose plane is crossed this far from it, in spacings.
    fn look_up<T: Real>(&self, distance: T) -> T {
        let place = distance * T::from_f32(self.steps());
        if place < T::from_f64((LOOKUP - 1) as f64) {
            let cell = place.to_f64() as usize;
            let [low, high] = [cell, cell + 1].map(|k| T::from_f32(self.lookup[k]));
            low + (high - low) * (place - T::from_f32(cell as f32))
        } else {
            T::ONE
        }
    }
}

/// The segment between two surfels, from that of lower number: the order of a pair does not count.
pub fn segment_of(surfels: &Surfels, [i, j]: [u32; 2]) -> Segment {
    surfels.segment(i.min(j) as usize, i.max(j) as usize)
}

/// The segment between two points.
struct Ends<T: Real> {
    p: T::Vec3,
    q: T::Vec3,
    way: T::Vec3,
    length_squared: T,
}

/// A point that the segment may be blocked by.
#[derive(Clone, Copy, Debug, Default)]
struct Occluder<T> {
    /// Square of its distance from the segment, in spacings.
    distance: T,
    surfel: u32,
    /// Square of its distance, in its plane, from where the segment crosses it.
    crossing: T,
}

impl<T: Real> Ends<T> {
    fn new(p: T::Vec3, q: T::Vec3) -> Self {
        let way = q - p;
        Ends {
            p,
            q,
            way,
            length_squared: way.dot(way),
        }
    }

    /// Square of the distance from a point, in its plane, to where the segment crosses it, in
    /// spacings; Δ² if the point is no occluder.
    fn crossing(&self, point: &PointOccluder, limit: T) -> T {
        let x = vector::<T>(point.position);
        let normal = vector::<T>(point.normal);
        let p = self.p - x;
        let q = self.q - x;
        let a = p.dot(normal);
        let b = q.dot(normal);
        let crosses = (a < T::ZERO && b > T::ZERO) || (a > T::ZERO && b < T::ZERO);
        if !crosses {
            return limit;
        }
        let inverse = T::ONE / (b - a);
        let hit = (p * b - q * a) * inverse;
        let squared = hit.dot(hit);
        let to_end = lesser(a * a, b * b) * (inverse * inverse) * self.length_squared;
        if squared < to_end {
            lesser(squared * T::from_f32(point.inverse_area), limit)
        } else {
            limit
        }
    }

    /// Square of the distance of a point from the segment, in spacings.
    fn distance(&self, point: &PointOccluder) -> T {
        let p = self.p - vector::<T>(point.position);
        let along = -p.dot(self.way) * (T::ONE / self.length_squared);
        let across = p + self.way * along;
        across.dot(across) * T::from_f32(point.inverse_area)
    }
}

/// The occluders closest to the segment, nearest first; of two at one distance the one of lower
/// number.
struct Closest<T> {
    found: [Occluder<T>; MAX_CLOSEST],
    count: usize,
    most: usize,
}

impl<T: Real> Closest<T> {
    fn new(most: u32) -> Self {
        Closest {
            found: [Occluder::default(); MAX_CLOSEST],
            count: 0,
            most: (most as usize).min(MAX_CLOSEST),
        }
    }

    fn add(&mut self, mut new: Occluder<T>) {
        for old in &mut self.found[..self.count] {
            let first = new.distance < old.distance
                || (new.distance == old.distance && new.surfel < old.surfel);
            if first {
                std::mem::swap(&mut new, old);
            }
        }
        if self.count < self.most {
            self.found[self.count] = new;
            self.count += 1;
        }
    }

    /// The product over those that are crossed closest to their middle.
    fn visibility(&self, test: &PointTest) -> T {
        let mut nearest = [T::from_f32(FAR); 3];
        for occluder in &self.found[..self.count] {
            let mut crossing = occluder.crossing;
            for kept in &mut nearest {
                if crossing < *kept {
                    std::mem::swap(&mut crossing, kept);
                }
            }
        }
        let [a, b, c] = nearest.map(|squared| test.look_up(squared.sqrt()));
        a * b * c
    }
}

#[inline(always)]
fn lesser<T: Real>(a: T, b: T) -> T {
    if a < b { a } else { b }
}
