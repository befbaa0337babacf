//! Finding the links: a dual traversal of the octree, level by level.
//!
//! A pair of facets becomes a link once the error that it can make is small against what is
//! allowed; otherwise the larger facet is split. What stands between the facets is found by tested
//! segments: a few decide whether the link is accepted, and fresh ones measure it, because the
//! samples that accepted a link would be biased (narrow openings would vanish).
//!
//! The pairs of one level are judged together, so that their segments are tested in large batches
//! on whichever backend there is, and the result does not depend on the number of threads.

use rayon::prelude::*;

use super::judge::{Candidate, Judge, Outcome, Pair, Sample, Trial, Verdict};
use super::{Accuracy, Entry, Links, Rows, splits_target};
use crate::error::{Error, Result};
use crate::expansion::{Indices, Surface};
use crate::memory;
use crate::octree::Octree;
use crate::points::Surfels;
use crate::progress::Progress;
use crate::random::Purpose;
use crate::visibility::{Segment, Visibility};

/// Units of progress: a pair that splits hands its share on to its children in equal parts.
const SHARES: u64 = 1 << 20;
/// Pairs of facets judged in one batch.
const BATCH: usize = 1 << 15;

/// Part of the error of expansions of order 0 and 1 that has the same sign in all links of a surfel: at
/// order 0 that of its place in the facet, at order 1 that of the kernel's curvature.
const BIAS: [f64; 2] = [0.25, 0.1];
/// Error of a sampled link that brings too little to matter, as a part of what it can bring.
const SAMPLED: f32 = 0.3;

/// Finds the links of all surfels by the rules above.
pub fn build(
    surfels: &Surfels,
    octree: &Octree,
    accuracy: &Accuracy,
    visibility: &dyn Visibility,
    progress: &dyn Progress,
) -> Result<Links> {
    let all = [[0, 0]];
    Ok(build_from(&all, surfels, octree, accuracy, visibility, progress)?.links)
}

/// What is found below some pairs of facets.
pub(super) struct Found {
    pub links: Links,
    /// Pairs that bring too little to be linked, as far as samples tell.
    pub left_out: Vec<[u32; 2]>,
}

/// Finds the links of the surfels in pairs of facets, target and source.
pub(super) fn build_from(
    pairs: &[[u32; 2]],
    surfels: &Surfels,
    octree: &Octree,
    accuracy: &Accuracy,
    visibility: &dyn Visibility,
    progress: &dyn Progress,
) -> Result<Found> {
    let surface = Surface::new(surfels);
    let indices = Indices::new(accuracy.order);
    let mut traversal = Traversal {
        surfels,
        judge: Judge {
            surface: &surface,
            octree,
            accuracy,
            open: visibility.is_open(),
        },
        visibility,
        indices: &indices,
        m2l: vec![Vec::new(); accuracy.order + 1],
        p2p: Vec::new(),
        mixed: Vec::new(),
        sampled: Vec::new(),
        near: Vec::new(),
        left_out: Vec::new(),
        smooth: 0,
        errors: 0.0,
        bias: 0.0,
        done: 0.0,
    };
    let free = memory::available();
    progress.stage("links", SHARES);
    let mut reported = 0;
    let share = 1.0 / pairs.len() as f32;
    let pair = |&[target, source]: &[u32; 2]| Pair {
        target,
        source,
        share,
    };
    let mut level: Vec<Pair> = pairs.iter().map(pair).collect();
    while !level.is_empty() {
        let mut next = Vec::new();
        for batch in level.chunks(BATCH) {
            progress.check()?;
            traversal.sort(batch, &mut next)?;
            traversal.check_memory(level.len() + next.len(), free)?;
            let done = (traversal.done * SHARES as f64) as u64;
            progress.advance(done.saturating_sub(reported));
            reported = reported.max(done);
        }
        level = next;
    }
    let entries = traversal.lists().map(Vec::len).max().unwrap_or(0);
    if entries > u32::MAX as usize {
        return Err(Error::TooLarge(format!(
            "{entries} links are more than one operator can hold: ask for a larger tolerance"
        )));
    }
    let facets = octree.facets.len();
    let expected_error = traversal.expected_error();
    let links = Links {
        m2l: traversal
            .m2l
            .into_iter()
            .map(|entries| Rows::new(facets, entries))
            .collect(),
        p2p: Rows::new(facets, traversal.p2p),
        mixed: Rows::new(facets, traversal.mixed),
        smooth: traversal.smooth,
        sampled: Rows::new(facets, traversal.sampled),
        near: Rows::new(surfels.len(), traversal.near),
        expected_error,
        ..Links::none(facets, surfels.len())
    };
    Ok(Found {
        links,
        left_out: traversal.left_out,
    })
}

