//! What the columns of a file mean, and how their values become a cloud.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::colours::{self, ColourSpace, Stored};
use super::names;
use crate::points::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud};
use crate::scene::BRIGHTEST;

/// A block of rows, one a point, of the values of the columns asked for.
pub(crate) type Rows<'a> = &'a [f64];

/// Rows for one thread at a time.
const GRAIN: usize = 4096;
/// What a coefficient of a Gaussian splat adds to its colour, which is 0.5 without.
const SPLAT: f64 = 0.282_094_79;

/// Colours that outputs were painted over.
pub(super) const ORIGINAL: [&str; 3] = ["original_red", "original_green", "original_blue"];

/// How a size gives an area.
#[derive(Clone, Copy)]
enum Size {
    Area,
    Radius,
}

/// How the values of a point give a colour.
#[derive(Clone, Copy)]
enum Colour {
    /// Reflectances as they are.
    Linear([usize; 3]),
    Grey(usize),
    Stored([usize; 3], Stored),
    Packed(usize),
    Splat([usize; 3]),
}

impl Colour {
    fn stored(self) -> Option<Stored> {
        match self {
            Colour::Linear(_) | Colour::Grey(_) => None,
            Colour::Stored(_, stored) => Some(stored),
            Colour::Packed(_) => Some(Stored::Bytes),
            Colour::Splat(_) => Some(Stored::Floats),
        }
    }

    fn value(self, row: &[f64]) -> Vec3 {
        match self {
            Colour::Linear(slots) | Colour::Stored(slots, _) => vector(row, slots).as_vec3(),
            Colour::Grey(slot) => Vec3::splat(row[slot] as f32),
            Colour::Packed(slot) => colours::unpacked(row[slot]),
            Colour::Splat(slots) => {
                let colour = 0.5 + SPLAT * vector(row, slots);
                colour.clamp(DVec3::ZERO, DVec3::ONE).as_vec3()
            }
        }
    }
}

fn vector(row: &[f64], slots: [usize; 3]) -> DVec3 {
    DVec3::from(slots.map(|slot| row[slot]))
}

/// Where the row of a point has what.
pub(super) struct Fields {
    /// The columns of the file of which a row is made.
    pub columns: Vec<usize>,
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    size: Option<(usize, Size)>,
    colour: Option<Colour>,
    emission: Option<[usize; 3]>,
    /// What was taken for what.
    taken: Vec<String>,
}

impl Fields {
    /// Finds the columns with a meaning by their [names]; `None` without x, y and z. `stored` tells how a
    /// column holds a colour. What is not used, and why not, it adds to the repairs.
    pub fn find<S: AsRef<str>>(
        names: &[S],
        stored: impl Fn(usize) -> Stored,
        repairs: &mut Vec<String>,
    ) -> Option<Self> {
        let mut search = Search {
            names,
            columns: Vec::new(),
            taken: Vec::new(),
            repairs,
        };
        let position = search.three("place", ["x", "y", "z"])?;
        let normal = search.three("normals", ["nx", "ny", "nz"]);
        let colour = search.colour(stored);
        let emission = search.three(
            "emission",
            ["emission_red", "emission_green", "emission_blue"],
        );
        let area = search.one("areas", "area").map(|slot| (slot, Size::Area));
        let size = area.or_else(|| Some((search.one("radii", "radius")?, Size::Radius)));
        let unused = ["intensity", "label", "row", "column", "alpha", "time"];
        let unused = unused.map(|meaning| names::find(names, meaning));
        let unused: Vec<&str> = (unused.into_iter().flatten())
            .map(|i| names[i].as_ref())
            .collect();
        if !unused.is_empty() {
            search.taken.push(format!("not used: {}", unused.join(" ")));
        }
        Some(Fields {
            position,
            normal,
            size,
            colour,
            emission,
            columns: search.columns,
            taken: search.taken,
        })
    }

    pub fn has_normals(&self) -> bool {
        self.normal.is_some()
    }

    fn append(&self, rows: Rows, cloud: &mut PointCloud) {
        let rows = rows
            .par_chunks_exact(self.columns.len())
            .with_min_len(GRAIN);
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
        if let Some(colour) = self.colour {
            cloud
                .reflectance
                .par_extend(rows.clone().map(|row| colour.value(row)));
        }
        if let Some(slots) = self.emission {
            cloud
                .emission
                .par_extend(rows.map(|row| vector(row, slots).as_vec3()));
        }
    }
}

/// A search for columns.
struct Search<'a, S> {
    names: &'a [S],
    columns: Vec<usize>,
    taken: Vec<String>,
    repairs: &'a mut Vec<String>,
}

