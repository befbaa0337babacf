//! Scan files to point clouds.

pub(crate) mod attributes;
mod colours;
mod e57;
mod fields;
pub(crate) mod las;
mod lines;
mod mesh;
pub(crate) mod names;
mod obj;
mod pcd;
pub(crate) mod ply;
mod polygons;
mod ptx;
mod text;

use std::fs::{self, File};
use std::io::Read;
use std::ops::Range;
use std::path::Path;

pub use colours::ColourSpace;
use glam::DVec3;

use crate::error::{Error, Result};
use crate::memory;
use crate::points::{PointCloud, Scanner};
use crate::progress::Progress;

/// A file of points, read.
#[derive(Clone, Debug, Default)]
pub struct Scan {
    /// What kind of file it is, for example "PCD, binary_compressed".
    pub format: String,
    /// What the file says of each point, in the names of the file.
    pub fields: Vec<String>,
    /// What of it was taken for what.
    pub taken: String,
    /// Whether the points were made on triangles.
    pub sampled: bool,
    pub cloud: PointCloud,
}

/// How files are read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// Takes the faces of a PLY file as the surface, and samples them; otherwise its vertices are
    /// the points. (An OBJ file with faces is always sampled.)
    pub faces: bool,
    /// Number of samples; `None` takes that of the spacing, or 20000.
    pub points: Option<usize>,
    /// Mean distance of samples: each stands for its square, where `points` is `None`.
    pub spacing: Option<f64>,
    /// Moves the samples within their strata.
    pub seed: u64,
    /// What colours are, instead of what their values tell.
    pub colours: Option<ColourSpace>,
    /// Takes points that files flag as withheld or noise.
    pub keep_flagged: bool,
    /// What the columns of a text are, by [name](names), instead of what the text tells; empty if nothing is
    /// said.
    pub columns: Vec<String>,
}

/// The formats that are understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Ply,
    Las,
    E57,
    Pcd,
    Ptx,
    Obj,
    Text,
}

/// Reads the points of a file with the default options, see [`Scan::read`].
pub fn read(path: &Path, progress: &dyn Progress) -> Result<PointCloud> {
    Ok(Scan::read(path, &ReadOptions::default(), progress)?.cloud)
}

impl Scan {
    /// Reads a file of points, or of triangles, on which points are made.
    ///
    /// The content tells the format; where it does not, as with text, the ending of the name does.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read, [`Error::Input`] if it is no scan, is damaged, or
    /// has no points, [`Error::TooLarge`] above 2³² - 1 points.
    pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
        let format = Format::of(path)?;
        let scan = match format {
            Format::Ply => ply::read(path, options, progress),
            Format::Las => las::read(path, options, progress),
            Format::E57 => e57::read(path, options, progress),
            Format::Pcd => pcd::read(path, options, progress),
            Format::Ptx => ptx::read(path, options, progress),
            Format::Obj => obj::read(path, options, progress),
            Format::Text => text::read(path, options, progress),
        };
        let scan = scan.map_err(|error| format.doubted(error, path))?;
        match scan.cloud.len() {
            points if points > u32::MAX as usize => Err(Error::TooLarge(format!(
                "{}: {points} points; at most {} are possible",
                path.display(),
                u32::MAX
            ))),
            _ => Ok(scan),
        }
    }
}

/// The mark of UTF-8, which some programs write.
const BOM: &[u8] = b"\xef\xbb\xbf";
/// Bytes at the start of a file that tell its format.
const HEAD: usize = 1 << 16;
/// First bytes of compressed files, and what unpacks them.
const PACKED: [(&[u8], &str, &str); 6] = [
    (b"\x1f\x8b", "gzip", "gunzip"),
    (b"PK\x03\x04", "ZIP", "unzip"),
    (b"BZh", "bzip2", "bunzip2"),
    (b"\xfd7zXZ\0", "xz", "unxz"),
    (b"\x28\xb5\x2f\xfd", "Zstandard", "unzstd"),
    (b"7z\xbc\xaf\x27\x1c", "7z", "7z x"),
];

impl Format {
    fn of(path: &Path) -> Result<Self> {
        let mut head = Vec::new();
        open(path)?
            .take(HEAD as u64)
            .read_to_end(&mut head)
            .map_err(|e| Error::io(path, "cannot be read", e))?;
        if head.is_empty() {
            return Err(Error::input(path, "the file is empty"));
        }
        if let Some((_, name, with)) = PACKED.iter().find(|(mark, ..)| head.starts_with(mark)) {
            return Err(Error::input(
                path,
                format!("is compressed ({name}): unpack it first, with {with}"),
            ));
        }
        if let Some(encoding) = lines::utf16(&head) {
            let (text, ..) = encoding.decode(&head);
            let text = text.as_bytes();
            return Format::by_text(text)
                .filter(|_| Format::by_magic(text).is_none())
                .ok_or_else(|| {
                    Error::input(
                        path,
                        "is text in UTF-16, which only tables of points, PTX and OBJ may be: save it in \
                         UTF-8 or ASCII",
                    )
                });
        }
        let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
        Format::by_magic(&head)
            .or_else(|| Format::by_ending(&ending.to_string_lossy()))
            .or_else(|| Format::by_text(&head))
            .ok_or_else(|| {
                Error::input(
                    path,
                    "not a scan in a format that is understood: PLY, LAS, LAZ, E57, PCD, PTX, PTS, \
                     OBJ, or text with x, y and z in each line (XYZ, TXT, CSV)",
                )
            })
    }