struct Traversal<'a> {
    surfels: &'a Surfels,
    judge: Judge<'a>,
    visibility: &'a dyn Visibility,
    indices: &'a Indices,
    /// By order.
    m2l: Vec<Vec<Entry>>,
    p2p: Vec<Entry>,
    mixed: Vec<Entry>,
    sampled: Vec<Entry>,
    near: Vec<Entry>,
    left_out: Vec<[u32; 2]>,
    smooth: u64,
    /// Sum over the surfels of the squares of the errors of their links.
    errors: f64,
    /// And of the errors that have one sign.
    bias: f64,
    /// Share of the whole traversal that is done.
    done: f64,
}

impl Traversal<'_> {
    fn lists(&self) -> impl Iterator<Item = &Vec<Entry>> {
        self.m2l
            .iter()
            .chain([&self.p2p, &self.mixed, &self.sampled, &self.near])
    }

    /// Refuses links that would not fit into the memory that was free at the start.
    fn check_memory(&self, pairs: usize, free: Option<u64>) -> Result<()> {
        let links: usize = self.lists().map(Vec::len).sum();
        // A link is held as an entry, while it is sorted, and in its row.
        let needed = 3 * links * size_of::<Entry>()
            + 3 * self.left_out.len() * size_of::<[u32; 2]>()
            + pairs * size_of::<Pair>();
        let needed = needed as u64;
        match free {
            Some(free) if needed > free => Err(Error::TooLarge(format!(
                "{links} links and more to come do not fit into {} MiB of memory: ask for a larger \
                 tolerance, or take fewer points",
                free >> 20
            ))),
            _ => Ok(()),
        }
    }

    /// Sorts a batch of pairs: links go to the lists, pairs of children to `next`.
    fn sort(&mut self, batch: &[Pair], next: &mut Vec<Pair>) -> Result<()> {
        let trial = || Trial::new(self.indices);
        let verdicts: Vec<Verdict> = batch
            .par_iter()
            .map(|&pair| self.judge.classify(pair))
            .collect();
        let visible = self.test(&verdicts, Verdict::samples)?;

        let outcomes: Vec<Outcome> = verdicts
            .par_iter()
            .zip(&visible)
            .zip(batch)
            .map_init(trial, |trial, ((verdict, visible), &pair)| match verdict {
                Verdict::Candidate(c) => self.judge.decide(pair, c, visible, trial),
                _ => Outcome::Drop,
            })
            .collect();

        // Links that their samples selected are measured afresh; leaves whose samples disagree
        // exchange light surfel by surfel.
        let fresh: Vec<Vec<Sample>> = verdicts
            .par_iter()
            .zip(&outcomes)
            .zip(batch)
            .map(|((verdict, outcome), &pair)| match (verdict, outcome) {
                (Verdict::Candidate(c), Outcome::Far(..) | Outcome::Sampled(_)) if c.selected() => {
                    self.judge.draw(pair, c.measured, Purpose::MeasureLinks)
                }
                (Verdict::Candidate(_), Outcome::Near) => self.judge.all_pairs(pair),
                _ => Vec::new(),
            })
            .collect();
        let fresh_visible = self.test(&fresh, Vec::as_slice)?;
        let outcomes: Vec<Outcome> = verdicts
            .par_iter()
            .zip(outcomes)
            .zip(fresh.par_iter().zip(&fresh_visible))
            .zip(batch)
            .map_init(trial, |trial, (((verdict, outcome), fresh), &pair)| {
                let (samples, visible) = fresh;
                match verdict {
                    Verdict::Candidate(c) if c.selected() => self
                        .judge
                        .measure(pair, c, outcome, samples, visible, trial),
                    _ => outcome,
                }
            })
            .collect();

        for (k, (verdict, outcome)) in verdicts.into_iter().zip(outcomes).enumerate() {
            let pair = batch[k];
            let entry = |weight| Entry {
                target: pair.target,
                source: pair.source,
                weight,
            };
            self.done += f64::from(pair.share);
            match (verdict, outcome) {
                (Verdict::Dark, _) => self.left_out.push([pair.target, pair.source]),
                (Verdict::Drop, _) => {}
                (Verdict::Expand(order, error), _) => {
                    let biased = BIAS.get(order).copied().unwrap_or(0.0);
                    self.add_error(pair, error, biased);
                    self.m2l[order].push(entry(1.0));
                    self.smooth += 1;
                }
                (Verdict::Mixed(error), _) => {
                    self.add_error(pair, error, 0.0);
                    self.mixed.push(entry(1.0));
                }
                (Verdict::Pairs(near), _) => {
                    self.p2p.push(entry(1.0));
                    self.add_near(&near, &vec![true; near.len()]);
                }
                (Verdict::Near(samples), _) => self.add_near(&samples, &visible[k]),
                (Verdict::Candidate(_), Outcome::Near) => {
                    self.add_near(&fresh[k], &fresh_visible[k]);
                }
                (Verdict::Split, _) | (Verdict::Candidate(_), Outcome::Split) => {
                    self.done -= f64::from(pair.share);
                    self.split(pair, next);
                }
                (Verdict::Candidate(c), Outcome::Far(fraction, smooth)) if fraction > 0.0 => {
                    self.m2l[c.order].push(entry(fraction));
                    self.smooth += u64::from(smooth);
                }
                (Verdict::Candidate(c), Outcome::Sampled(kernel)) if kernel > 0.0 => {
                    self.add_error(pair, SAMPLED * c.bound, 0.0);
                    self.sampled.push(entry(kernel));
                }
                // Nothing was seen.
                (Verdict::Candidate(c), _) => self.leave_out(pair, &c),
            }
        }
        Ok(())
    }

    /// Independent errors add up by their squares, others as they are.
    fn expected_error(&self) -> f64 {
        let n = self.surfels.len() as f64;
        (self.errors / n).sqrt().hypot(self.bias / n)
    }

    /// Takes the error of a link into account, of which a part is `biased`.
    fn add_error(&mut self, pair: Pair, error: f32, biased: f64) {
        let surfels = self.judge.facets(pair).0.len() as f64;
        self.errors += f64::from(error).powi(2) * surfels;
        self.bias += f64::from(error) * biased * surfels;
    }

    /// Samples brought no light: all pairs of surfels know, some may have missed it.
    fn leave_out(&mut self, pair: Pair, candidate: &Candidate) {
        if !candidate.exhaustive {
            self.left_out.push([pair.target, pair.source]);
        }
    }

    fn add_near(&mut self, samples: &[Sample], visible: &[bool]) {
        let seen = samples.iter().zip(visible).filter(|&(_, &v)| v);
        self.near.extend(seen.map(|(s, _)| Entry {
            target: s.target,
            source: s.source,
            weight: s.weight,
        }));
    }

    /// The children of the larger facet with the other one.
    fn split(&self, pair: Pair, next: &mut Vec<Pair>) {
        let (a, b) = self.judge.facets(pair);
        if splits_target(a, b) {
            let share = pair.share / a.child_count as f32;
            let pairs = a.children().map(|target| Pair {
                target,
                share,
                ..pair
            });
            next.extend(pairs);
        } else {
            let share = pair.share / b.child_count as f32;
            let pairs = b.children().map(|source| Pair {
                source,
                share,
                ..pair
            });
            next.extend(pairs);
        }
    }

    /// Which samples see each other, in their groups; those that do not face each other are not
    /// tested.
    fn test<G: Sync>(
        &self,
        groups: &[G],
        samples: impl Fn(&G) -> &[Sample] + Sync,
    ) -> Result<Vec<Vec<bool>>> {
        let facing = |g| samples(g).iter().filter(|s| s.weight > 0.0);
        let segment = |s: &Sample| self.surfels.segment(s.target as usize, s.source as usize);
        let segments: Vec<Segment> = groups
            .par_iter()
            .flat_map_iter(|g| facing(g).map(segment))
            .collect();
        let answers = self.visibility.visible(&segments)?;
        let mut end = 0;
        let firsts: Vec<usize> = groups
            .iter()
            .map(|g| {
                end += facing(g).count();
                end - facing(g).count()
            })
            .collect();
        let of_group = |(g, first): (&G, usize)| {
            let mut answers = answers[first..].iter();
            let seen = |s: &Sample| s.weight > 0.0 && answers.next() == Some(&true);
            samples(g).iter().map(seen).collect()
        };
        Ok(groups.par_iter().zip(firsts).map(of_group).collect())
    }
}
