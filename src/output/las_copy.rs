//! LAS files whose points keep all that their files say of them.

use std::ops::Range;
use std::path::Path;

use las::Builder;
use las::point::Format;

use super::columns::{LIGHT, is_light, light_kind};
use super::las::{self as las_file, Places, SOFTWARE, description};
use super::rows::{Lit, Paint, Row, fill_rows};
use crate::error::{Error, Result};
use crate::scan::attributes::Kind;
use crate::scan::las::{EXTRA_BYTES, LasFile, PROJECTION};
use crate::scene::Scene;

/// Extra dimensions with the colours of the input, where others are painted over them.
const ORIGINAL: [&str; 3] = ["original_red", "original_green", "original_blue"];
/// Bytes of the coordinates, which are those of the cloud.
const PLACE: usize = 12;
/// Makers of records that describe how a file is stored, and no longer would be true.
const STORAGE: [&str; 2] = ["laszip encoded", "copc"];
/// Numbers of the records of `LASF_Spec` that describe waveforms, and of their data.
const WAVEFORM: std::ops::RangeInclusive<u16> = 100..=354;
const WAVEFORM_DATA: u16 = 65535;

/// Files of LAS points, in the order of the scene, and how their points become those of the output.
pub struct LasCopy<'a> {
    lit: Lit<'a>,
    files: Vec<File<'a>>,
    /// Of the output.
    format: Format,
    /// The colour in a point of the output, where it is painted; whether the former one is kept.
    painted: Option<usize>,
    keeps_colour: bool,
    descriptions: Vec<u8>,
    /// Extra bytes from the files.
    extra: usize,
}

struct File<'a> {
    path: &'a Path,
    points: Range<usize>,
    las: LasFile,
    /// Parts of a point that are copied: from where, to where, how many bytes.
    parts: Vec<(usize, usize, usize)>,
    /// The colour in a point.
    colour: Option<usize>,
}

impl<'a> LasCopy<'a> {
    /// `None` if not all points of the scene are from LAS files whose point formats are of one family, 0 to 5 or
    /// 6 to 10. Tells with `note` what is left out.
    pub fn of_scene(lit: Lit<'a>, scene: &'a Scene, note: &dyn Fn(String)) -> Option<Self> {
        let mut files = Vec::new();
        for source in scene
            .sources
            .iter()
            .filter(|source| !source.points.is_empty())
        {
            if !source.format.starts_with("LAS") && !source.format.starts_with("LAZ") {
                return None;
            }
            let las = LasFile::open(&source.path).ok()?;
            if las.header.points != source.points.len() as u64 {
                return None; // which says that the file has changed
            }
            files.push(File {
                path: &source.path,
                points: source.points.clone(),
                parts: Vec::new(),
                colour: Fields::of(&las.header.format).colour,
                las,
            });
        }
        let first = files.first()?.las.header.format;
        let mut all = files.iter().map(|file| &file.las.header.format);
        if all
            .clone()
            .any(|format| format.is_extended != first.is_extended)
        {
            let what = "LAS files of point formats 0 to 5 and of 6 to 10: their fields become extra dimensions";
            note(what.to_owned());
            return None;
        }
        let any = |has: fn(&Format) -> bool| files.iter().any(|file| has(&file.las.header.format));
        let paints = lit.paint != Paint::Keep;
        let had_colour = all.any(|format| format.has_color);
        let mut format = Format {
            has_gps_time: any(|format| format.has_gps_time),
            has_color: had_colour || paints,
            has_waveform: any(|format| format.has_waveform),
            has_nir: any(|format| format.has_nir),
            extra_bytes: 0,
            is_compressed: false,
            ..first
        };
        // There are no waveforms in colour without infrared.
        format.has_nir |= format.is_extended && format.has_color && format.has_waveform;
        let has_originals = (files.iter().flat_map(|file| &file.las.header.extra))
            .any(|extra| ORIGINAL.contains(&extra.name.as_str()));
        let mut copy = LasCopy {
            lit,
            painted: Fields::of(&format).colour.filter(|_| paints),
            keeps_colour: paints && had_colour && !has_originals,
            descriptions: Vec::new(),
            extra: 0,
            format,
            files,
        };
        copy.join(note);
        for file in &copy.files {
            file.tell_lost(note);
        }
        Some(copy)
    }

