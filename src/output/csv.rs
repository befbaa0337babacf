//! Lit point clouds as text.

use std::fmt::Write;
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::rows::{BLOCK, GRAIN, Lit};
use super::write_atomic;
use crate::error::Result;
use crate::map::IlluminationMap;
use crate::points::{Grid, PointCloud};

const HEADER: &str = "x,y,z,nx,ny,nz,red,green,blue,radius,irradiance_r,irradiance_g,irradiance_b,\
                      radiosity_r,radiosity_g,radiosity_b,in_transport\n";
/// Most decimals that a grid is given with.
const MOST_DECIMALS: i32 = 12;

/// Writes all points of a cloud with their light, in the cloud's order, as comma-separated values
/// with a line of names.
///
/// Coordinates have the decimals of the source's grid; all other numbers have the digits that
/// reading them back needs.
///
/// # Errors
/// [`Error::Invalid`](crate::Error::Invalid) if cloud and map differ in length,
/// [`Error::Io`](crate::Error::Io) if writing fails.
pub fn write_csv(path: &Path, cloud: &PointCloud, map: &IlluminationMap) -> Result<()> {
    let lit = Lit::new(cloud, map)?;
    let digits = Digits::of(cloud);
    let lines = |begin: usize, end: usize| {
        let mut text = String::new();
        for i in begin..end {
            digits.put(&mut text, cloud.positions[i]);
            for x in lit.normal(i).to_array() {
                put(&mut text, x);
            }
            for x in lit.colour(i) {
                put(&mut text, x);
            }
            put(&mut text, map.radius[i]);
            for light in [map.irradiance[i], map.radiosity[i]] {
                for x in light.to_array() {
                    put(&mut text, x);
                }
            }
            text.push(if map.in_transport[i] { '1' } else { '0' });
            text.push('\n');
        }
        text
    };
    let n = lit.len();
    write_atomic(path, |writer| {
        writer.write_all(HEADER.as_bytes())?;
        for begin in (0..n).step_by(BLOCK) {
            let end = n.min(begin + BLOCK);
            let texts: Vec<String> = (begin..end)
                .into_par_iter()
                .step_by(GRAIN)
                .map(|begin| lines(begin, end.min(begin + GRAIN)))
                .collect();
            for text in texts {
                writer.write_all(text.as_bytes())?;
            }
        }
        Ok(())
    })
}

/// A number in as many digits as reading it back needs, and a comma.
fn put(text: &mut String, number: impl std::fmt::Display) {
    // Writing to a string cannot fail.
    let _ = write!(text, "{number},");
}

/// How coordinates are written.
enum Digits {
    /// All are f32.
    Single,
    Double,
    /// On a grid of decimal steps.
    Decimals(usize),
}

impl Digits {
    fn of(cloud: &PointCloud) -> Self {
        if let Some(decimals) = cloud.grid.as_ref().and_then(decimals) {
            return Digits::Decimals(decimals);
        }
        let single = |p: &DVec3| p.is_nan() || p.as_vec3().as_dvec3() == *p;
        match cloud.positions.par_iter().all(single) {
            true => Digits::Single,
            false => Digits::Double,
        }
    }

    fn put(&self, text: &mut String, position: DVec3) {
        for x in position.to_array() {
            match *self {
                Digits::Single => put(text, x as f32),
                Digits::Double => put(text, x),
                Digits::Decimals(decimals) => put(text, format_args!("{x:.decimals$}")),
            }
        }
    }
}

/// Decimals with which every place on a grid can be told; `None` if its steps are not decimal.
fn decimals(grid: &Grid) -> Option<usize> {
    let numbers = [grid.scale, grid.offset].map(|v| v.to_array());
    let whole = |&decimals: &i32| {
        numbers.as_flattened().iter().all(|x| {
            let x = x * 10f64.powi(decimals);
            (x - x.round()).abs() < 1e-6
        })
    };
    (0..=MOST_DECIMALS).find(whole).map(|d| d as usize)
}
