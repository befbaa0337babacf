//! E57 files.

mod fields;
mod guard;

use std::fs::File;
use std::io::{BufReader, Seek};
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use e57::{E57Reader, PointCloud as Description, RecordValue};
use glam::{DQuat, DVec3, Vec3};

use super::colours::Stored;
use super::fields::{finished, judge_colours};
use super::{ColourSpace, ReadOptions, Scan};
use crate::error::{Error, Result};
use crate::points::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud};
use crate::progress::Progress;
use fields::{Fields, Shades, Span};
use guard::Watched;

/// Points between two looks at the progress.
const BLOCK: u64 = 1 << 16;

/// Reads the points of all scans of an E57 file, placed by their poses.
///
/// Understood are Cartesian and spherical coordinates, states that mark values as invalid, colours
/// (sRGB, within the limits of the file), or else intensity as grey, and the extension for
/// normals. Points without valid coordinates are left out.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let (file, bytes) = super::open_sized(path)?;
    // The reader answers damaged files with errors as far as is known. Should it panic, this is
    // still an error of the file, and no reason to end the program.
    catch_unwind(AssertUnwindSafe(|| {
        read_file(path, file, bytes, options, progress)
    }))
    .unwrap_or_else(|_| Err(Error::input(path, "the file is damaged")))
}

fn read_file(
    path: &Path,
    file: File,
    bytes: u64,
    options: &ReadOptions,
    progress: &dyn Progress,
) -> Result<Scan> {
    let cannot_be_read = |e| Error::io(path, "cannot be read", e);
    let wrong = |what: String| Error::input(path, what);
    let damaged = |e: e57::Error| Error::input(path, e.to_string());
    let mut input = BufReader::with_capacity(1 << 16, file);
    guard::check_header(&mut input, bytes).map_err(wrong)?;
    let xml = E57Reader::raw_xml(&mut input).map_err(damaged)?;
    guard::check_xml(&xml).map_err(wrong)?;
    drop(xml);
    input.rewind().map_err(cannot_be_read)?;
    let (input, since_point) = Watched::new(input).map_err(cannot_be_read)?;
    let mut reader = E57Reader::new(input).map_err(damaged)?;
    let scans = reader.pointclouds();
    guard::check_counts(&scans, bytes).map_err(wrong)?;
    let total = scans.iter().map(|scan| scan.records).sum::<u64>();
    if total == 0 {
        return Err(wrong("empty cloud: the file has no points".to_owned()));
    }
    super::check_count(path, total)?;

    progress.stage("reading", total);
    let mut all = Gathered::default();
    for (k, scan) in scans.iter().enumerate() {
        let wrong = |what: String| wrong(format!("scan {}: {what}", k + 1));
        let mut part = Part::of(scan, &mut all.cloud).map_err(wrong)?;
        let points = reader
            .pointcloud_raw(scan)
            .map_err(|e| wrong(e.to_string()))?;
        since_point.set(0);
        for (done, values) in (0..scan.records).zip(points) {
            if done % BLOCK == 0 {
                progress.check()?;
                progress.advance(BLOCK.min(scan.records - done));
            }
            let values = values
                .map_err(|e| wrong(format!("after {done} of {} points: {e}", scan.records)))?;
            since_point.set(0);
            part.add(&values, &mut all.cloud);
        }
        all.end(part);
    }
    if all.left_out + all.without_return == total {
        return Err(wrong(format!(
            "empty cloud: none of {total} points has valid coordinates"
        )));
    }
    let (mut cloud, taken) = all.cloud(options.colours);
    if let [
        Description {
            transform: None, ..
        },
    ] = scans[..]
    {
        cloud.grid = Fields::find(&scans[0]).grid();
    }
    Ok(Scan {
        format: format!(
            "E57, {} scan{}",
            scans.len(),
            if scans.len() == 1 { "" } else { "s" }
        ),
        fields: names(&scans),
        taken,
        cloud,
        ..Scan::default()
    })
}

