//! What an output says of each point: what its file said, and its light.

use std::ops::Range;
use std::path::Path;

use super::Format;
use super::ply::cloud_needs_double;
use super::rows::{BLOCK, Lit, Paint};
use crate::error::{Error, Result};
use crate::points::PointCloud;
use crate::scan::attributes::{Attribute, Attributes, Block, Kind, is_geometry};
use crate::scan::names;
use crate::scene::{Scene, Source};

/// A number that the output has of each point.
#[derive(Clone)]
pub struct Column {
    pub name: String,
    pub kind: Kind,
    pub value: Value,
}

/// Where a number comes from; vectors by their component.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Value {
    /// A column that the files have.
    Kept(usize),
    Position(usize),
    Normal(usize),
    Colour(usize),
    Radius,
    Irradiance(usize),
    Radiosity(usize),
    InTransport,
}

const PLACE: [&str; 3] = ["x", "y", "z"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
pub const COLOUR: [&str; 3] = ["red", "green", "blue"];
const ORIGINAL: &str = "original_";
pub const LIGHT: [(&str, Value); 7] = [
    ("irradiance_r", Value::Irradiance(0)),
    ("irradiance_g", Value::Irradiance(1)),
    ("irradiance_b", Value::Irradiance(2)),
    ("radiosity_r", Value::Radiosity(0)),
    ("radiosity_g", Value::Radiosity(1)),
    ("radiosity_b", Value::Radiosity(2)),
    ("in_transport", Value::InTransport),
];

/// The columns of an output, and the files that some of them are in.
pub struct Columns<'a> {
    pub lit: Lit<'a>,
    pub all: Vec<Column>,
    origins: Vec<Origin<'a>>,
}

/// Some points that follow one another.
struct Origin<'a> {
    path: &'a Path,
    points: Range<usize>,
    attributes: Option<Attributes>,
    /// Under which name the output has each attribute, if it has it.
    names: Vec<Option<String>>,
    /// Which attribute each kept column is.
    slots: Vec<Option<usize>>,
    has_colours: bool,
}

/// Some points that follow one another, with what their file has of them.
pub struct Rows<'a> {
    pub lit: &'a Lit<'a>,
    pub columns: &'a [Column],
    pub begin: usize,
    pub count: usize,
    kept: Option<(&'a Block<'a>, Slots<'a>)>,
}

/// Where kept columns are in the rows of a file.
type Slots<'a> = &'a [Option<usize>];

impl<'a> Columns<'a> {
    /// What the cloud has, alone.
    pub fn plain(lit: Lit<'a>, format: Format) -> Self {
        let all = added(lit.cloud, format, [true; 4]);
        Columns {
            lit,
            all,
            origins: Vec::new(),
        }
    }

    /// What the files of a scene have, and the light. Tells with `note` what is left out.
    pub fn of_scene(lit: Lit<'a>, scene: &'a Scene, format: Format, note: &dyn Fn(String)) -> Self {
        let sources = (scene.sources.iter()).filter(|source| !source.points.is_empty());
        let mut origins: Vec<Origin> = sources
            .map(|source| Origin::open(source, format, note))
            .collect();
        let has_attributes = |origin: &Origin| origin.attributes.is_some();
        if !origins.iter().any(has_attributes) {
            return Columns::plain(lit, format);
        }
        let all_have = |origins: &[Origin], names: [&str; 3]| {
            let has = |origin: &Origin| names.iter().all(|name| origin.has(name));
            origins.iter().all(has)
        };
        let keeps = match lit.paint {
            Paint::Keep => {
                let none = |origin: &Origin| has_attributes(origin) && !origin.has_colours;
                all_have(&origins, COLOUR) || origins.iter().all(none)
            }
            _ => false,
        };
        let place = !all_have(&origins, PLACE);
        let normal = !all_have(&origins, NORMAL);
        let radius = !origins.iter().all(|origin| origin.has("radius"));
        let added = added(lit.cloud, format, [place, normal, !keeps, radius]);
        for origin in &mut origins {
            origin.give_way(&added);
        }
        let kept = joined(&mut origins, note);
        let is_place = |column: &Column| matches!(column.value, Value::Position(_));
        let (mut all, after): (Vec<Column>, Vec<Column>) = added.into_iter().partition(is_place);
        all.extend(kept);
        all.extend(after);
        Columns { lit, all, origins }
    }

