//! Signs that are known relative to each other, and found from votes on pairs.

use std::collections::HashMap;

use rayon::prelude::*;

/// Things whose signs are known relative to each other, in groups.
pub(super) struct Signs {
    parents: Vec<u32>,
    /// Whether one has the sign opposite to its parent's.
    opposite: Vec<bool>,
    sizes: Vec<u32>,
}

/// Says of two how surely their signs are alike, or opposite if it is negative.
pub(super) type Vote = (u32, u32, f64);

impl Signs {
    pub fn new(n: usize) -> Signs {
        Signs {
            parents: (0..n as u32).collect(),
            opposite: vec![false; n],
            sizes: vec![1; n],
        }
    }

    /// The group of one, and whether its sign is opposite to that of the group.
    pub fn find(&mut self, mut i: u32) -> (u32, bool) {
        let mut opposite = false;
        loop {
            let parent = self.parents[i as usize];
            if parent == i {
                return (i, opposite);
            }
            // Halves the way.
            let above = self.parents[parent as usize];
            let signs = [i, parent].map(|k| self.opposite[k as usize]);
            if above != parent {
                self.parents[i as usize] = above;
                self.opposite[i as usize] = signs[0] != signs[1];
                opposite ^= signs[0] != signs[1];
                i = above;
            } else {
                return (parent, opposite ^ signs[0]);
            }
        }
    }

    /// Joins the groups of two whose signs are opposite or alike.
    pub fn join(&mut self, i: u32, j: u32, opposite: bool) {
        let ((a, flip_a), (b, flip_b)) = (self.find(i), self.find(j));
        if a == b {
            return;
        }
        let (large, small) = match self.sizes[a as usize] >= self.sizes[b as usize] {
            true => (a, b),
            false => (b, a),
        };
        self.parents[small as usize] = large;
        self.opposite[small as usize] = opposite ^ flip_a ^ flip_b;
        self.sizes[large as usize] += self.sizes[small as usize];
    }

    pub fn all(&mut self) -> Vec<(u32, bool)> {
        (0..self.parents.len() as u32)
            .map(|i| self.find(i))
            .collect()
    }

    /// Joins groups as votes say: each with the one that has most to say about it, then what came out of
    /// that (Borůvka's algorithm, with votes added up between groups).
    pub fn vote(&mut self, mut votes: Vec<Vote>) {
        loop {
            for (i, j, agree) in &mut votes {
                let ((a, flip_a), (b, flip_b)) = (self.find(*i), self.find(*j));
                (*i, *j) = (a.min(b), a.max(b));
                *agree = if flip_a != flip_b { -*agree } else { *agree };
            }
            votes.retain(|&(a, b, _)| a != b);
            votes = summed(votes);
            if votes.is_empty() {
                return;
            }
            let mut best: HashMap<u32, usize> = HashMap::new();
            for (k, &(a, b, agree)) in votes.iter().enumerate() {
                for group in [a, b] {
                    let best = best.entry(group).or_insert(k);
                    if votes[*best].2.abs() < agree.abs() {
                        *best = k;
                    }
                }
            }
            let mut chosen: Vec<usize> = best.into_values().collect();
            chosen.sort_unstable_by(|&k, &l| {
                let sureness = |k: usize| votes[k].2.abs();
                sureness(l).total_cmp(&sureness(k)).then(k.cmp(&l))
            });
            for k in chosen {
                let (a, b, agree) = votes[k];
                self.join(a, b, agree < 0.0);
            }
        }
    }
}

/// One vote a pair: the sum.
pub(super) fn summed(mut votes: Vec<Vote>) -> Vec<Vote> {
    votes.par_sort_by_key(|&(a, b, _)| (a, b));
    votes.dedup_by(|next, sum| {
        let same = (next.0, next.1) == (sum.0, sum.1);
        sum.2 += if same { next.2 } else { 0.0 };
        same
    });
    votes
}
