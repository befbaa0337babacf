//! What the columns of a file mean, and how their values become a cloud.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::colour::srgb_to_linear;
use crate::points::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud};
use crate::scene::BRIGHTEST;

/// A block of rows, one a point, of the values of the columns asked for.
pub(crate) type Rows<'a> = &'a [f64];

/// Rows for one thread at a time.
const GRAIN: usize = 4096;

/// How a size gives an area.
#[derive(Clone, Copy)]
enum Size {
    Area,
    Radius,
}

/// How a stored colour gives a reflectance.
#[derive(Clone, Debug)]
pub(super) enum Colour {
    Linear,
    /// Reflectance of each integer value.
    Srgb(Vec<f32>),
    /// sRGB from 0 to 1.
    SrgbFraction,
}

impl Colour {
    /// Integers below `levels`.
    pub fn srgb(levels: usize) -> Self {
        let linear = |level| srgb_to_linear(level as f32 / (levels - 1) as f32);
        Colour::Srgb(
            (0..levels)
                .map(|i| linear(i).min(MAX_COLOUR_REFLECTANCE))
                .collect(),
        )
    }

    /// Values that the type cannot hold (ascii files may have them) give a number outside [0, 1].
    #[inline]
    pub fn reflectance(&self, value: f64) -> f32 {
        match self {
            Colour::Linear => value as f32,
            Colour::Srgb(table) => match table.get(value as usize) {
                Some(&linear) if value >= 0.0 => linear,
                _ => value as f32,
            },
            Colour::SrgbFraction if (0.0..=1.0).contains(&value) => {
                srgb_to_linear(value as f32).min(MAX_COLOUR_REFLECTANCE)
            }
            Colour::SrgbFraction => value as f32,
        }
    }
}

/// Where the row of a point has what.
pub(super) struct Fields {
    /// The columns of the file of which a row is made.
    pub columns: Vec<usize>,
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    size: Option<(usize, Size)>,
    reflectance: Option<([usize; 3], Colour)>,
    emission: Option<[usize; 3]>,
}

impl Fields {
    /// Finds the columns with a meaning, by their names in PLY files; `None` without x, y and z.
    /// `colour` tells how three columns hold a colour; why not, it adds to the repairs.
    pub fn find(
        column: impl Fn(&str) -> Option<usize>,
        colour: impl Fn([usize; 3], &mut Vec<String>) -> Option<Colour>,
        repairs: &mut Vec<String>,
    ) -> Option<Self> {
        let mut columns = Vec::new();
        let mut one = |name: &str| {
            columns.push(column(name)?);
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
        let position = three(["x", "y", "z"])?;
        let normal = three(["nx", "ny", "nz"]);
        let linear = three(["reflectance_red", "reflectance_green", "reflectance_blue"]);
        let srgb = match linear {
            Some(_) => None,
            None => three(["red", "green", "blue"]),
        };
        let emission = three(["emission_red", "emission_green", "emission_blue"]);
        let size = match one("area") {
            Some(column) => Some((column, Size::Area)),
            None => one("radius").map(|column| (column, Size::Radius)),
        };
        let srgb = srgb.and_then(|slots| {
            let colour = colour(slots.map(|slot| columns[slot]), repairs);
            Some((slots, colour?))
        });
        Some(Fields {
            position,
            normal,
            size,
            reflectance: linear.map(|slots| (slots, Colour::Linear)).or(srgb),
            emission,
            columns,
        })
    }

    pub fn has_normals(&self) -> bool {
        self.normal.is_some()
    }

    /// The largest reflectance that can be meant.
    fn white(&self) -> f32 {
        match &self.reflectance {
            Some((_, Colour::Srgb(_) | Colour::SrgbFraction)) => MAX_COLOUR_REFLECTANCE,
            Some((_, Colour::Linear)) | None => 1.0,
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

/// A cloud that grows by rows.
pub(super) struct Builder {
    pub fields: Fields,
    pub cloud: PointCloud,
}

impl Builder {
    /// `count` points are expected, which the file is long enough for.
    pub fn new(fields: Fields, count: usize) -> Self {
        let mut cloud = PointCloud::default();
        cloud.positions.reserve_exact(count);
        Builder { fields, cloud }
    }

    pub fn append(&mut self, rows: Rows) {
        self.fields.append(rows, &mut self.cloud);
    }

    /// The cloud, see [`finished`].
    pub fn finish(self, repairs: Vec<String>) -> PointCloud {
        finished(self.cloud, self.fields.white(), repairs)
    }
}

/// A cloud whose values that mean nothing are mended, and that has what its file lacks. The largest
/// reflectance that can be meant is `white`.
pub(super) fn finished(mut cloud: PointCloud, white: f32, mut repairs: Vec<String>) -> PointCloud {
    let count = cloud.len();
    if cloud.reflectance.is_empty() {
        cloud.reflectance = vec![Vec3::splat(DEFAULT_REFLECTANCE); count];
    }
    if cloud.emission.is_empty() {
        cloud.emission = vec![Vec3::ZERO; count];
    }
    repair(&mut cloud, white, &mut repairs);
    cloud.repairs = repairs;
    cloud
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
