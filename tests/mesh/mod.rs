//! Triangles that block segments: what a scan's own mesh says about who sees whom.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use glam::DVec3;
use ply_rs::parser::Parser;
use ply_rs::ply::{DefaultElement, Property};

/// Triangles in a tree of boxes.
pub struct Mesh {
    triangles: Vec<[DVec3; 3]>,
    nodes: Vec<Node>,
}

/// A box; inner nodes are followed by their first half.
struct Node {
    low: DVec3,
    high: DVec3,
    /// First triangle and number of triangles, none in inner nodes.
    leaf: (usize, usize),
    /// The next node where the box is not met.
    skip: usize,
}

const LEAF: usize = 4;

impl Mesh {
    /// The faces of a PLY file.
    pub fn read(path: &Path) -> Mesh {
        let mut file = BufReader::new(File::open(path).expect("a file"));
        let ply = Parser::<DefaultElement>::new()
            .read_ply(&mut file)
            .expect("a PLY file");
        let number = |vertex: &DefaultElement, name: &str| match vertex[name] {
            Property::Float(x) => f64::from(x),
            ref other => panic!("{name} is {other:?}"),
        };
        let vertices: Vec<DVec3> = ply.payload["vertex"]
            .iter()
            .map(|v| ["x", "y", "z"].map(|name| number(v, name)).into())
            .collect();
        let triangles = ply.payload["face"].iter().map(|f| {
            let Property::ListInt(corners) = &f["vertex_indices"] else {
                panic!("faces are no lists of integers")
            };
            std::array::from_fn(|k| vertices[corners[k] as usize])
        });
        let mut mesh = Mesh {
            triangles: triangles.collect(),
            nodes: Vec::new(),
        };
        mesh.split(0, mesh.triangles.len());
        mesh
    }

    pub fn area(&self) -> f64 {
        let twice = |[a, b, c]: &[DVec3; 3]| (*b - *a).cross(*c - *a).length();
        0.5 * self.triangles.iter().map(twice).sum::<f64>()
    }

    fn split(&mut self, begin: usize, end: usize) {
        let triangles = &mut self.triangles[begin..end];
        let corners = || triangles.iter().flatten();
        let low = corners().fold(DVec3::INFINITY, |low, &p| low.min(p));
        let high = corners().fold(DVec3::NEG_INFINITY, |high, &p| high.max(p));
        let at = self.nodes.len();
        let leaf = (begin, (end - begin) * usize::from(end - begin <= LEAF));
        self.nodes.push(Node {
            low,
            high,
            leaf,
            skip: 0,
        });
        if end - begin > LEAF {
            let axis = (high - low).max_position();
            let middle = triangles.len() / 2;
            let key = |t: &[DVec3; 3]| t[0][axis] + t[1][axis] + t[2][axis];
            triangles.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)));
            self.split(begin, begin + middle);
            self.split(begin + middle, end);
        }
        self.nodes[at].skip = self.nodes.len();
    }

    /// Whether the open segment meets a triangle.
    pub fn blocks(&self, from: DVec3, to: DVec3) -> bool {
        let inverse = (to - from).recip();
        let mut k = 0;
        while let Some(node) = self.nodes.get(k) {
            let (a, b) = ((node.low - from) * inverse, (node.high - from) * inverse);
            let near = a.min(b).max_element().max(0.0);
            let far = a.max(b).min_element().min(1.0);
            let (first, count) = node.leaf;
            if near > far * (1.0 + 1e-12) {
                k = node.skip;
                continue;
            }
            if self.triangles[first..first + count]
                .iter()
                .any(|t| meets(t, from, to - from))
            {
                return true;
            }
            k += 1;
        }
        false
    }
}

/// T. Möller and B. Trumbore, "Fast, minimum storage ray-triangle intersection", 1997.
fn meets([a, b, c]: &[DVec3; 3], from: DVec3, way: DVec3) -> bool {
    let (e, f) = (*b - *a, *c - *a);
    let p = way.cross(f);
    let inverse = 1.0 / e.dot(p);
    let s = from - *a;
    let q = s.cross(e);
    let (u, v, t) = (s.dot(p) * inverse, way.dot(q) * inverse, f.dot(q) * inverse);
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < 1.0
}
