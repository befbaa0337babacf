//! The faces of a PLY file as triangles.

use ply_rs::ply::{ElementDef, PropertyType};

use super::VERTEX;
use super::header::Header;

/// Triangles as indices of vertices, or what is wrong with the faces of the file.
pub type Faces = Result<Vec<[u32; 3]>, String>;

/// The element with the faces, and those between the vertices and it; `None` if there is none
/// behind the vertices.
pub fn element(header: &Header) -> Option<(Vec<&ElementDef>, &ElementDef)> {
    let elements = header.elements.values();
    let mut after = elements
        .skip_while(|element| element.name != VERTEX)
        .skip(1);
    let mut between = Vec::new();
    let is_face = |element: &ElementDef| {
        let mut properties = element.properties.values();
        element.name == "face"
            && element.count > 0
            && properties
                .any(|p| is_vertices(&p.name) && matches!(p.data_type, PropertyType::List(..)))
    };
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

/// Polygons cut into triangles around their first corner.
pub struct Fan {
    pub triangles: Vec<[u32; 3]>,
    vertices: usize,
    first: Option<u32>,
    last: Option<u32>,
}

impl Fan {
    /// For polygons of so many vertices.
    pub fn new(vertices: usize) -> Self {
        Fan {
            triangles: Vec::new(),
            vertices,
            first: None,
            last: None,
        }
    }

    /// Begins a polygon.
    pub fn begin(&mut self) {
        (self.first, self.last) = (None, None);
    }

    /// Adds a corner to the polygon.
    pub fn add(&mut self, index: f64) -> Result<(), String> {
        if !(index >= 0.0 && index < self.vertices as f64 && index.fract() == 0.0) {
            return Err(format!(
                "a face has the vertex {index}, but there are {} vertices, from 0 on",
                self.vertices
            ));
        }
        let index = index as u32;
        match (self.first, self.last) {
            (None, _) => self.first = Some(index),
            (Some(first), Some(last)) => {
                self.triangles.push([first, last, index]);
                self.last = Some(index);
            }
            (Some(_), None) => self.last = Some(index),
        }
        Ok(())
    }
}
