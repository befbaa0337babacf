//! PLY vertices to a point cloud: what the properties mean.

use std::path::Path;

use glam::Vec3;
use ply_rs::ply::{Encoding, ScalarType};

use super::PlyFile;
use crate::error::Result;
use crate::progress::Progress;
use crate::scan::colours::Stored;
use crate::scan::fields::{Builder, Fields};
use crate::scan::mesh::Mesh;
use crate::scan::{ReadOptions, Scan};

/// Reads a PLY file.
///
/// Understood are `x y z`, `nx ny nz`, `radius` or `area`, as reflectance `reflectance_red/green/blue`
/// (linear) or else `red green blue` ([sRGB](crate::scan::colours)), and `emission_red/green/blue`, by all
/// their [names](crate::scan::names). Other properties are skipped.
/// Areas that are no positive number become 0, which stands for unknown. Points whose coordinates
/// or normals are no numbers stay in the cloud. Vertices without normals get those of their faces.
pub fn read(path: &Path, mesh: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let mut ply = PlyFile::open(path)?;
    let mut repairs = Vec::new();
    let fields = Fields::find(
        &ply.single_names(),
        |column| stored(ply.scalar(column)),
        &mut repairs,
    );
    let fields = fields.ok_or_else(|| {
        ply.input_error("the element \"vertex\" lacks x, y or z (as single numbers)")
    })?;
    let count = ply.len();
    if count == 0 {
        return Err(ply.input_error("empty cloud: the file has no vertices"));
    }
    let columns = fields.columns.clone();
    let has_normals = fields.has_normals();
    let mut builder = Builder::new(fields, count);
    let faces = ply.rows_and_faces(
        &columns,
        mesh.faces || !has_normals,
        progress,
        &mut |rows| {
            builder.append(rows);
        },
    )?;
    let (cloud, taken) = builder.finish(mesh.colours, repairs);
    let mut scan = Scan {
        format: ply.describe(),
        fields: ply.names(),
        taken,
        cloud,
        sampled: false,
    };
    match faces {
        Some(Ok(polygons)) if mesh.faces => {
            let triangles = polygons.triangles(&scan.cloud.positions, &mut scan.cloud.repairs);
            let surface = Mesh::new(scan.cloud, triangles);
            scan.cloud = surface.sample(path, mesh, progress)?;
            scan.sampled = true;
        }
        Some(Ok(polygons)) => {
            let triangles = polygons.triangles(&scan.cloud.positions, &mut scan.cloud.repairs);
            let normals = Mesh::normals(&scan.cloud.positions, &triangles);
            if normals.iter().all(|&normal| normal == Vec3::ZERO) {
                return Ok(scan);
            }
            let what = format!("no normals: taken from {} triangles", triangles.len());
            scan.cloud.repairs.push(what);
            scan.cloud.normals = normals;
        }
        Some(Err(what)) if mesh.faces => return Err(ply.input_error(what)),
        Some(Err(what)) => scan.cloud.repairs.push(format!("faces left out: {what}")),
        None if mesh.faces => {
            let what = "no faces to make points on: the vertices are taken as points";
            scan.cloud.repairs.push(what.to_owned());
        }
        None => {}
    }
    Ok(scan)
}

/// How a property of this type holds a colour.
fn stored(scalar: &ScalarType) -> Stored {
    match scalar {
        ScalarType::UChar => Stored::Bytes,
        ScalarType::Float | ScalarType::Double => Stored::Floats,
        _ => Stored::Whole,
    }
}

impl PlyFile {
    fn describe(&self) -> String {
        let encoding = match self.header.encoding {
            Encoding::Ascii => "ascii",
            Encoding::BinaryLittleEndian => "binary, little-endian",
            Encoding::BinaryBigEndian => "binary, big-endian",
        };
        let mut elements = self.header.elements.values();
        let faces = elements.find(|element| super::faces::is_face(element));
        let faces = faces.map_or(String::new(), |face| format!(", {} faces", face.count));
        format!("PLY, {encoding}{faces}")
    }

    fn names(&self) -> Vec<String> {
        self.element().properties.keys().cloned().collect()
    }
}