impl<S: AsRef<str>> Search<'_, S> {
    /// Takes a column into the rows; returns its place there.
    fn take(&mut self, column: usize) -> usize {
        self.columns.push(column);
        self.columns.len() - 1
    }

    fn name(&self, column: usize) -> &str {
        self.names[column].as_ref()
    }

    fn one(&mut self, what: &str, meaning: &str) -> Option<usize> {
        let column = names::find(self.names, meaning)?;
        self.taken.push(format!("{what} {}", self.name(column)));
        Some(self.take(column))
    }

    /// Three columns that belong together.
    fn three(&mut self, what: &str, meanings: [&str; 3]) -> Option<[usize; 3]> {
        match meanings.map(|meaning| names::find(self.names, meaning)) {
            [Some(a), Some(b), Some(c)] => {
                let columns = [a, b, c];
                let names = columns.map(|column| self.name(column)).join(" ");
                self.taken.push(format!("{what} {names}"));
                Some(columns.map(|column| self.take(column)))
            }
            [None, None, None] => None,
            _ => {
                self.repairs.push(format!(
                    "{} left out: not all three are there",
                    meanings.join(" ")
                ));
                None
            }
        }
    }

    /// The best of what says how a surface reflects.
    fn colour(&mut self, stored: impl Fn(usize) -> Stored) -> Option<Colour> {
        const LINEAR: [&str; 3] = ["reflectance_red", "reflectance_green", "reflectance_blue"];
        if let Some(slots) = self.three("reflectance", LINEAR) {
            return Some(Colour::Linear(slots));
        }
        let original = self.three("colours", ORIGINAL);
        let slots = original.or_else(|| self.three("colours", ["red", "green", "blue"]));
        if let Some(slots) = slots {
            let each = slots.map(|slot| stored(self.columns[slot]));
            // What is not alike is judged by its values.
            let alike = each.iter().all(|other| *other == each[0]);
            return Some(Colour::Stored(
                slots,
                if alike { each[0] } else { Stored::Words },
            ));
        }
        if let Some(slot) = self.one("colours packed in", "rgb") {
            return Some(Colour::Packed(slot));
        }
        if let Some(slots) = self.three("colours of splats", ["f_dc_0", "f_dc_1", "f_dc_2"]) {
            return Some(Colour::Splat(slots));
        }
        Some(Colour::Grey(self.one("grey", "reflectance")?))
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

    /// The cloud, see [`finished`], and what was taken for what.
    pub fn finish(
        mut self,
        told: Option<ColourSpace>,
        mut repairs: Vec<String>,
    ) -> (PointCloud, String) {
        let mut taken = self.fields.taken;
        let stored = self.fields.colour.and_then(Colour::stored);
        let is_grey = matches!(self.fields.colour, Some(Colour::Grey(_)));
        let colours = &mut self.cloud.reflectance;
        let is_share = |r: &Vec3| (0.0..=1.0).contains(&r.x);
        if let Some(stored) = stored {
            if let Some(how) = judge_colours(colours, stored, told, &mut repairs) {
                let of_colours = taken.iter_mut().filter(|what| what.starts_with("colours"));
                of_colours.for_each(|what| *what += &format!(": {how}"));
            }
        } else if is_grey && !colours.par_iter().all(is_share) {
            repairs.push(format!(
                "{} reflectances left out: not all are from 0 to 1",
                colours.len()
            ));
            colours.clear();
        }
        if colours.is_empty() {
            taken.retain(|what| !what.starts_with("colours") && !what.starts_with("grey"));
            taken.push(format!("no colours: reflectance {DEFAULT_REFLECTANCE}"));
        }
        let white = stored.map_or(1.0, |_| MAX_COLOUR_REFLECTANCE);
        (finished(self.cloud, white, repairs), taken.join("; "))
    }
}

/// Turns the stored colours of a file to reflectances, see [`colours`]; none are left if they say nothing.
/// Returns how they were taken.
pub(super) fn judge_colours(
    colours: &mut Vec<Vec3>,
    stored: Stored,
    told: Option<ColourSpace>,
    repairs: &mut Vec<String>,
) -> Option<String> {
    let how = colours::to_reflectances(colours, stored, told, repairs);
    if how.is_none() {
        colours.clear();
    }
    how
}

/// A cloud whose values that mean nothing are mended, and that has what its file lacks. The largest
/// reflectance that can be meant is `white`.
pub(super) fn finished(mut cloud: PointCloud, white: f32, mut repairs: Vec<String>) -> PointCloud {
    let count = cloud.len();
    if !cloud.normals.is_empty() && cloud.normals.par_iter().all(|n| *n == Vec3::ZERO) {
        repairs.push(format!("{count} normals left out: all are zero"));
        cloud.normals.clear();
    }
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