    /// Decides which parts of the files' points go where. Extra dimensions of several files that are described
    /// alike are one.
    fn join(&mut self, note: &dyn Fn(String)) {
        let to = Fields::of(&self.format);
        let mut extra: Vec<(Vec<u8>, usize, usize)> = Vec::new();
        let mut end = to.end;
        for file in &mut self.files {
            let from = Fields::of(&file.las.header.format);
            file.parts.push((PLACE, PLACE, from.core - PLACE));
            let pairs = [
                (from.time, to.time, 8),
                (from.colour, to.colour, 6),
                (from.nir, to.nir, 2),
                (from.waveform, to.waveform, 29),
            ];
            let pairs = pairs.into_iter();
            let both = pairs.filter_map(|(from, to, size)| Some((from?, to?, size)));
            file.parts.extend(both);
            let mut taken = Vec::new();
            for own in &file.las.header.extra {
                if is_light(&own.name) {
                    continue;
                }
                // Least and greatest values are of the file alone.
                let mut described = own.description;
                described[64..112].fill(0);
                described[3] &= if own.kind == 0 { 0xff } else { !0b110 };
                let alike = extra
                    .iter()
                    .position(|(other, at, _)| *other == described && !taken.contains(at));
                let at = match alike {
                    Some(index) => extra[index].1,
                    None => {
                        let at = end;
                        end += own.size;
                        extra.push((described.to_vec(), at, own.size));
                        at
                    }
                };
                taken.push(at);
                file.parts.push((own.begin, at, own.size));
            }
        }
        for (k, file) in self.files.iter().enumerate() {
            let has = |at: usize| file.parts.iter().any(|part| part.1 == at);
            let mut missing: Vec<String> = (extra.iter())
                .filter(|(_, at, _)| !has(*at))
                .map(|(described, ..)| {
                    let name = String::from_utf8_lossy(&described[4..36]);
                    name.trim_end_matches('\0').to_owned()
                })
                .collect();
            let header = &file.las.header;
            if to.time.is_some() && !header.format.has_gps_time {
                missing.push("gps_time".to_owned());
            }
            if to.colour.is_some() && self.painted.is_none() && !header.format.has_color {
                missing.push("red green blue".to_owned());
            }
            if !missing.is_empty() && self.files.len() > 1 {
                let path = self.files[k].path.display();
                note(format!(
                    "{path}: has no {}, which are 0 there",
                    missing.join(", ")
                ));
            }
        }
        self.extra = end - to.end;
        self.descriptions = extra
            .into_iter()
            .flat_map(|(described, ..)| described)
            .collect();
        if self.keeps_colour {
            let descriptions = ORIGINAL.map(|name| description(name, Kind::U16));
            self.descriptions.extend(descriptions.as_flattened());
        }
        let light = LIGHT.map(|(name, value)| description(name, light_kind(value)));
        self.descriptions.extend(light.as_flattened());
    }

    /// Writes the points, `compressed` or not.
    pub fn write(self, path: &Path, compressed: bool) -> Result<()> {
        let places = Places::of(self.lit.cloud)?;
        let builder = self.builder(&places)?;
        let fixed = Fields::of(&self.format).end;
        let originals = if self.keeps_colour { 6 } else { 0 };
        let light: usize = LIGHT
            .iter()
            .map(|&(_, value)| light_kind(value).size())
            .sum();
        let extra = self.extra + originals + light;
        let stride = fixed + extra;
        let each = |write: &mut dyn FnMut(Vec<u8>) -> Result<()>| {
            for file in &self.files {
                let own = file.las.header.stride;
                let changed = || Error::input(file.path, "has changed since it was read");
                let mut begin = file.points.start;
                file.las.copy(&mut |bytes| {
                    let count = bytes.len() / own;
                    if begin + count > file.points.end {
                        return Err(changed());
                    }
                    let mut points = vec![0; count * stride];
                    fill_rows(&mut points, stride, |row, k| {
                        self.fill(row, file, &bytes[k * own..][..own], &places, begin + k);
                    });
                    begin += count;
                    write(points)
                })?;
                if begin != file.points.end {
                    return Err(changed());
                }
            }
            Ok(())
        };
        las_file::write(path, builder, compressed, &self.descriptions, extra, each)
    }

