//! A transport as a file: surfels with their cells, octree and links, so that neither neighbours nor
//! lines of sight need be looked for again.
//!
//! The file is not trusted: nothing is allocated that its length does not back, and every number that
//! the work relies on is checked.

mod check;
mod header;
mod words;

use std::fs::File;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use bytemuck::cast_slice;
use glam::{DVec3, Vec3};

use self::header::{FITTED, Header, ORDERS, VERSION, magic, whole};
use self::words::{Reader, Writer};
use super::geometry::Geometry;
use super::holes::Holes;
use crate::error::{Error, Result};
use crate::links::{Kept, Links, Rows};
use crate::memory;
use crate::octree::{Octree, StoredFacet};
use crate::output::write_atomic;
use crate::points::{Cells, PointCloud, Surfels};
use crate::progress::Silent;
use crate::visibility::{Occluders, Shape};

/// Place of a point that gets no light.
const NO_SURFEL: u32 = u32::MAX;

/// Writes a file; it appears under its name when it is complete.
pub(super) fn save(path: &Path, geometry: &Geometry, kept: &Kept) -> Result<()> {
    write_atomic(path, |to| write(to, geometry, kept))
}

fn write(to: &mut dyn Write, geometry: &Geometry, kept: &Kept) -> io::Result<()> {
    let surfels = &geometry.surfels;
    let mut repairs = geometry.repairs.join("\n").into_bytes();
    let shape = geometry.occluders.as_deref().map(Occluders::shape);
    let shape = shape.unwrap_or_default();
    let header = Header::new(geometry, &shape, kept, repairs.len());
    repairs.resize(repairs.len().next_multiple_of(4), b' ');
    // Bytes are in their order in words of any machine.
    let repairs: Vec<u32> = repairs
        .chunks_exact(4)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect();
    let places: Vec<u32> = (geometry.places.iter())
        .map(|place| place.unwrap_or(NO_SURFEL))
        .collect();
    let mut to = Writer::new(to);
    to.array(&[header])?;
    to.array(&repairs)?;
    to.array(&places)?;
    to.array(&surfels.positions)?;
    to.array(&surfels.normals)?;
    to.array(&surfels.areas)?;
    to.array(&surfels.cells.tangents)?;
    to.array(cast_slice::<_, u32>(&surfels.cells.corners))?;
    to.array(&surfels.offsets)?;
    to.array(&surfels.depths)?;
    to.array(&surfels.points)?;
    let back = |i: usize| surfels.back(i).map_or(NO_SURFEL, |back| back as u32);
    to.array(&(0..surfels.len()).map(back).collect::<Vec<u32>>())?;
    to.array(&geometry.octree.stored())?;
    to.array(&geometry.octree.cones)?;
    to.array(&shape.counts)?;
    to.array(&shape.order)?;
    let links = &kept.links;
    for (rows, demands) in links.m2l.iter().zip(&kept.m2l) {
        write_rows(&mut to, rows)?;
        to.array(demands)?;
    }
    write_rows(&mut to, &links.sampled)?;
    to.array(&kept.sampled)?;
    write_rows(&mut to, &links.near)?;
    write_rows(&mut to, &kept.left_out)?;
    to.end()
}

fn write_rows(to: &mut Writer<&mut dyn Write>, rows: &Rows) -> io::Result<()> {
    to.array(&rows.offsets)?;
    to.array(&rows.sources)?;
    to.array(&rows.weights)
}

/// Reads a file that was written for this cloud.
pub(super) fn load(path: &Path, cloud: &PointCloud) -> Result<(Geometry, Kept)> {
    let failed = |e| Error::io(path, "cannot be read", e);
    let refused = |what: String| Error::input(path, what);
    let file = File::open(path).map_err(failed)?;
    let metadata = file.metadata().map_err(failed)?;
    if !metadata.is_file() {
        return Err(refused("is not a file: an operator cannot be piped".into()));
    }
    let length = metadata.len();
    if length < size_of::<Header>() as u64 {
        return Err(refused("is no kept operator: too short".into()));
    }
    let mut from = Reader::new(file);
    let header = from.array::<Header>(1).map_err(failed)?[0];
    header.fits(length, cloud).map_err(refused)?;
    memory::check_operator(length, header.surfels.into()).map_err(|e| match e {
        Error::TooLarge(what) => Error::TooLarge(format!("{}: {what}", path.display())),
        other => other,
    })?;
    let (arrays, whole) = Arrays::read(from, &header).map_err(failed)?;
    if !whole {
        return Err(refused(
            "is damaged: its checksum is another one. Make it again".into(),
        ));
    }
    arrays
        .checked(&header)
        .map_err(|what| refused(format!("is no operator that can be used: {what}")))
}

