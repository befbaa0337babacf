//! Whether two points see each other, judged by the points between them: section 2.2.4.1 of the
//! report. `shaders/point_visible.wgsl` does the same in the same order.
//!
//! Possible occluders are the points in a cylinder around the segment whose tangent planes it
//! crosses; of these the k closest to the segment count. Each is a piece of its plane, opaque in
//! the middle and clear from the distance Δ on; the three that are crossed closest to their middle
//! decide. (The report takes the k closest first and then asks for the planes. But a segment that
//! leaves a wall at a flat angle has more points of this wall beside it than any small k, and they
//! would crowd out the occluders.)
//!
//! A point stands for the surface only where it is nearer than the ends of the segment: what is
//! nearer to an end is the end's own piece of surface. On a plane and outside of a sphere this
//! excludes the neighbours of an end exactly (the plane of a neighbour is crossed on the end's side
//! of the bisector, for beyond it the neighbour's plane lies below that of the end); inside of a
//! sphere no tangent plane is crossed at all. What is crossed within Δ and nearer than the ends lies
//! in the cylinder.

use std::marker::PhantomData;

use bytemuck::{Pod, Zeroable};
use glam::Vec3A;
use rayon::prelude::*;

use crate::error::Result;
use crate::math::{Real, Vector};
use crate::points::Surfels;

use super::bvh::{Item, hierarchy};
use super::pairs::of_facing;
use super::segment::{inverse, meets_box, vector};
use super::{Node, PointVisibility};

/// Entries of the look-up table.
pub const LOOKUP: usize = 6;
/// Most occluders of a pair that count.
pub const MAX_CLOSEST: usize = 16;

/// The parameters of the test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointTest {
    /// How many possible occluders closest to the segment count: k, up to [`MAX_CLOSEST`].
    pub closest: u32,
    /// Radius of the cylinder around the segment, in spacings (square roots of the area) of the
    /// point that lies in it or not: Δ.
    pub radius: f32,
    /// Visibility past an occluder, by the distance in its plane from it to the segment: entries at
    /// equal steps from 0 to Δ, linear between them, 1 from Δ on.
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
pub struct Point {
    pub position: [f32; 3],
    pub surfel: u32,
    pub normal: [f32; 3],
    /// One over the square of its spacing.
    pub inverse_area: f32,
}

/// The points of a cloud under a hierarchy that finds those around a segment.
#[derive(Clone, Debug)]
pub struct Points {
    /// Over the discs of radius Δ around the points.
    pub nodes: Vec<Node>,
    /// In the order of the leaves.
    pub points: Vec<Point>,
    /// Where the surfels are among the points.
    pub places: Vec<u32>,
}

impl Points {
    /// Points without an area are in nobody's way.
    pub fn build(surfels: &Surfels, radius: f32) -> Points {
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
        let mut places = vec![0; discs.len()];
        for (place, disc) in discs.iter().enumerate() {
            places[disc.surfel as usize] = place as u32;
        }
        let point = |disc: &Item| {
            let i = disc.surfel as usize;
            Point {
                position: surfels.positions[i].to_array(),
                surfel: disc.surfel,
                normal: surfels.normals[i].to_array(),
                inverse_area: 1.0 / surfels.areas[i],
            }
        };
        Points {
            nodes,
            points: discs.par_iter().map(point).collect(),
            places,
        }
    }

    /// Where the points of a pair are, the surfel of lower number first: so the order of a pair
    /// does not count.
    pub fn places_of(&self, pair: [u32; 2]) -> [u32; 2] {
        let [i, j] = pair;
        [i.min(j), i.max(j)].map(|i| self.places[i as usize])
    }
}

/// Decides pairs on all threads of the current rayon pool, in `T`: f64 is the reference, f32 the
/// product.
pub struct CpuPointVisibility<'a, T> {
    surfels: &'a Surfels,
    test: PointTest,
    points: Points,
    real: PhantomData<T>,
}

impl<'a, T: Real> CpuPointVisibility<'a, T> {
    pub fn new(surfels: &'a Surfels, test: PointTest) -> Self {
        CpuPointVisibility {
            surfels,
            test,
            points: Points::build(surfels, test.radius),
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
                .map(|&pair| self.test.passes::<T>(&self.points, pair))
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

    /// Whether two points that face each other also see each other.
    pub fn passes<T: Real>(&self, points: &Points, pair: [u32; 2]) -> bool {
        if self.is_open() {
            return true;
        }
        let threshold = T::from_f32(self.threshold);
        let limit = T::from_f32(self.limit());
        let places = points.places_of(pair);
        let [p, q] = places.map(|at| vector::<T>(points.points[at as usize].position));
        let ends = Ends::<T>::new(p, q);
        let mut closest = Closest::<T>::new(self.closest);
        let inverse = (q - p).to_array().map(inverse);
        let mut i = 0;
        while let Some(node) = points.nodes.get(i) {
            if !meets_box(node, p.to_array(), inverse) {
                i += node.skip as usize;
                continue;
            }
            for at in node.occluders() {
                if places.contains(&(at as u32)) {
                    continue;
                }
                let point = &points.points[at];
                let crossing = ends.crossing(point, limit);
                if !(crossing < limit) {
                    continue;
                }
                // What alone is enough needs no others.
                if self.look_up(crossing.sqrt()) <= threshold {
                    return false;
                }
                closest.add(Occluder {
                    distance: ends.distance(point),
                    surfel: point.surfel,
                    crossing,
                });
            }
            i += 1;
        }
        closest.visibility(self) > threshold
    }

    /// Visibility past an occluder whose plane is crossed this far from it, in spacings.
    fn look_up<T: Real>(&self, distance: T) -> T {
        let place = distance * T::from_f32(self.steps());
        if !(place < T::from_f64((LOOKUP - 1) as f64)) {
            return T::ONE;
        }
        let cell = place.to_f64() as usize;
        let [low, high] = [cell, cell + 1].map(|k| T::from_f32(self.lookup[k]));
        low + (high - low) * (place - T::from_f32(cell as f32))
    }
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
    fn crossing(&self, point: &Point, limit: T) -> T {
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
    fn distance(&self, point: &Point) -> T {
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
        let mut nearest = [T::from_f32(test.limit()); 3];
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
