//! The radiosity equation.
//!
//! With H₀ the irradiance straight from the lights and ρ the reflectance, the reflected radiosity
//! R = ρ H solves (I - ρF) R = ρ H₀.

use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::operator::{Fields, TransportOperator};
use crate::progress::Progress;

type Field<O> = <<O as TransportOperator>::Fields as Fields>::Field;

/// When to stop.
#[derive(Clone, Copy, Debug)]
pub struct Stop {
    /// Relative L2 residual to reach.
    pub residual: f64,
    /// Bounces to follow one by one; `None` lets the Krylov method go until the residual is there.
    pub bounces: Option<u32>,
}

/// Where the solver ended.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Ended {
    /// Applications of the operator.
    pub iterations: u32,
    /// |ρH₀ - (I - ρF) R| / |ρH₀|; after a number of bounces the size of the last one instead.
    pub residual: f64,
    /// Whether the residual asked for was reached.
    pub converged: bool,
}

/// Largest number of Krylov vectors kept: memory of as many fields. Diffuse transport converges in
/// 5 to 9 steps (reflectance 0.5 to 0.99).
const KRYLOV: usize = 30;

/// Bounces as faint as this, relative to the first, are the last.
const FADED: f64 = 1e-8;
/// Parts of a unit vector as small as this are rounding, in units of that of the fields.
const BREAKDOWN: f64 = 32.0;

/// Solves (I - ρF) R = source, with source = ρH₀, starting from `start` or from the source.
pub fn solve<O: TransportOperator>(
    operator: &O,
    reflectance: &Field<O>,
    source: &Field<O>,
    start: Option<Field<O>>,
    stop: Stop,
    progress: &dyn Progress,
) -> Result<(Field<O>, Ended)> {
    let fields = operator.fields();
    let norm = fields.dot(source, source)?.sqrt();
    if norm == 0.0 {
        let ended = Ended {
            iterations: 0,
            residual: 0.0,
            converged: true,
        };
        return Ok((fields.copy(source)?, ended));
    }
    match stop.bounces {
        Some(bounces) => series(operator, reflectance, source, norm, bounces, progress),
        None => {
            let start = match start {
                Some(field) => field,
                None => fields.copy(source)?,
            };
            gmres(
                operator,
                reflectance,
                source,
                norm,
                start,
                stop.residual,
                progress,
            )
        }
    }
}

/// ρ F x
fn reflect<O: TransportOperator>(
    operator: &O,
    reflectance: &Field<O>,
    x: &Field<O>,
) -> Result<Field<O>> {
    let mut y = operator.apply(x)?;
    operator.fields().multiply(reflectance, &mut y)?;
    Ok(y)
}

/// The first terms of the Neumann series, one a bounce: after `bounces` bounces of reflected
/// light, the source being the first.
fn series<O: TransportOperator>(
    operator: &O,
    reflectance: &Field<O>,
    source: &Field<O>,
    norm: f64,
    bounces: u32,
    progress: &dyn Progress,
) -> Result<(Field<O>, Ended)> {
    let fields = operator.fields();
    let mut sum = fields.copy(source)?;
    let mut term = fields.copy(source)?;
    let mut iterations = 0;
    if bounces == 0 {
        fields.scale(0.0, &mut sum)?;
    }
    progress.stage("bounces", u64::from(bounces));
    for _ in 1..bounces {
        progress.check()?;
        term = reflect(operator, reflectance, &term)?;
        fields.axpy(1.0, &term, &mut sum)?;
        progress.advance(1);
        iterations += 1;
        if fields.dot(&term, &term)?.sqrt() <= FADED * norm {
            break;
        }
    }
    // The part asked for is exact: what would come after is not counted as missing.
    let ended = Ended {
        iterations,
        residual: fields.dot(&term, &term)?.sqrt() / norm,
        converged: true,
    };
    Ok((sum, ended))
}

