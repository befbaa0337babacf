//! Scene files, read anew.

use std::path::Path;

use glam::DVec3;
use toml::{Table, Value};

use super::body::Body;
use super::shape::{Ball, Quad};
use super::{Room, Shape, Surface};

impl Room {
    /// The scene of `scenes/NAME.toml`.
    pub fn load(name: &str) -> Room {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}.toml"));
        Room::read(&std::fs::read_to_string(path).unwrap())
    }

    pub fn read(text: &str) -> Room {
        let file: Table = text.parse().unwrap();
        let tables = |key: &str| -> Vec<Table> {
            let list = file.get(key).and_then(Value::as_array);
            let tables = list.into_iter().flatten().map(|t| t.as_table().cloned());
            tables.map(Option::unwrap).collect()
        };
        assert!(tables("cloud").is_empty(), "scans have no known surface");
        Room {
            surfaces: tables("shape").iter().flat_map(surfaces).collect(),
            lights: tables("light")
                .iter()
                .map(|l| (vector(&l["position"]), colour(&l["intensity"])))
                .collect(),
            sky: file.get("sky").map_or(DVec3::ZERO, colour),
        }
    }
}

fn number(value: &Value) -> f64 {
    value
        .as_float()
        .unwrap_or_else(|| value.as_integer().unwrap() as f64)
}

fn numbers<const N: usize>(value: &Value) -> [f64; N] {
    let list = value.as_array().unwrap();
    assert_eq!(list.len(), N);
    std::array::from_fn(|k| number(&list[k]))
}

fn vector(value: &Value) -> DVec3 {
    DVec3::from_array(numbers(value))
}

/// One number or three.
fn colour(value: &Value) -> DVec3 {
    match value {
        Value::Array(_) => vector(value),
        _ => DVec3::splat(number(value)),
    }
}

fn flag(table: &Table, key: &str) -> bool {
    table.get(key).is_some_and(|v| v.as_bool().unwrap())
}

fn surfaces(table: &Table) -> Vec<Surface> {
    let reflectance = table.get("reflectance").map_or(DVec3::splat(0.5), colour);
    let emission = table.get("emission").map_or(DVec3::ZERO, colour);
    let made_of = |shape: Shape, reflectance: DVec3| Surface {
        shape,
        reflectance,
        emission,
    };
    let of = |kind: &str| table.get(kind).map(|shape| shape.as_table().unwrap());
    if let Some(quad) = of("quad") {
        return vec![made_of(Shape::Quad(flat(quad)), reflectance)];
    }
    if let Some(sphere) = of("sphere") {
        return vec![made_of(round(sphere), reflectance)];
    }
    let block = of("box").expect("a shape that the tracer knows");
    faces(block)
        .map(|(name, quad)| {
            let own = block.get("faces").and_then(|faces| faces.get(name));
            made_of(Shape::Quad(quad), own.map_or(reflectance, colour))
        })
        .collect()
}

fn flat(table: &Table) -> Quad {
    let [corner, u, v] = ["corner", "u", "v"].map(|key| vector(&table[key]));
    let quad = Quad::new(corner, u, v);
    match table.get("hole") {
        Some(hole) => quad.with_hole(numbers(&hole["u"]), numbers(&hole["v"])),
        None => quad,
    }
}

fn round(table: &Table) -> Shape {
    let (centre, radius) = (vector(&table["centre"]), number(&table["radius"]));
    let inward = flag(table, "inward");
    match table.get("bumps").map(number) {
        Some(bumps) => {
            assert!(!inward, "bumpy spheres are seen from outside");
            Shape::Body(Body::new(centre, radius, bumps))
        }
        None => Shape::Ball(Ball {
            centre,
            radius,
            inward,
        }),
    }
}

/// The faces of a box that are not left out.
fn faces(table: &Table) -> impl Iterator<Item = (&'static str, Quad)> {
    let (centre, size) = (vector(&table["centre"]), vector(&table["size"]));
    let angles = table.get("rotate").map_or(DVec3::ZERO, vector);
    let inward = flag(table, "inward");
    let open: Vec<&str> = table
        .get("open")
        .and_then(Value::as_array)
        .into_iter()
        .flatten()
        .map(|face| face.as_str().unwrap())
        .collect();
    let names = [["left", "right"], ["bottom", "top"], ["back", "front"]];
    let mut quads = Vec::new();
    for axis in 0..3 {
        for side in 0..2 {
            let name = names[axis][side];
            if open.contains(&name) {
                continue;
            }
            let edge = |k: usize| {
                let mut edge = DVec3::ZERO;
                edge[k % 3] = size[k % 3];
                turned(edge, angles)
            };
            // u × v points along the axis; out of the box on its far side.
            let (out, mut u, mut v) = (edge(axis), edge(axis + 1), edge(axis + 2));
            if (side == 0) != inward {
                (u, v) = (v, u);
            }
            let middle = centre + out * (side as f64 - 0.5);
            quads.push((name, Quad::new(middle - 0.5 * (u + v), u, v)));
        }
    }
    quads.into_iter()
}

/// Turned about the x axis, then y, then z, by degrees.
fn turned(mut p: DVec3, degrees: DVec3) -> DVec3 {
    for axis in 0..3 {
        let (sin, cos) = degrees[axis].to_radians().sin_cos();
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        (p[i], p[j]) = (cos * p[i] - sin * p[j], sin * p[i] + cos * p[j]);
    }
    p
}
