//! OBJ files: triangle meshes, or points alone.

use std::path::Path;

use glam::{DVec3, Vec3};

use super::colours::Stored;
use super::fields::{finished, judge_colours};
use super::lines::{Lines, Text, not_a_number, number, words};
use super::mesh::Mesh;
use super::polygons::Polygons;
use super::{ReadOptions, Scan};
use crate::error::{Error, Result};
use crate::points::{DEFAULT_REFLECTANCE, MAX_COLOUR_REFLECTANCE, PointCloud};
use crate::progress::Progress;

type Parsed<T> = std::result::Result<T, String>;

/// Reads an OBJ file: vertices `v x y z`, with or without a colour `r g b` (see
/// [colours](super::colours)), and faces `f`, whose [polygons](Polygons) are cut into triangles. A line that ends
/// with `\` goes on in the next. Materials and all else are skipped. Without faces the vertices are the points,
/// and have the normals `vn`, if there is one for each.
pub fn read(path: &Path, options: &ReadOptions, progress: &dyn Progress) -> Result<Scan> {
    let mut lines = Lines::open(path, progress)?;
    let mut content = Content::default();
    let mut line = Vec::new();
    while next(&mut lines, &mut line)? {
        let parsed = content.add(&line);
        parsed.map_err(|what| lines.error(what))?;
        if content.farthest.1 == 0 {
            content.farthest.1 = lines.number();
        }
    }
    let Content {
        mut vertices,
        normals,
        polygons,
        farthest: (farthest, number),
    } = content;
    let count = vertices.len();
    if count == 0 {
        return Err(Error::input(path, "empty mesh: the file has no vertices"));
    }
    if farthest as usize > count {
        return Err(Error::input(
            path,
            format!("line {number}: a face has the vertex {farthest}, but there are {count}"),
        ));
    }
    let has_colours = vertices.reflectance.iter().any(|r| !r.is_nan());
    let mut fields = vec!["x", "y", "z"];
    if has_colours {
        fields.extend(["r", "g", "b"]);
    }
    let mut repairs = lines.doubt().into_iter().collect();
    let colours = &mut vertices.reflectance;
    let how = judge_colours(colours, Stored::Words, options.colours, &mut repairs);
    let triangles = polygons.triangles(&vertices.positions, &mut repairs);
    let sampled = !triangles.is_empty();
    let mut taken = "place x y z".to_owned();
    if !sampled && normals.len() == count {
        vertices.normals = normals;
        fields.extend(["nx", "ny", "nz"]);
        taken += "; normals vn";
    }
    taken += &match how {
        Some(how) => format!("; colours r g b: {how}"),
        None => format!("; no colours: reflectance {DEFAULT_REFLECTANCE}"),
    };
    let cloud = finished(vertices, MAX_COLOUR_REFLECTANCE, repairs);
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

/// The next line, with those that it goes on in; returns whether there is one.
fn next(lines: &mut Lines<Text>, line: &mut Vec<u8>) -> Result<bool> {
    line.clear();
    while let Some(part) = lines.line()? {
        line.extend(part);
        if line.last() != Some(&b'\\') {
            return Ok(true);
        }
        line.pop();
        line.push(b' ');
    }
    Ok(!line.is_empty())
}

/// What a file has.
#[derive(Default)]
struct Content {
    vertices: PointCloud,
    normals: Vec<Vec3>,
    polygons: Polygons,
    /// The largest vertex of a face, counted from 1, which may come later, and its line; 0 while that is not
    /// known.
    farthest: (u32, u64),
}

impl Content {
    /// Adds what a line says.
    fn add(&mut self, line: &[u8]) -> Parsed<()> {
        let mut words = words(line);
        match words.next() {
            Some(b"v") => add_vertex(words, &mut self.vertices),
            Some(b"vn") => {
                let values = words.map(|word| number(word).unwrap_or(f64::NAN) as f32);
                let values: Vec<f32> = values.take(3).collect();
                if let [x, y, z] = values[..] {
                    self.normals.push(Vec3::new(x, y, z));
                }
                Ok(())
            }
            Some(b"f") => self.add_face(words),
            _ => Ok(()),
        }
    }

    /// Adds a face of corners like `3`, `3/1/2` or, counted from the last vertex, `-1`.
    fn add_face<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> Parsed<()> {
        let vertices = self.vertices.len();
        for word in words {
            let index = word.split(|&byte| byte == b'/').next();
            let index: Option<i64> = index.and_then(|i| std::str::from_utf8(i).ok()?.parse().ok());
            let from_one = match index {
                Some(from_start @ 1..) => from_start,
                Some(from_end @ ..=-1) => vertices as i64 + 1 + from_end,
                _ => return Err(not_a_number(word, "a corner of a face")),
            };
            let corner = u32::try_from(from_one).ok().filter(|&corner| corner > 0);
            let corner = corner.ok_or_else(|| {
                format!("a face has the vertex {from_one}, but there are {vertices} before it")
            })?;
            if corner > self.farthest.0 {
                self.farthest = (corner, 0);
            }
            self.polygons.add(corner - 1);
        }
        self.polygons.close();
        Ok(())
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
