//! OBJ files: triangle meshes, or points alone.

use std::path::Path;

use glam::DVec3;

use super::colours::Stored;
use super::fields::{finished, judge_colours};
use super::lines::{Lines, not_a_number, number, words};
use super::mesh::Mesh;
use super::{ReadOptions, Scan};
use crate::error::{Error, Result};
use crate::points::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud};
use crate::progress::Progress;

type Parsed<T> = std::result::Result<T, String>;

/// Reads an OBJ file: vertices `v x y z`, with or without a colour `r g b` (see
/// [colours](super::colours)), and faces `f`, whose polygons are cut into triangles around their first
/// corner. Normals, materials and all else are skipped. Without faces the vertices are the points.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let mut lines = Lines::open(path, progress)?;
    let mut vertices = PointCloud::default();
    let mut triangles = Vec::new();
    while let Some(line) = lines.line()? {
        let parsed = add(line, &mut vertices, &mut triangles);
        parsed.map_err(|what| lines.error(what))?;
    }
    let count = vertices.len();
    if count == 0 {
        return Err(Error::input(path, "empty mesh: the file has no vertices"));
    }
    let has_colours = vertices.reflectance.iter().any(|r| !r.is_nan());
    let mut fields = vec!["x", "y", "z"];
    if has_colours {
        fields.extend(["r", "g", "b"]);
    }
    let mut repairs = lines.doubt().into_iter().collect();
    let colours = &mut vertices.reflectance;
    let how = judge_colours(colours, Stored::Words, options.colours, &mut repairs);
    let taken = match how {
        Some(how) => format!("place x y z; colours r g b: {how}"),
        None => format!("place x y z; no colours: reflectance {DEFAULT_REFLECTANCE}"),
    };
    let cloud = finished(vertices, MAX_COLOUR_REFLECTANCE, repairs);
    let sampled = !triangles.is_empty();
    let format = if sampled {
        format!("OBJ, {count} vertices, {} triangles", triangles.len())
    } else {
        "OBJ, without faces".to_owned()
    };
    Ok(Scan {
        format,
        fields: fields.into_iter().map(str::to_owned).collect(),
        taken,
        sampled,
        cloud: if sampled {
            Mesh::new(cloud, triangles).sample(path, options, progress)?
        } else {
            cloud
        },
    })
}

/// Adds what a line says.
fn add(line: &[u8], vertices: &mut PointCloud, triangles: &mut Vec<[u32; 3]>) -> Parsed<()> {
    let mut words = words(line);
    match words.next() {
        Some(b"v") => add_vertex(words, vertices),
        Some(b"f") => add_face(words, vertices.len(), triangles),
        _ => Ok(()),
    }
}

/// Adds a vertex; a colour that is not there becomes no number.
fn add_vertex<'a>(words: impl Iterator<Item = &'a [u8]>, vertices: &mut PointCloud) -> Parsed<()> {
    let mut values = [f64::NAN; 6];
    let mut count = 0;
    for (value, word) in values.iter_mut().zip(words) {
        *value = number(word).ok_or_else(|| not_a_number(word, "a vertex"))?;
        count += 1;
    }
    if count < 3 {
        return Err(format!("a vertex of {count} numbers; it needs x, y and z"));
    }
    if vertices.len() == u32::MAX as usize {
        return Err(format!("more than {} vertices", u32::MAX));
    }
    let [x, y, z, colour @ ..] = values;
    // A fourth number alone is a weight.
    let colour = if count == 6 { colour } else { [f64::NAN; 3] };
    vertices.positions.push(DVec3::new(x, y, z));
    vertices.reflectance.push(DVec3::from(colour).as_vec3());
    Ok(())
}

/// Adds a face of corners like `3`, `3/1/2` or, counted from the last vertex, `-1`.
fn add_face<'a>(
    words: impl Iterator<Item = &'a [u8]>,
    vertices: usize,
    triangles: &mut Vec<[u32; 3]>,
) -> Parsed<()> {
    let corner = |word: &[u8]| {
        let index = word.split(|&byte| byte == b'/').next();
        let index: Option<i64> = index.and_then(|i| std::str::from_utf8(i).ok()?.parse().ok());
        let place = match index {
            Some(from_start @ 1..) => from_start - 1,
            Some(from_end @ ..=-1) => vertices as i64 + from_end,
            _ => return Err(not_a_number(word, "a corner of a face")),
        };
        match u32::try_from(place) {
            Ok(place) if (place as usize) < vertices => Ok(place),
            _ => Err(format!(
                "a face has the vertex {}, but there are {vertices} before it",
                place + 1
            )),
        }
    };
    let mut first_and_last = None;
    let mut corners = 0;
    for word in words {
        let corner = corner(word)?;
        first_and_last = match first_and_last {
            None => Some((corner, corner)),
            Some((first, last)) => {
                if corners > 1 {
                    triangles.push([first, last, corner]);
                }
                Some((first, corner))
            }
        };
        corners += 1;
    }
    if corners < 3 {
        return Err(format!("a face of {corners} corners"));
    }
    Ok(())
}

/// Whether the first line that says something begins with a word of OBJ files.
pub(super) fn begins(text: &[u8]) -> bool {
    let mut lines = text.split(|&byte| matches!(byte, b'\n' | b'\r'));
    let line = lines.find(|line| !(line.trim_ascii().is_empty() || line.starts_with(b"#")));
    let first = line.and_then(|line| words(line).next());
    let known: [&[u8]; 9] = [
        b"v", b"vn", b"vt", b"f", b"o", b"g", b"s", b"mtllib", b"usemtl",
    ];
    first.is_some_and(|word| known.contains(&word))
}
