//! E57 files.

mod fields;
mod guard;

use std::fs::File;
use std::io::{BufReader, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use e57::{E57Reader, PointCloud as Description, RecordValue};
use glam::{DQuat, DVec3, Vec3};

use super::Scan;
use crate::error::{Error, Result};
use crate::points::{PointCloud, Scanner};
use crate::progress::Progress;
use fields::Fields;
use guard::Watched;

/// Points between two looks at the progress.
const BLOCK: u64 = 1 << 16;

/// Reads the points of all scans of an E57 file, placed by their poses.
///
/// Understood are Cartesian and spherical coordinates, states that mark values as invalid, colours
/// (sRGB, within the limits of the file), or else intensity as grey, and the extension for
/// normals. Points without valid coordinates are left out.
pub fn read(path: &Path, progress: &dyn Progress) -> Result<Scan> {
    let file = super::open(path)?;
    // The reader answers damaged files with errors as far as is known. Should it panic, this is
    // still an error of the file, and no reason to end the program.
    catch_unwind(AssertUnwindSafe(|| read_file(path, file, progress)))
        .unwrap_or_else(|_| Err(Error::input(path, "the file is damaged")))
}

fn read_file(path: &Path, file: File, progress: &dyn Progress) -> Result<Scan> {
    let cannot_be_read = |e| Error::io(path, "cannot be read", e);
    let wrong = |what: String| Error::input(path, what);
    let damaged = |e: e57::Error| Error::input(path, e.to_string());
    let bytes = file.metadata().map_err(cannot_be_read)?.len();
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
    if total > u64::from(u32::MAX) {
        return Err(Error::TooLarge(format!(
            "{}: {total} points; at most {} are possible",
            path.display(),
            u32::MAX
        )));
    }

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
    if all.left_out == total {
        return Err(wrong(format!(
            "empty cloud: none of {total} points has valid coordinates"
        )));
    }
    let mut cloud = all.cloud();
    if let [
        Description {
            transform: None, ..
        },
    ] = scans[..]
    {
        cloud.grid = Fields::find(&scans[0], &mut Vec::new()).grid();
    }
    Ok(Scan {
        format: format!(
            "E57, {} scan{}",
            scans.len(),
            if scans.len() == 1 { "" } else { "s" }
        ),
        fields: names(&scans),
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
    grey: usize,
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
}

impl Part {
    fn of(scan: &Description, cloud: &mut PointCloud) -> std::result::Result<Self, String> {
        let fields = Fields::find(scan, &mut cloud.repairs);
        if !fields.has_coordinates() && scan.records > 0 {
            return Err("its points have no coordinates".to_owned());
        }
        let (turn, place) = fields::pose(scan).ok_or("its pose is no rotation and translation")?;
        let begin = cloud.len();
        if fields.has_normals() {
            cloud.normals.resize(begin, Vec3::ZERO);
        }
        Ok(Part {
            // Angles and grids are what a scanner measures, from the origin of its coordinates.
            from_place: scan.transform.is_some() || fields.is_spherical() || scan.has_row_column(),
            fields,
            turn,
            place,
            begin,
            left_out: 0,
        })
    }

    fn add(&mut self, values: &[RecordValue], cloud: &mut PointCloud) {
        let Some(position) = self.fields.position(values) else {
            self.left_out += 1;
            return;
        };
        cloud.positions.push(self.turn * position + self.place);
        cloud.reflectance.push(self.fields.reflectance(values));
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
        self.left_out += part.left_out;
        if part.from_place && !points.is_empty() {
            self.cloud.scanners.push(Scanner {
                position: part.place,
                points,
            });
        }
    }

    fn cloud(self) -> PointCloud {
        let mut cloud = self.cloud;
        let count = cloud.len();
        cloud.emission = vec![Vec3::ZERO; count];
        if !cloud.normals.is_empty() {
            cloud.normals.resize(count, Vec3::ZERO);
        }
        for (number, what) in [
            (self.left_out, "points left out: without valid coordinates"),
            (self.grey as u64, "colours made of intensities"),
        ] {
            if number > 0 {
                cloud.repairs.push(format!("{number} {what}"));
            }
        }
        cloud
    }
}