/// GMRES (Saad and Schultz 1986) with Givens rotations, no restart.
///
/// A step reads from the device twice, however many vectors there are: classical Gram-Schmidt takes
/// all products at once, and done twice it leaves the vectors orthogonal to rounding (Giraud,
/// Langou, Rozložník and van den Eshof 2005), as the modified one does not.
fn gmres<O: TransportOperator>(
    operator: &O,
    reflectance: &Field<O>,
    source: &Field<O>,
    norm: f64,
    mut x: Field<O>,
    wanted: f64,
    progress: &dyn Progress,
) -> Result<(Field<O>, Ended)> {
    let fields = operator.fields();
    let breakdown = BREAKDOWN * O::Fields::EPSILON;
    let residual = |x: &Field<O>| -> Result<Field<O>> {
        let mut r = reflect(operator, reflectance, x)?;
        fields.axpy(-1.0, x, &mut r)?;
        fields.axpy(1.0, source, &mut r)?;
        Ok(r)
    };
    progress.stage("bounces", KRYLOV as u64);
    let mut first = residual(&x)?;
    let beta = fields.dot(&first, &first)?.sqrt();
    let mut iterations = 1;
    let mut remaining = beta;
    let mut basis = Vec::new();
    // Upper triangle of the rotated Hessenberg matrix, a column a step.
    let mut columns: Vec<Vec<f64>> = Vec::new();
    let mut rotations: Vec<(f64, f64)> = Vec::new();
    let mut rhs = vec![beta];
    if remaining > wanted * norm {
        fields.scale(1.0 / beta, &mut first)?;
        basis.push(first);
    }
    while remaining > wanted * norm && columns.len() < KRYLOV && remaining.is_finite() {
        progress.check()?;
        let last = &basis[basis.len() - 1];
        let mut w = reflect(operator, reflectance, last)?;
        iterations += 1;
        // w = (I - ρF) v
        fields.scale(-1.0, &mut w)?;
        fields.axpy(1.0, last, &mut w)?;
        let mut column = vec![0.0; basis.len()];
        let mut square = 0.0;
        for _ in 0..2 {
            let others: Vec<_> = basis.iter().chain([&w]).collect();
            let products = fields.dots(&others, &w)?;
            let along = &products[..basis.len()];
            let terms: Vec<_> = along.iter().map(|h| -h).zip(&basis).collect();
            fields.add(&terms, &mut w)?;
            column.iter_mut().zip(along).for_each(|(c, h)| *c += h);
            // Pythagoras: the second time next to nothing is taken off.
            square = products[basis.len()] - along.iter().map(|h| h * h).sum::<f64>();
        }
        let length = square.max(0.0).sqrt();
        for (k, &(c, s)) in rotations.iter().enumerate() {
            let (upper, lower) = (column[k], column[k + 1]);
            column[k] = c * upper + s * lower;
            column[k + 1] = c * lower - s * upper;
        }
        let k = column.len() - 1;
        let r = column[k].hypot(length);
        if r <= breakdown {
            break; // singular, as where nothing is absorbed and nothing gets out
        }
        let (c, s) = (column[k] / r, length / r);
        column[k] = r;
        rotations.push((c, s));
        columns.push(column);
        rhs.push(-s * rhs[k]);
        rhs[k] *= c;
        remaining = rhs[k + 1].abs();
        progress.advance(1);
        // The solution is in the space: what is left of a unit vector is rounding.
        if length <= breakdown {
            break;
        }
        fields.scale(1.0 / length, &mut w)?;
        basis.push(w);
    }
    let mut weights = vec![0.0; columns.len()];
    for k in (0..columns.len()).rev() {
        let known: f64 = (k + 1..columns.len())
            .map(|j| columns[j][k] * weights[j])
            .sum();
        weights[k] = (rhs[k] - known) / columns[k][k];
    }
    let terms: Vec<_> = weights.into_iter().zip(&basis).collect();
    fields.add(&terms, &mut x)?;
    let ended = Ended {
        iterations,
        residual: remaining / norm,
        converged: remaining <= wanted * norm,
    };
    Ok((x, ended))
}
