//! The faces of a PLY file.

use ply_rs::ply::{ElementDef, PropertyType};

use super::VERTEX;
use super::header::Header;
use crate::scan::polygons::Polygons;

/// The faces of the file, or what is wrong with them.
pub type Faces = Result<Polygons, String>;

/// Whether an element holds faces.
pub fn is_face(element: &ElementDef) -> bool {
    let mut properties = element.properties.values();
    element.name == "face"
        && element.count > 0
        && properties.any(|p| is_vertices(&p.name) && matches!(p.data_type, PropertyType::List(..)))
}

/// The element with the faces, and those between the vertices and it; `None` if there is none
/// behind the vertices.
pub fn element(header: &Header) -> Option<(Vec<&ElementDef>, &ElementDef)> {
    let elements = header.elements.values();
    let mut after = elements
        .skip_while(|element| element.name != VERTEX)
        .skip(1);
    let mut between = Vec::new();
    loop {
        match after.next()? {
            element if is_face(element) => return Some((between, element)),
            element => between.push(element),
        }
    }
}

/// Whether a list with this name holds the vertices of a face.
pub fn is_vertices(name: &str) -> bool {
    matches!(name, "vertex_indices" | "vertex_index")
}

/// A corner of a face, whose index must be that of one of so many vertices.
pub fn corner(index: f64, vertices: usize) -> Result<u32, String> {
    if index >= 0.0 && index < vertices as f64 && index.fract() == 0.0 {
        Ok(index as u32)
    } else {
        Err(format!(
            "a face has the vertex {index}, but there are {vertices} vertices, from 0 on"
        ))
    }
}
