//! PLY vertices to a point cloud: what the properties mean.

use std::f64::consts::PI;
use std::path::Path;

use glam::{DVec3, Vec3};
use ply_rs::ply::ScalarType;
use rayon::prelude::*;

use super::{PlyFile, Rows};
use crate::colour::srgb_to_linear;
use crate::error::Result;
use crate::points::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud};
use crate::progress::Progress;
use crate::scene::BRIGHTEST;

/// Rows for one thread at a time.
const GRAIN: usize = 4096;

/// Reads a PLY file.
///
/// Understood are `x y z`, `nx ny nz`, `radius` or `area`, and as reflectance
/// `reflectance_red/green/blue` (linear) or `red green blue` (sRGB if 8 or 16 bit, linear if float),
/// and `emission_red/green/blue`; each also with the prefix `scalar_`. Other properties are skipped.
/// Areas that are no positive number become 0, which stands for unknown. Points whose coordinates
/// or normals are no numbers stay in the cloud.
pub fn read(path: &Path, progress: &dyn Progress) -> Result<PointCloud> {
    let ply = PlyFile::open(path)?;
    let mut repairs = Vec::new();
    let fields = Fields::find(&ply, &mut repairs)?;
    let count = ply.len();
    if count == 0 {
        return Err(ply.input_error("empty cloud: the file has no vertices"));
    }
    let mut cloud = PointCloud::default();
    cloud.positions.reserve_exact(count);
    let columns = fields.columns.clone();
    ply.rows(&columns, progress, &mut |rows| {
        fields.append(rows, &mut cloud)
    })?;
    if fields.reflectance.is_none() {
        cloud.reflectance = vec![Vec3::splat(DEFAULT_REFLECTANCE); count];
    }
    if fields.emission.is_none() {
        cloud.emission = vec![Vec3::ZERO; count];
    }
    repair(&mut cloud, fields.white(), &mut repairs);
    cloud.repairs = repairs;
    Ok(cloud)
}

/// How a size gives an area.
#[derive(Clone, Copy)]
enum Size {
    Area,
    Radius,
}

/// How a stored colour gives a reflectance.
enum Colour {
    Linear,
    /// Reflectance of each integer value.
    Srgb(Vec<f32>),
}

impl Colour {
    fn srgb(levels: usize) -> Self {
        let linear = |level| srgb_to_linear(level as f32 / (levels - 1) as f32);
        Colour::Srgb(
            (0..levels)
                .map(|i| linear(i).min(MAX_COLOUR_REFLECTANCE))
                .collect(),
        )
    }

    /// Values that the type cannot hold (ascii files may have them) give a number outside [0, 1].
    #[inline]
    fn reflectance(&self, value: f64) -> f32 {
        match self {
            Colour::Linear => value as f32,
            Colour::Srgb(table) => match table.get(value as usize) {
                Some(&linear) if value >= 0.0 => linear,
                _ => value as f32,
            },
        }
    }
}

/// Where the row of a vertex has what.
struct Fields {
    /// The properties of which a row is made.
    columns: Vec<usize>,
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    size: Option<(usize, Size)>,
    reflectance: Option<([usize; 3], Colour)>,
    emission: Option<[usize; 3]>,
}

impl Fields {
    fn find(ply: &PlyFile, repairs: &mut Vec<String>) -> Result<Self> {
        let mut columns = Vec::new();
        let mut one = |name: &str| {
            columns.push(ply.column(name)?);
            Some(columns.len() - 1)
        };
        let mut three = |names: [&str; 3]| match names.map(&mut one) {
            [Some(a), Some(b), Some(c)] => Some([a, b, c]),
            [None, None, None] => None,
            _ => {
                repairs.push(format!(
                    "{} left out: not all three are there",
                    names.join(" ")
                ));
                None
            }
        };
        let position = three(["x", "y", "z"]).ok_or_else(|| {
            ply.input_error("the element \"vertex\" lacks x, y or z (as single numbers)")
        })?;
        let normal = three(["nx", "ny", "nz"]);
        let linear = three(["reflectance_red", "reflectance_green", "reflectance_blue"]);
        let colour = match linear {
            Some(_) => None,
            None => three(["red", "green", "blue"]),
        };
        let emission = three(["emission_red", "emission_green", "emission_blue"]);
        let size = match one("area") {
            Some(column) => Some((column, Size::Area)),
            None => one("radius").map(|column| (column, Size::Radius)),
        };
        let colour = colour.and_then(|slots| {
            let types = slots.map(|slot| ply.scalar(columns[slot]));
            let colour = match types[0] {
                _ if types.iter().any(|&other| other != types[0]) => None,
                ScalarType::UChar => Some(Colour::srgb(1 << 8)),
                ScalarType::UShort => Some(Colour::srgb(1 << 16)),
                ScalarType::Float | ScalarType::Double => Some(Colour::Linear),
                _ => None,
            };
            if colour.is_none() {
                repairs.push(
                    "red green blue left out: only uchar, ushort and float are understood"
                        .to_owned(),
                );
            }
            Some((slots, colour?))
        });
        Ok(Fields {
            position,
            normal,
            size,
            reflectance: linear.map(|slots| (slots, Colour::Linear)).or(colour),
            emission,
            columns,
        })
    }