    /// Hands all points to `take` in order, block by block, with what their files have of them.
    pub fn read(self, take: &mut dyn FnMut(Rows) -> Result<()>) -> Result<()> {
        let whole = Rows {
            lit: &self.lit,
            columns: &self.all,
            begin: 0,
            count: self.lit.len(),
            kept: None,
        };
        if self.origins.is_empty() {
            return whole.in_blocks(take);
        }
        for origin in self.origins {
            let Some(attributes) = origin.attributes else {
                let rows = Rows {
                    begin: origin.points.start,
                    count: origin.points.len(),
                    ..whole
                };
                rows.in_blocks(take)?;
                continue;
            };
            let changed = || Error::input(origin.path, "has changed since it was read");
            let width = attributes.all.len();
            let mut begin = origin.points.start;
            attributes.read(&mut |block| {
                let count = match block {
                    Block::Rows(rows) => rows.len() / width,
                    Block::Lines(_, lines) => lines.len(),
                };
                if begin + count > origin.points.end {
                    return Err(changed());
                }
                let rows = Rows {
                    begin,
                    count,
                    kept: Some((&block, &origin.slots)),
                    ..whole
                };
                begin += count;
                take(rows)
            })?;
            if begin != origin.points.end {
                return Err(changed());
            }
        }
        Ok(())
    }
}

impl Rows<'_> {
    /// Parts points of which no file has more.
    fn in_blocks(&self, take: &mut dyn FnMut(Rows) -> Result<()>) -> Result<()> {
        let end = self.begin + self.count;
        for begin in (self.begin..end).step_by(BLOCK) {
            take(Rows {
                begin,
                count: BLOCK.min(end - begin),
                ..*self
            })?;
        }
        Ok(())
    }

    /// A number of the `k`-th point; `None` where its file has none.
    pub fn value(&self, column: &Column, k: usize) -> Option<f64> {
        let i = self.begin + k;
        let lit = self.lit;
        let map = lit.map;
        Some(match column.value {
            Value::Position(axis) => lit.cloud.positions[i][axis],
            Value::Normal(axis) => lit.normal(i)[axis].into(),
            Value::Colour(band) => lit.colour(i)[band].into(),
            Value::Radius => map.radius[i].into(),
            Value::Irradiance(band) => map.irradiance[i][band].into(),
            Value::Radiosity(band) => map.radiosity[i][band].into(),
            Value::InTransport => f64::from(u8::from(map.in_transport[i])),
            Value::Kept(at) => {
                let (block, slots) = self.kept?;
                let slot = slots[at]?;
                match block {
                    Block::Rows(rows) => rows[k * (rows.len() / self.count) + slot],
                    Block::Lines(..) => return None,
                }
            }
        })
    }

    /// What the file of the `k`-th point has in its columns, if it is a text; and where a kept column is.
    pub fn cells(&self, k: usize) -> Option<(Vec<&[u8]>, Slots<'_>)> {
        match self.kept? {
            (Block::Lines(text, lines), slots) => Some((text.cells(lines[k]).collect(), slots)),
            _ => None,
        }
    }
}

impl<'a> Origin<'a> {
    fn open(source: &'a Source, format: Format, note: &dyn Fn(String)) -> Self {
        let mut origin = Origin {
            path: &source.path,
            points: source.points.clone(),
            attributes: None,
            names: Vec::new(),
            slots: Vec::new(),
            has_colours: false,
        };
        if source.sampled {
            return origin; // its points are new
        }
        let as_text = format == Format::Csv;
        let path = source.path.display();
        match Attributes::open(&source.path, &source.fields, as_text) {
            Ok(Some(attributes)) => {
                if !attributes.lost.is_empty() {
                    note(format!("{path}: left out: {}", attributes.lost.join(", ")));
                }
                origin.name(source, &attributes.all, attributes.is_ply(), format);
                origin.attributes = Some(attributes);
            }
            Ok(None) => {
                let fields = source.fields.iter().map(String::as_str);
                let lost: Vec<&str> = fields.filter(|name| !is_in_cloud(name)).collect();
                if !lost.is_empty() {
                    note(format!("{path}: left out: {}", lost.join(", ")));
                }
            }
            Err(error) => note(format!(
                "warning: {error}: what it says of its points besides the light is left out"
            )),
        }
        origin
    }

