//! PLY files: ascii, little and big endian.

mod ascii;
mod binary;
mod cloud;
mod faces;
mod header;
mod layout;

use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

pub use cloud::read;
use ply_rs::ply::{ElementDef, Encoding, PropertyType, ScalarType};

use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::scan::fields::Rows;
use faces::Faces;
use header::Header;

/// The element that holds the points.
const VERTEX: &str = "vertex";

/// A PLY file whose header has been read and fits the file's length.
pub(crate) struct PlyFile {
    path: PathBuf,
    input: BufReader<File>,
    header: Header,
    bytes: u64,
}

impl PlyFile {
    pub fn open(path: &Path) -> Result<Self> {
        let file = super::open(path)?;
        let bytes = file
            .metadata()
            .map_err(|e| Error::io(path, "cannot be read", e))?
            .len();
        let mut input = BufReader::with_capacity(1 << 16, file);
        let header = header::read(&mut input).map_err(|what| Error::input(path, what))?;
        if !header.elements.contains_key(VERTEX) {
            return Err(Error::input(path, "the header has no element \"vertex\""));
        }
        let ply = PlyFile {
            path: path.to_owned(),
            input,
            header,
            bytes,
        };
        ply.check_length()?;
        Ok(ply)
    }

    /// Number of vertices; the file is long enough to hold them.
    pub fn len(&self) -> usize {
        self.element().count
    }

    /// Index of a scalar property of the vertices, by its name with or without `scalar_`.
    pub fn column(&self, name: &str) -> Option<usize> {
        let names = self.single_names();
        let find = |name: &str| names.iter().position(|other| *other == name);
        find(name).or_else(|| find(&format!("scalar_{name}")))
    }

    /// The names of the vertices' properties; empty for those that are not read, lists and, in binary files,
    /// whole numbers of 64 bits.
    fn single_names(&self) -> Vec<&str> {
        let properties = self.element().properties.values();
        properties
            .map(|property| match property.data_type {
                PropertyType::Scalar(_)
                    if self.header.encoding == Encoding::Ascii
                        || !self.header.wide.contains_key(&property.name) =>
                {
                    property.name.as_str()
                }
                _ => "",
            })
            .collect()
    }

    pub fn encoding(&self) -> Encoding {
        self.header.encoding
    }

    /// The names of the vertices' properties as the file has them, their types, and of whole numbers of 64 bits
    /// whether they have a sign.
    pub fn properties(&self) -> impl Iterator<Item = (String, &PropertyType, Option<bool>)> {
        let properties = self.element().properties.values();
        properties.map(|property| {
            let wide = self.header.wide.get(&property.name).copied();
            (header::written(&property.name), &property.data_type, wide)
        })
    }

    /// The names of the other elements that have entries.
    pub fn others(&self) -> impl Iterator<Item = &str> {
        let elements = self.header.elements.values();
        let others = elements.filter(|element| element.name != VERTEX && element.count > 0);
        others.map(|element| element.name.as_str())
    }

    fn scalar(&self, column: usize) -> &ScalarType {
        let property = self.element().properties.values().nth(column);
        match property.map(|property| &property.data_type) {
            Some(PropertyType::Scalar(scalar)) => scalar,
            _ => unreachable!("columns are scalars"),
        }
    }

    fn element(&self) -> &ElementDef {
        &self.header.elements[VERTEX]
    }

    /// The elements before the vertices.
    fn before(&self) -> impl Iterator<Item = &ElementDef> {
        let elements = self.header.elements.values();
        elements.take_while(|element| element.name != VERTEX)
    }

    /// A count is believed only if the file can hold it: nothing is allocated before.
    fn check_length(&self) -> Result<()> {
        let least = |element: &ElementDef| layout::least_bytes(element, self.header.encoding);
        let vertex = self.element();
        let before: u128 = self.before().map(least).sum();
        let mut body = u128::from(self.bytes.saturating_sub(self.header.bytes));
        if self.header.encoding == Encoding::Ascii {
            body += 1; // the last line may lack its end
        }
        if before + least(vertex) > body {
            let each = (least(vertex) / vertex.count.max(1) as u128).max(1);
            return Err(self.input_error(format!(
                "the file is cut short: its header promises {} vertices, and there is room for at \
                 most {}",
                vertex.count,
                body.saturating_sub(before) / each,
            )));
        }
        if vertex.count > u32::MAX as usize {
            return Err(Error::TooLarge(format!(
                "{}: {} points; at most {} are possible",
                self.path.display(),
                vertex.count,
                u32::MAX
            )));
        }
        Ok(())
    }

    /// Hands the given columns of all vertices to `take`, block by block.
    pub fn rows(
        mut self,
        columns: &[usize],
        progress: &dyn Progress,
        take: &mut dyn FnMut(Rows),
    ) -> Result<()> {
        self.rows_and_faces(columns, false, progress, take)?;
        Ok(())
    }

    /// As [`rows`](Self::rows); then reads the faces, if they are asked for and there. Faces that
    /// are damaged are no error of the points.
    fn rows_and_faces(
        &mut self,
        columns: &[usize],
        faces: bool,
        progress: &dyn Progress,
        take: &mut dyn FnMut(Rows),
    ) -> Result<Option<Faces>> {
        progress.stage("reading", self.bytes);
        progress.advance(self.header.bytes);
        match self.header.encoding {
            Encoding::Ascii => ascii::rows(self, columns, faces, progress, take),
            _ => binary::rows(self, columns, faces, progress, take),
        }
    }

    fn input_error(&self, message: impl Into<String>) -> Error {
        Error::input(&self.path, message)
    }

    /// The error of a read inside the vertices.
    fn read_error(&self, error: io::Error, vertices: usize) -> Error {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => self.input_error(format!(
                "the file is cut short: it ends after {vertices} of {} vertices",
                self.len()
            )),
            _ => Error::io(&self.path, "cannot be read", error),
        }
    }
}