impl Header {
    /// Whether the file is what it should be, or what is wrong with it.
    fn fits(&self, length: u64, cloud: &PointCloud) -> std::result::Result<(), String> {
        let again = "make it again with --save-operator";
        if self.magic != magic() {
            return Err("is no kept operator: it does not begin like one".into());
        }
        if self.version != VERSION {
            return Err(format!(
                "is of version {}, but this program reads version {VERSION}: {again}",
                self.version
            ));
        }
        if ![0, FITTED].contains(&self.fitted) {
            return Err("is no operator that can be used: surfels of no known origin".into());
        }
        let orders = self.orders as usize;
        let rest = self.m2l.get(orders..).unwrap_or(&[1]);
        if self.order as usize >= ORDERS || rest.iter().any(|&len| len > 0) {
            return Err("is no operator that can be used: links of orders beyond its own".into());
        }
        let expected = self.file_length();
        if length != expected {
            return Err(format!(
                "is incomplete or damaged: {length} bytes instead of {expected}: {again}"
            ));
        }
        if self.points as usize != cloud.len() || whole(self.fingerprint) != cloud.fingerprint() {
            return Err(format!(
                "was made for another cloud, of {} points; this one has {}, or other places, \
                 normals or areas: {again} from this one",
                self.points,
                cloud.len()
            ));
        }
        Ok(())
    }
}

/// The arrays of a file as they are, not checked yet.
struct Arrays {
    repairs: Vec<u32>,
    places: Vec<u32>,
    surfels: Surfels,
    facets: Vec<StoredFacet>,
    cones: Vec<u32>,
    shape: Shape,
    kept: Kept,
}

impl Arrays {
    /// Also tells whether the checksum is right. The file is as long as the header says.
    fn read(mut from: Reader<File>, header: &Header) -> io::Result<(Arrays, bool)> {
        let [n, facets] = [header.surfels, header.facets].map(|n| n as usize);
        let rows = |from: &mut Reader<File>, targets: usize, len: u32| {
            Ok::<Rows, io::Error>(Rows {
                offsets: from.array(targets + 1)?,
                sources: from.array(len as usize)?,
                weights: from.array(len as usize)?,
            })
        };
        let repairs = from.array(header.repairs.div_ceil(4) as usize)?;
        let places = from.array(header.points as usize)?;
        let surfels = Surfels {
            origin: DVec3::from_array(header.origin.map(|x| f64::from_bits(whole(x)))),
            positions: from.array(n)?,
            normals: from.array(n)?,
            areas: from.array(n)?,
            cells: Cells {
                tangents: from.array(n)?,
                corners: from.array(n)?,
            },
            offsets: from.array(n)?,
            depths: from.array(n)?,
            points: from.array(n)?,
            backs: from.array(n)?,
            occluder_scale: header.occluder_scale,
            ..Surfels::default()
        };
        let stored = from.array(facets)?;
        let cones = from.array(header.cones as usize)?;
        let shape = Shape {
            counts: from.array(header.boxes as usize)?,
            order: from.array(header.occluders as usize)?,
        };
        let mut links = Links::none(0, 0);
        let mut m2l = Vec::new();
        for &len in &header.m2l[..header.orders as usize] {
            links.m2l.push(rows(&mut from, facets, len)?);
            m2l.push(from.array(len as usize)?);
        }
        links.sampled = rows(&mut from, facets, header.sampled)?;
        let sampled = from.array(header.sampled as usize)?;
        links.near = rows(&mut from, n, header.near)?;
        let left_out = rows(&mut from, facets, header.left_out)?;
        links.m2p = Rows::none(facets);
        links.p2l = Rows::none(facets);
        links.p2p = Rows::none(facets);
        links.mixed = Rows::none(facets);
        let arrays = Arrays {
            repairs,
            places,
            surfels,
            facets: stored,
            cones,
            shape,
            kept: Kept {
                links,
                m2l,
                sampled,
                left_out,
            },
        };
        Ok((arrays, from.end()?))
    }

    /// The same once they are found to be right, or what is wrong.
    fn checked(self, header: &Header) -> std::result::Result<(Geometry, Kept), &'static str> {
        let Arrays {
            mut surfels, kept, ..
        } = self;
        check::surfels(&surfels, &self.places)?;
        let octree = Octree::restored(&self.facets, self.cones, &surfels)?;
        let occluders = Occluders::restored(&surfels, &self.shape)?;
        let holes = match header.fitted == FITTED {
            true => Holes::find(&surfels, &octree, &occluders, &Silent).unwrap_or_default(),
            false => Holes::default(),
        };
        check::links(&kept, octree.facets.len(), surfels.len())?;
        let bytes: Vec<u8> = self.repairs.iter().flat_map(|w| w.to_le_bytes()).collect();
        let text = bytes.get(..header.repairs as usize).unwrap_or(&bytes);
        let text = std::str::from_utf8(text).map_err(|_| "words that are no text")?;
        // What the points reflect and emit comes with every light.
        surfels.reflectance = vec![Vec3::ZERO; surfels.len()];
        surfels.emission = surfels.reflectance.clone();
        let place = |&place: &u32| (place != NO_SURFEL).then_some(place);
        let geometry = Geometry {
            occluders: Some(Arc::new(occluders)),
            surfels: Arc::new(surfels),
            octree,
            places: self.places.iter().map(place).collect(),
            fingerprint: whole(header.fingerprint),
            order: header.order as usize,
            repairs: text.lines().map(str::to_owned).collect(),
            fitted: header.fitted == FITTED,
            holes,
            quality: None,
        };
        Ok((geometry, kept))
    }
}