    /// Gives the attributes the names that they have in the output.
    fn name(&mut self, source: &Source, all: &[Attribute], is_ply: bool, format: Format) {
        let given: Vec<&str> = all.iter().map(|a| a.name.as_str()).collect();
        let three = |meanings: [&str; 3]| match meanings.map(|m| names::find(&given, m)) {
            [Some(a), Some(b), Some(c)] => Some([a, b, c]),
            _ => None,
        };
        let (place, normal, colour) = (three(PLACE), three(NORMAL), three(COLOUR));
        self.has_colours = colour.is_some();
        self.names = (given.iter())
            .map(|name| match format {
                Format::Ply if !is_ply => {
                    let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
                    let name = name.replace(|c| !is_plain(c), "_");
                    Some(format!("scalar_{}", name.trim_start_matches("scalar_")))
                }
                Format::Las | Format::Laz => Some(name.trim_start_matches("scalar_").to_owned()),
                _ => Some((*name).to_owned()),
            })
            .collect();
        let mut call = |columns: Option<[usize; 3]>, names: [&str; 3]| {
            for (column, name) in columns.into_iter().flatten().zip(names) {
                self.names[column] = Some(name.to_owned());
            }
        };
        call(normal, NORMAL);
        call(colour, COLOUR);
        call(place, PLACE);
        // A place that is kept has the digits of the file: in the output's own way it is shorter.
        let is_las = matches!(format, Format::Las | Format::Laz);
        let keeps_place = !source.moved && !is_las && (is_ply || format == Format::Csv);
        for column in place.into_iter().flatten().filter(|_| !keeps_place) {
            self.names[column] = None;
        }
        for (column, name) in given.iter().enumerate() {
            if source.moved && is_geometry(name) || is_light(name) {
                self.names[column] = None;
            }
        }
        // Colours that the output's readers would not take for such are renamed.
        let fits = |&column: &usize| match (format, all[column].kind) {
            (Format::Csv, _) | (_, Kind::U8) => true,
            (Format::Las | Format::Laz, Kind::U16) => true,
            _ => is_ply && format == Format::Ply,
        };
        if !colour.into_iter().flatten().all(|column| fits(&column)) {
            for column in colour.into_iter().flatten() {
                self.rename(column);
            }
        }
    }

    fn has(&self, name: &str) -> bool {
        self.names
            .iter()
            .any(|other| other.as_deref() == Some(name))
    }

    /// Keeps an attribute under another name; not if there is already one, which is older.
    fn rename(&mut self, column: usize) {
        let name = self.names[column].take();
        let name = name.map(|name| format!("{ORIGINAL}{name}"));
        self.names[column] = name.filter(|name| !self.has(name));
    }

    /// Renames what has the name of a column of the output; places are those of the cloud.
    fn give_way(&mut self, added: &[Column]) {
        for column in 0..self.names.len() {
            let name = self.names[column].as_deref();
            let same = added.iter().find(|other| Some(other.name.as_str()) == name);
            match same.map(|other| other.value) {
                None => {}
                Some(Value::Position(_)) => self.names[column] = None,
                Some(_) => self.rename(column),
            }
        }
    }
}

