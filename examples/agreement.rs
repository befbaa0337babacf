//! How far the light of two scans of one place, of different density, is apart where they have points
//! in common: point by point, and the means over small boxes, of surfaces that face the same way.
//!
//! ```sh
//! cargo run --release --example agreement -- coarse.ply fine.ply 0.05
//! ```
//!
//! The files are outputs of `solve`; the last number is the size of the boxes.

use std::collections::HashMap;
use std::path::Path;

use fmmgi_gpu::compare::{compare, read_irradiance};
use fmmgi_gpu::glam::{DVec3, Vec3};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::{Error, Result, Scene};

/// Places that agree to this part of the scan's unit are one.
const ONE_PLACE: f64 = 1e-4;
/// A box needs so many points of both, or says nothing.
const LEAST: f32 = 4.0;

struct Map {
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    irradiance: Vec<Vec3>,
}

impl Map {
    fn read(path: &str) -> Result<Map> {
        let path = Path::new(path);
        let normals = Scene::load(path, &SceneOptions::default(), &Silent)?
            .cloud
            .normals;
        let (positions, irradiance) = read_irradiance(path, &Silent)?;
        Ok(Map {
            positions,
            normals,
            irradiance,
        })
    }

    /// Sums of light and numbers of points, by box and by the axis that is nearest to the normal.
    fn boxes(&self, size: f64) -> HashMap<[i64; 4], (Vec3, f32)> {
        let mut boxes: HashMap<_, (Vec3, f32)> = HashMap::new();
        for (i, normal) in self.normals.iter().enumerate() {
            let axis = normal.abs().max_position();
            let side = 2 * axis as i64 + i64::from(normal[axis] > 0.0);
            let [x, y, z] = cell(self.positions[i], size);
            let sum = boxes.entry([x, y, z, side]).or_default();
            sum.0 += self.irradiance[i];
            sum.1 += 1.0;
        }
        boxes
    }
}

fn cell(p: DVec3, size: f64) -> [i64; 3] {
    (p / size).round().to_array().map(|x| x as i64)
}

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [a, b, size] = &args[..] else {
        return Err(Error::Usage("agreement A.ply B.ply SIZE".into()));
    };
    let size: f64 = (size.parse()).map_err(|_| Error::Usage(format!("{size}: no size")))?;
    let (a, b) = (Map::read(a)?, Map::read(b)?);

    let places: HashMap<[i64; 3], usize> = (b.positions.iter().enumerate())
        .map(|(i, &p)| (cell(p, ONE_PLACE), i))
        .collect();
    let pairs: Vec<(usize, usize)> = (a.positions.iter().enumerate())
        .filter_map(|(i, &p)| Some((i, *places.get(&cell(p, ONE_PLACE))?)))
        .collect();
    println!(
        "{} and {} points, {} of them in common",
        a.positions.len(),
        b.positions.len(),
        pairs.len()
    );
    let cos = |&(i, j): &(usize, usize)| a.normals[i].dot(b.normals[j]);
    let group = |name: &str, least: f32, most: f32| -> Result<()> {
        let some = pairs.iter().filter(|p| (least..most).contains(&cos(p)));
        let (x, y): (Vec<Vec3>, Vec<Vec3>) = some
            .map(|&(i, j)| (a.irradiance[i], b.irradiance[j]))
            .unzip();
        if x.is_empty() {
            return Ok(());
        }
        println!("{name}: {}", compare(&x, &y)?);
        Ok(())
    };
    group("all", -2.0, 2.0)?;
    group("normals within 8 degrees", 0.99, 2.0)?;
    group("normals within 8 to 25 degrees", 0.9, 0.99)?;
    group("normals within 25 to 90 degrees", 0.0, 0.9)?;
    group("normals opposite", -2.0, 0.0)?;

    let of_b = b.boxes(size);
    let (x, y): (Vec<Vec3>, Vec<Vec3>) = a
        .boxes(size)
        .iter()
        .filter_map(|(at, &(light, count))| {
            let &(other, others) = of_b.get(at)?;
            (count >= LEAST && others >= LEAST).then(|| (light / count, other / others))
        })
        .unzip();
    println!("means over boxes of {size}: {}", compare(&x, &y)?);
    Ok(())
}
