//! Fewer points, evenly.

use std::collections::HashMap;

use glam::{IVec3, Vec3};

use crate::random::{Purpose, stream};
use rand::Rng;

/// Cosine between normals above which points stand for the same piece of surface.
const SAME_SIDE: f32 = 0.5;
/// A choice of this part of the points wanted, or more, is near enough.
const NEAR_ENOUGH: f64 = 0.9;
/// Looks for the spacing that leaves as many points as are wanted.
const LOOKS: usize = 12;

/// For each point the one that stands for it: itself, or one nearer than `spacing` that faces the same
/// way. No two that stand for themselves are as near as that (Poisson discs, by throwing all points in
/// random order: Cook, "Stochastic sampling in computer graphics", 1986).
pub(super) fn spread(positions: &[Vec3], normals: &[Vec3], spacing: f32) -> Vec<u32> {
    // Cells of the grid are numbered in 32 bits.
    let extent = positions
        .iter()
        .fold(0.0, |e: f32, p| e.max(p.abs().max_element()));
    let spacing = spacing.max(1e-9 * extent);
    let cell = |p: Vec3| (p / spacing).floor().as_ivec3();
    let mut kept: HashMap<IVec3, Vec<u32>> = HashMap::new();
    let mut keepers: Vec<u32> = vec![0; positions.len()];
    for i in order(positions.len()) {
        let (place, normal) = (positions[i as usize], normals[i as usize]);
        let middle = cell(place);
        let nearest = around()
            .filter_map(|step| kept.get(&(middle + step)))
            .flatten()
            .map(|&k| (positions[k as usize].distance(place), k))
            .filter(|&(far, k)| far < spacing && normals[k as usize].dot(normal) > SAME_SIDE)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        keepers[i as usize] = match nearest {
            Some((_, keeper)) => keeper,
            None => {
                kept.entry(middle).or_default().push(i);
                i
            }
        };
    }
    keepers
}

/// The same with a spacing that leaves `most` points or a few less.
pub(super) fn spread_to(positions: &[Vec3], normals: &[Vec3], most: usize) -> Vec<u32> {
    let all = 0..positions.len() as u32;
    if positions.len() <= most {
        return all.collect();
    }
    let (min, max) = (positions.iter()).fold((Vec3::MAX, Vec3::MIN), |(min, max), &p| {
        (min.min(p), max.max(p))
    });
    // As if they filled a sphere; then towards what that leaves.
    let mut spacing = (max - min).length() / (most as f32).sqrt();
    let (mut few, mut many) = (None, 0.0);
    for _ in 0..LOOKS {
        let keepers = spread(positions, normals, spacing);
        let kept = all.clone().zip(&keepers).filter(|(i, k)| i == *k).count();
        let part = kept as f64 / most as f64;
        if part <= 1.0 {
            few = Some((keepers, spacing));
            if part >= NEAR_ENOUGH {
                break;
            }
        } else {
            many = spacing;
        }
        // Points on a surface go with the square; between what was too many and too few.
        let next = spacing * (part / (0.5 + 0.5 * NEAR_ENOUGH)).sqrt() as f32;
        spacing = match few {
            Some((_, few)) if next <= many || next >= few => 0.5 * (many + few),
            _ => next.max(1.01 * many),
        };
    }
    match few {
        Some((keepers, _)) => keepers,
        None => spread(positions, normals, 2.0 * (max - min).length()),
    }
}

/// 0..n in an order that is random, but always the same.
fn order(n: usize) -> Vec<u32> {
    let mut order: Vec<(u32, u32)> = (0..n)
        .map(|i| (stream(0, Purpose::Thin, i as u64).next_u32(), i as u32))
        .collect();
    order.sort_unstable();
    order.into_iter().map(|(_, i)| i).collect()
}

/// The cells around a cell of a grid, itself first.
fn around() -> impl Iterator<Item = IVec3> {
    let at = |k: i32| [0, -1, 1][k as usize % 3];
    (0..27).map(move |k| IVec3::new(at(k), at(k / 3), at(k / 9)))
}