    /// The largest reflectance that can be meant.
    fn white(&self) -> f32 {
        match &self.reflectance {
            Some((_, Colour::Srgb(_))) => MAX_COLOUR_REFLECTANCE,
            _ => 1.0,
        }
    }

    fn append(&self, rows: Rows, cloud: &mut PointCloud) {
        let rows = rows
            .par_chunks_exact(self.columns.len())
            .with_min_len(GRAIN);
        let vector = |row: &[f64], slots: [usize; 3]| DVec3::from(slots.map(|slot| row[slot]));
        cloud
            .positions
            .par_extend(rows.clone().map(|row| vector(row, self.position)));
        if let Some(slots) = self.normal {
            cloud
                .normals
                .par_extend(rows.clone().map(|row| vector(row, slots).as_vec3()));
        }
        if let Some((slot, size)) = self.size {
            cloud.areas.par_extend(rows.clone().map(|row| match size {
                Size::Area => row[slot] as f32,
                // A negative radius must not become a positive area.
                Size::Radius => (PI * row[slot] * row[slot].abs()) as f32,
            }));
        }
        if let Some((slots, colour)) = &self.reflectance {
            cloud.reflectance.par_extend(
                rows.clone()
                    .map(|row| Vec3::from(slots.map(|slot| colour.reflectance(row[slot])))),
            );
        }
        if let Some(slots) = self.emission {
            cloud
                .emission
                .par_extend(rows.map(|row| vector(row, slots).as_vec3()));
        }
    }
}

/// Mends values that mean nothing, and tells how many.
fn repair(cloud: &mut PointCloud, white: f32, repairs: &mut Vec<String>) {
    let mut tell = |count: usize, what: &str| {
        if count > 0 {
            repairs.push(format!("{count} {what}"));
        }
    };
    tell(
        mend(
            &mut cloud.reflectance,
            |r| !r.is_nan_mask().any(),
            |r| Vec3::select(r.is_nan_mask(), Vec3::splat(DEFAULT_REFLECTANCE), r),
        ),
        "reflectances that are no number set to 0.5",
    );
    tell(
        mend(
            &mut cloud.reflectance,
            |r| r == r.clamp(Vec3::ZERO, Vec3::ONE),
            |r| r.clamp(Vec3::ZERO, Vec3::splat(white)),
        ),
        "reflectances outside [0, 1] clamped",
    );
    tell(
        mend(
            &mut cloud.emission,
            |e| e.is_finite() && e.min_element() >= 0.0,
            |e| e.map(|e| if e.is_finite() { e.max(0.0) } else { 0.0 }),
        ),
        "emissions that are negative or no number set to 0",
    );
    let brightest = Vec3::splat(BRIGHTEST);
    tell(
        mend(
            &mut cloud.emission,
            |e| e.cmple(brightest).all(),
            |e| e.min(brightest),
        ),
        "emissions above 1e15 reduced to that",
    );
    tell(
        mend(&mut cloud.areas, |a| a > 0.0 && a.is_finite(), |_| 0.0),
        "areas that are no positive number estimated anew",
    );
}

/// Replaces the values that are not good; returns how many.
fn mend<T: Copy + Send>(
    values: &mut [T],
    good: impl Fn(T) -> bool + Sync,
    mended: impl Fn(T) -> T + Sync,
) -> usize {
    values
        .par_iter_mut()
        .with_min_len(GRAIN)
        .filter(|value| !good(**value))
        .map(|value| *value = mended(*value))
        .count()
}
