//! The operator by exact sums over all pairs, in f64: the truth for everything else.

use glam::DVec3;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::expansion::Surface;
use crate::memory;
use crate::operator::{HostFields, TransportOperator};
use crate::points::Surfels;
use crate::progress::Progress;
use crate::visibility::{Segment, Visibility, in_rows};

/// Exact pair sums; who sees whom is kept as one bit a pair.
pub struct Direct {
    surface: Surface<f64>,
    /// Bit j % 64 of word `i * words + j / 64`: surfel i sees surfel j.
    visible: Vec<u64>,
    words: usize,
    fields: HostFields<f64>,
}

/// Largest memory for the visibility bits: 185,000 surfels.
const MAX_BYTES: u64 = 4 << 30;

impl Direct {
    /// Tests every pair that could exchange light; the visibility of a pair is that of the segment
    /// from the lower index to the higher.
    pub fn new(
        surfels: &Surfels,
        visibility: &dyn Visibility,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let n = surfels.len();
        let words = n.div_ceil(64);
        let needed = n as u64 * words as u64 * 8;
        let free = memory::available().unwrap_or(u64::MAX).min(MAX_BYTES);
        if needed > free {
            return Err(Error::TooLarge(format!(
                "the direct method keeps one bit for each of the {n}² pairs, {} MiB, but may take \
                 {} MiB: use the fmm method",
                needed >> 20,
                free >> 20
            )));
        }
        let surface = Surface::<f64>::new(surfels);
        let mut visible = vec![0u64; n * words];
        progress.stage("visibility", n as u64);
        for block in blocks_of(n, n) {
            progress.check()?;
            let partners: Vec<Vec<u32>> = block
                .clone()
                .into_par_iter()
                .map(|i| {
                    let sees = |&j: &usize| {
                        surface.form_factor(i, j) > 0.0 || surface.form_factor(j, i) > 0.0
                    };
                    (i + 1..n).filter(sees).map(|j| j as u32).collect()
                })
                .collect();
            let tested: Vec<Segment> = block
                .clone()
                .zip(&partners)
                .flat_map(|(i, p)| p.iter().map(move |&j| surfels.segment(i, j as usize)))
                .collect();
            let mut answers = visibility.visible(&tested)?.into_iter();
            for (i, partners) in block.clone().zip(&partners) {
                for (&j, _) in partners.iter().zip(answers.by_ref()).filter(|&(_, v)| v) {
                    let j = j as usize;
                    visible[i * words + j / 64] |= 1 << (j % 64);
                    visible[j * words + i / 64] |= 1 << (i % 64);
                }
            }
            progress.advance(block.len() as u64);
        }
        Ok(Direct {
            surface,
            visible,
            words,
            fields: HostFields::default(),
        })
    }

    fn sees(&self, i: usize, j: usize) -> bool {
        self.visible[i * self.words + j / 64] >> (j % 64) & 1 == 1
    }
}

impl TransportOperator for Direct {
    type Fields = HostFields<f64>;

    fn fields(&self) -> &HostFields<f64> {
        &self.fields
    }

    fn apply(&self, radiosity: &Vec<DVec3>) -> Result<Vec<DVec3>> {
        let n = radiosity.len();
        let gather = |i: usize| -> DVec3 {
            (0..n)
                .filter(|&j| self.sees(i, j))
                .map(|j| radiosity[j] * self.surface.form_factor(i, j))
                .sum()
        };
        Ok((0..n).into_par_iter().map(gather).collect())
    }
}

/// Exact irradiance at some surfels: the row of the operator times a radiosity, and times 1 (the
/// row sum). What the error of any other way is measured against.
pub fn exact_irradiance(
    surfels: &Surfels,
    visibility: &dyn Visibility,
    receivers: &[usize],
    radiosity: &[DVec3],
) -> Result<Vec<(DVec3, f64)>> {
    let rows = exact_irradiances(surfels, visibility, receivers, [radiosity])?;
    Ok(rows.into_iter().map(|([h], sum)| (h, sum)).collect())
}

/// The same from several radiosities at once.
pub fn exact_irradiances<const FIELDS: usize>(
    surfels: &Surfels,
    visibility: &dyn Visibility,
    receivers: &[usize],
    radiosities: [&[DVec3]; FIELDS],
) -> Result<Vec<([DVec3; FIELDS], f64)>> {
    let n = surfels.len();
    let surface = Surface::<f64>::new(surfels);
    let partners = |&i: &usize| -> Vec<(usize, f64)> {
        (0..n)
            .into_par_iter()
            .map(|j| (j, surface.form_factor(i, j)))
            .filter(|&(_, f)| f > 0.0)
            .collect()
    };
    let mut rows = Vec::with_capacity(receivers.len());
    for block in blocks_of(receivers.len(), n) {
        let receivers = &receivers[block];
        let partners: Vec<_> = receivers.par_iter().map(partners).collect();
        let of_row = |(&i, partners): (&usize, &Vec<(usize, f64)>)| -> Vec<Segment> {
            let segment = |&(j, _): &(usize, f64)| surfels.segment(i.min(j), i.max(j));
            partners.iter().map(segment).collect()
        };
        let segments: Vec<Segment> = (receivers.par_iter().zip(&partners))
            .flat_map_iter(of_row)
            .collect();
        let visible = visibility.visible(&segments)?;
        let answers = in_rows(&visible, partners.iter().map(Vec::len));
        rows.par_extend(partners.par_iter().zip(answers).map(|(partners, visible)| {
            let seen = partners.iter().zip(visible).filter(|&(_, &v)| v);
            seen.fold(
                ([DVec3::ZERO; FIELDS], 0.0),
                |(mut h, sum), (&(j, f), _)| {
                    for (h, radiosity) in h.iter_mut().zip(radiosities) {
                        *h += radiosity[j] * f;
                    }
                    (h, sum + f)
                },
            )
        }));
    }
    Ok(rows)
}

/// Receivers, of `count`, in blocks whose segments fit into memory together, `n` of each.
fn blocks_of(count: usize, n: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    let size = ((1 << 22) / n.max(1)).clamp(1, 256);
    (0..count)
        .step_by(size)
        .map(move |i| i..(i + size).min(count))
}