    /// The error of a reader, and what the content is if it is another format than the ending says.
    fn doubted(self, error: Error, path: &Path) -> Error {
        let mut head = vec![0; HEAD];
        let read = open(path).and_then(|mut file| {
            let read = file.read(&mut head);
            read.map_err(|e| Error::io(path, "cannot be read", e))
        });
        let is_table = read.is_ok_and(|read| text::is_bare(&head[..read]));
        match error {
            Error::Input { path, message } if self != Format::Text && is_table => Error::input(
                path,
                format!(
                    "{message}; its content is a table of points: if it is one, let it end with .xyz"
                ),
            ),
            error => error,
        }
    }

    /// By the first bytes, whatever the name.
    fn by_magic(head: &[u8]) -> Option<Self> {
        match head.strip_prefix(BOM).unwrap_or(head) {
            [b'p', b'l', b'y', end, ..] if end.is_ascii_whitespace() => Some(Format::Ply),
            _ if head.starts_with(b"LASF") => Some(Format::Las),
            _ if head.starts_with(b"ASTM-E57") => Some(Format::E57),
            head if pcd::begins(head) => Some(Format::Pcd),
            _ => None,
        }
    }

    /// By the ending in small letters. What begins otherwise is damaged, and its reader says how.
    fn by_ending(ending: &str) -> Option<Self> {
        match ending {
            "ply" => Some(Format::Ply),
            "las" | "laz" => Some(Format::Las),
            "e57" => Some(Format::E57),
            "pcd" => Some(Format::Pcd),
            "ptx" => Some(Format::Ptx),
            "obj" => Some(Format::Obj),
            "pts" | "xyz" | "csv" => Some(Format::Text),
            _ => None,
        }
    }

    /// By the first lines of a text.
    fn by_text(head: &[u8]) -> Option<Self> {
        let text = head.strip_prefix(BOM).unwrap_or(head);
        // The last line may be cut.
        let end = match head.len() {
            HEAD => text
                .iter()
                .rposition(|&byte| matches!(byte, b'\n' | b'\r'))?,
            _ => text.len(),
        };
        let text = &text[..end];
        if text.contains(&0) {
            None
        } else if ptx::begins(text) {
            Some(Format::Ptx)
        } else if obj::begins(text) {
            Some(Format::Obj)
        } else if text::begins(text) {
            Some(Format::Text)
        } else {
            None
        }
    }
}

/// The scanner of some points, as far as it can be believed: many programs write the origin where
/// they do not know, so that it must lie within the points' box, enlarged by its diagonal.
fn scanner(cloud: &PointCloud, points: Range<usize>, position: DVec3) -> Option<Scanner> {
    let places = cloud.positions[points.clone()].iter();
    let (min, max) = places
        .filter(|p| p.is_finite())
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), &p| {
            (min.min(p), max.max(p))
        });
    let around = (max - min).length();
    let near = position.cmpge(min - around).all() && position.cmple(max + around).all();
    let is_known = position.is_finite() && (position != DVec3::ZERO || near);
    (is_known && !points.is_empty()).then_some(Scanner { position, points })
}

/// Refuses more points than can be numbered, or than memory holds.
fn check_count(path: &Path, points: u64) -> Result<()> {
    let in_file = |what: String| Err(Error::TooLarge(format!("{}: {what}", path.display())));
    if points > u64::from(u32::MAX) {
        return in_file(format!(
            "{points} points; at most {} are possible",
            u32::MAX
        ));
    }
    memory::check_reading(points).or_else(|error| in_file(error.to_string()))
}

/// Opens a regular file; its length comes with it.
fn open_sized(path: &Path) -> Result<(File, u64)> {
    let file = open(path)?;
    let metadata = file.metadata();
    let bytes = metadata
        .map_err(|e| Error::io(path, "cannot be read", e))?
        .len();
    Ok((file, bytes))
}

/// Opens a regular file; a pipe or a device could keep its reader waiting for ever.
pub(crate) fn open(path: &Path) -> Result<File> {
    let failed = |e| Error::io(path, "cannot be opened", e);
    let metadata = fs::metadata(path).map_err(failed)?;
    if metadata.is_dir() {
        return Err(Error::input(path, "is a directory, not a file"));
    }
    if !metadata.is_file() {
        return Err(Error::input(
            path,
            "not a regular file (pipes and devices cannot be read; save the data to a file first)",
        ));
    }
    File::open(path).map_err(failed)
}