/// The names of all fields, each once.
fn names(scans: &[Description]) -> Vec<String> {
    let mut names = Vec::new();
    for field in scans.iter().flat_map(|scan| &scan.prototype) {
        let name = fields::name(field);
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// The scans so far.
#[derive(Default)]
struct Gathered {
    cloud: PointCloud,
    left_out: u64,
    without_return: u64,
    grey: usize,
    /// The scans with colours.
    coloured: Vec<(Range<usize>, Shades)>,
}

/// A scan of which points are being read.
struct Part {
    fields: Fields,
    turn: DQuat,
    place: DVec3,
    /// Whether the place of the scanner is known.
    from_place: bool,
    /// Number of its first point.
    begin: usize,
    left_out: u64,
    without_return: u64,
}

impl Part {
    fn of(scan: &Description, cloud: &mut PointCloud) -> std::result::Result<Self, String> {
        let fields = Fields::find(scan);
        if !fields.has_coordinates() && scan.records > 0 {
            return Err("its points have no coordinates".to_owned());
        }
        let (turn, place) = fields::pose(scan, &mut cloud.repairs)
            .ok_or("its pose is no rotation and translation")?;
        let begin = cloud.len();
        if fields.has_normals() {
            cloud.normals.resize(begin, Vec3::ZERO);
        }
        Ok(Part {
            // Angles are what a scanner measures, from the origin of its coordinates. A pose that is
            // only the default says nothing.
            from_place: fields.is_spherical() || (turn, place) != (DQuat::IDENTITY, DVec3::ZERO),
            fields,
            turn,
            place,
            begin,
            left_out: 0,
            without_return: 0,
        })
    }

    fn add(&mut self, values: &[RecordValue], cloud: &mut PointCloud) {
        let Some(position) = self.fields.position(values) else {
            self.left_out += 1;
            return;
        };
        // No scanner measures itself.
        if position == DVec3::ZERO {
            self.without_return += 1;
            return;
        }
        cloud.positions.push(self.turn * position + self.place);
        cloud.reflectance.push(self.fields.colour(values));
        if let Some(normal) = self.fields.normal(values) {
            cloud.normals.push(self.turn.as_quat() * normal);
        }
    }
}

impl Gathered {
    fn end(&mut self, part: Part) {
        let points = part.begin..self.cloud.len();
        if part.fields.is_grey() {
            self.grey += points.len();
        }
        if let Some(shades) = part.fields.shades() {
            self.coloured.push((points.clone(), shades));
        }
        self.left_out += part.left_out;
        self.without_return += part.without_return;
        if part.from_place {
            let scanner = super::scanner(&self.cloud, points, part.place);
            self.cloud.scanners.extend(scanner);
        }
    }

    /// The cloud, and what was taken for what.
    fn cloud(mut self, told: Option<ColourSpace>) -> (PointCloud, String) {
        let colours = self.judge_colours(told);
        let mut cloud = self.cloud;
        let count = cloud.len();
        if !cloud.normals.is_empty() {
            cloud.normals.resize(count, Vec3::ZERO);
        }
        for (number, what) in [
            (self.left_out, "points left out: without valid coordinates"),
            (
                self.without_return,
                "points left out: at the place of the scanner, as directions without a return are",
            ),
            (self.grey as u64, "colours made of intensities"),
        ] {
            if number > 0 {
                cloud.repairs.push(format!("{number} {what}"));
            }
        }
        let normals = match cloud.normals.is_empty() {
            true => "",
            false => "; normals of the extension",
        };
        let colours = match (colours, self.grey) {
            (Some(how), _) => format!("colours: {how}"),
            (None, 0) => format!("no colours: reflectance {DEFAULT_REFLECTANCE}"),
            (None, _) => "grey of the intensity".to_owned(),
        };
        let repairs = std::mem::take(&mut cloud.repairs);
        let cloud = finished(cloud, MAX_COLOUR_REFLECTANCE, repairs);
        (cloud, format!("place of the scans{normals}; {colours}"))
    }

    /// Turns the colours of all scans to reflectances; says how they were taken.
    fn judge_colours(&mut self, told: Option<ColourSpace>) -> Option<String> {
        let reflectance = &mut self.cloud.reflectance;
        let repairs = &mut self.cloud.repairs;
        let of_part = |points: &Range<usize>| {
            let channels = reflectance[points.clone()]
                .iter()
                .flat_map(|c| c.to_array());
            f64::from(channels.fold(0.0, f32::max))
        };
        let largest: Vec<f64> = self
            .coloured
            .iter()
            .map(|(points, _)| of_part(points))
            .collect();
        let (mut limited, mut others) = (Vec::new(), Vec::new());
        for (points, shades) in &self.coloured {
            // Scans with the same limits are one, or else a dark one would be taken for another depth.
            let alike = (self.coloured.iter().zip(&largest))
                .filter(|((_, other), _)| other == shades)
                .map(|(_, largest)| *largest);
            let largest = alike.fold(0.0, f64::max);
            // Limits lie where values exceed them or use a small part of them.
            let fits = |span: &Span| largest <= span.max && largest * 255.0 > span.max;
            match shades.limits {
                Some(spans) if told.is_none() && spans.iter().all(fits) => {
                    for colour in &mut reflectance[points.clone()] {
                        let place = |k: usize| spans[k].place(colour[k].into());
                        if !colour.is_nan() {
                            *colour = Vec3::from([0, 1, 2].map(place));
                        }
                    }
                    limited.push(points.clone());
                }
                Some([Span { min, max }, ..]) if told.is_none() && largest > 0.0 => {
                    repairs.push(format!(
                        "limits of the colours, {min} to {max}, left out: values go up to {largest}"
                    ));
                    others.push(points.clone());
                }
                _ => others.push(points.clone()),
            }
        }
        let stored = self.coloured.iter().map(|(_, shades)| shades.stored);
        let stored = stored.reduce(|a, b| if a == b { a } else { Stored::Words })?;
        let within = judge_parts(reflectance, &limited, Stored::Floats, told, repairs);
        let within = within.map(|_| "sRGB, within the limits of the file".to_owned());
        let beyond = judge_parts(reflectance, &others, stored, told, repairs);
        let said: Vec<String> = within.into_iter().chain(beyond).collect();
        (!said.is_empty()).then(|| said.join("; others: "))
    }
}

/// Turns the stored colours of some points to reflectances, see [`judge_colours`].
fn judge_parts(
    reflectance: &mut [Vec3],
    parts: &[Range<usize>],
    stored: Stored,
    told: Option<ColourSpace>,
    repairs: &mut Vec<String>,
) -> Option<String> {
    let points = || parts.iter().cloned().flatten();
    let mut colours: Vec<Vec3> = points().map(|i| reflectance[i]).collect();
    let how = judge_colours(&mut colours, stored, told, repairs);
    colours.resize(points().count(), Vec3::NAN);
    for (i, colour) in points().zip(colours) {
        reflectance[i] = match colour.is_nan() {
            true => Vec3::splat(DEFAULT_REFLECTANCE),
            false => colour,
        };
    }
    how
}