/// The columns that are kept of all files: those of the same name are one.
fn joined(origins: &mut [Origin], note: &dyn Fn(String)) -> Vec<Column> {
    let mut kept: Vec<Column> = Vec::new();
    for origin in origins.iter_mut() {
        let attributes = origin.attributes.iter().flat_map(|a| &a.all);
        for (slot, (name, attribute)) in origin.names.iter().zip(attributes).enumerate() {
            let Some(name) = name else { continue };
            let at = kept.iter().position(|column| column.name == *name);
            let at = at.unwrap_or(kept.len());
            if at == kept.len() {
                kept.push(Column {
                    name: name.clone(),
                    kind: attribute.kind,
                    value: Value::Kept(at),
                });
            }
            origin.slots.resize(kept.len(), None);
            let column = &mut kept[at];
            let is_wide = |kind| matches!(kind, Kind::I64 | Kind::U64);
            let is_taken = origin.slots[at].is_some();
            if column.kind != attribute.kind && !is_taken {
                if is_wide(column.kind) || is_wide(attribute.kind) {
                    note(format!(
                        "{}: left out: {name}, which is of another type in the file before",
                        origin.path.display()
                    ));
                    continue;
                }
                column.kind = Kind::F64;
            }
            if is_taken {
                note(format!(
                    "{}: left out: a second {name}",
                    origin.path.display()
                ));
                continue;
            }
            origin.slots[at] = Some(slot);
        }
    }
    for origin in origins {
        origin.slots.resize(kept.len(), None);
        let missing = kept.iter().zip(&origin.slots);
        let missing: Vec<&str> = missing
            .filter(|(_, slot)| slot.is_none())
            .map(|(column, _)| column.name.as_str())
            .collect();
        if !missing.is_empty() {
            note(format!(
                "{}: has no {}, which are 0 or no number there",
                origin.path.display(),
                missing.join(", ")
            ));
        }
    }
    kept
}

/// The columns that no file has: place, normal, colour and radius if they are asked for, and the light.
fn added(cloud: &PointCloud, format: Format, asked: [bool; 4]) -> Vec<Column> {
    let is_las = matches!(format, Format::Las | Format::Laz);
    let double = format != Format::Ply || cloud_needs_double(cloud);
    let place = if double { Kind::F64 } else { Kind::F32 };
    let [a, b, c] = [0, 1, 2];
    let three = |names: [&'static str; 3], value: fn(usize) -> Value, kind: Kind| {
        let [x, y, z] = names;
        [
            (x, value(a), kind),
            (y, value(b), kind),
            (z, value(c), kind),
        ]
    };
    let [with_place, with_normal, with_colour, with_radius] = asked;
    let mut all = Vec::new();
    if with_place && !is_las {
        all.extend(three(PLACE, Value::Position, place));
    }
    if with_normal && !is_las {
        all.extend(three(NORMAL, Value::Normal, Kind::F32));
    }
    if with_colour {
        all.extend(three(COLOUR, Value::Colour, Kind::U8));
    }
    if with_radius && !is_las {
        all.push(("radius", Value::Radius, Kind::F32));
    }
    all.extend(LIGHT.map(|(name, value)| (name, value, light_kind(value))));
    let prefix = |name| match format {
        Format::Ply if is_light(name) => "scalar_",
        _ => "",
    };
    (all.into_iter())
        .map(|(name, value, kind)| Column {
            name: format!("{}{name}", prefix(name)),
            kind,
            value,
        })
        .collect()
}

/// How the output stores the light.
pub fn light_kind(value: Value) -> Kind {
    match value {
        Value::InTransport => Kind::U8,
        _ => Kind::F32,
    }
}

/// Whether an input has light under this name, which the output has anew.
pub fn is_light(name: &str) -> bool {
    let name = name.strip_prefix("scalar_").unwrap_or(name);
    LIGHT.iter().any(|(light, _)| *light == name)
}

/// Whether a cloud holds what files have under this name.
fn is_in_cloud(name: &str) -> bool {
    let is_colour = |meaning: &str| meaning == "rgb" || COLOUR.contains(&meaning);
    // The coordinates of E57, and whether they are valid.
    let is_place = ["cartesian", "spherical"]
        .iter()
        .any(|kind| name.starts_with(kind));
    is_place || is_geometry(name) || names::meaning(name).is_some_and(is_colour)
}