    /// Fills the row of a point from the bytes of its file.
    fn fill(&self, row: &mut Row, file: &File, bytes: &[u8], places: &Places, i: usize) {
        let colour = |bytes: &[u8]| {
            file.colour
                .map_or([0; 6], |at| std::array::from_fn(|k| bytes[at + k]))
        };
        let point = row.rest();
        for &(from, to, size) in &file.parts {
            point[to..to + size].copy_from_slice(&bytes[from..from + size]);
        }
        if let Some(at) = self.painted {
            for (k, byte) in self.lit.colour(i).into_iter().enumerate() {
                let level = (u16::from(byte) * 257).to_le_bytes();
                point[at + 2 * k..][..2].copy_from_slice(&level);
            }
        }
        places.put(row, self.lit.cloud.positions[i]);
        row.skip(Fields::of(&self.format).end - PLACE + self.extra);
        if self.keeps_colour {
            row.put(&colour(bytes));
        }
        row.vector(self.lit.map.irradiance[i]);
        row.vector(self.lit.map.radiosity[i]);
        row.put(&[u8::from(self.lit.map.in_transport[i])]);
    }

    /// The header of the first file, with the records of all.
    fn builder(&self, places: &Places) -> Result<Builder> {
        let first = &self.files[0];
        let header = &first.las.header;
        let wrong = |e: las::Error| Error::input(first.path, format!("header: {e}"));
        let mut builder = Builder::new(header.raw.clone()).map_err(wrong)?;
        builder.version = (1, 4).into();
        builder.point_format = self.format;
        builder.padding = Vec::new();
        builder.generating_software = SOFTWARE.to_owned();
        let is_wkt = builder.has_wkt_crs;
        places.describe(&mut builder);
        builder.has_wkt_crs |= is_wkt;
        for file in &self.files {
            let [before, after] = &file.las.header.records;
            for (records, all) in [(before, &mut builder.vlrs), (after, &mut builder.evlrs)] {
                for record in records {
                    let id = (record.user_id.as_str(), record.record_id);
                    let is_gone = STORAGE.contains(&id.0)
                        || id.0 == PROJECTION
                        || id == EXTRA_BYTES
                        || id == (EXTRA_BYTES.0, WAVEFORM_DATA);
                    if !is_gone && !all.contains(record) {
                        all.push(record.clone());
                    }
                }
            }
        }
        Ok(builder)
    }
}

impl File<'_> {
    fn tell_lost(&self, note: &dyn Fn(String)) {
        let header = &self.las.header;
        let is_waveform = |number: u16| WAVEFORM.contains(&number) || number == WAVEFORM_DATA;
        let records = || header.records.iter().flatten();
        let of_spec =
            |record: &las::Vlr| record.user_id == EXTRA_BYTES.0 && is_waveform(record.record_id);
        let mut lost: Vec<String> = (header.long.iter())
            .filter(|user| !STORAGE.contains(&user.as_str()))
            .map(|user| format!("a long record of {user}"))
            .collect();
        if header.format.has_waveform || records().any(of_spec) {
            lost.push("the data of waveforms (their fields are kept)".to_owned());
        }
        if !lost.is_empty() {
            note(format!(
                "{}: left out: {}",
                self.path.display(),
                lost.join(", ")
            ));
        }
    }
}

/// Where the fields of a point format begin.
struct Fields {
    /// End of the fields that all formats of the family have.
    core: usize,
    time: Option<usize>,
    colour: Option<usize>,
    nir: Option<usize>,
    waveform: Option<usize>,
    end: usize,
}

impl Fields {
    fn of(format: &Format) -> Self {
        let core = if format.is_extended { 22 } else { 20 };
        let mut end = core;
        let mut next = |is_there: bool, size: usize| {
            let begin = end;
            end += if is_there { size } else { 0 };
            is_there.then_some(begin)
        };
        let time = next(format.has_gps_time, 8);
        let colour = next(format.has_color, 6);
        let nir = next(format.has_nir, 2);
        let waveform = next(format.has_waveform, 29);
        Fields {
            core,
            time,
            colour,
            nir,
            waveform,
            end,
        }
    }
}
