//! Built-in shapes as the sampler sees them: pieces of surface, and what is solid behind them.

use std::fmt::Debug;

use glam::{DVec3, Vec3};

/// A smooth piece of surface f(u, v), u and v in [0, 1].
pub(super) trait Surface: Debug + Send + Sync {
    fn at(&self, u: f64, v: f64) -> DVec3;

    /// ∂f/∂u and ∂f/∂v; by default central differences, for which f must be smooth a little beyond
    /// its square.
    fn tangents(&self, u: f64, v: f64) -> [DVec3; 2] {
        const STEP: f64 = 1e-5;
        [
            (self.at(u + STEP, v) - self.at(u - STEP, v)) / (2.0 * STEP),
            (self.at(u, v + STEP) - self.at(u, v - STEP)) / (2.0 * STEP),
        ]
    }

    /// Cells along u and v that resolve how |∂f/∂u × ∂f/∂v| changes.
    fn cells(&self) -> [usize; 2];
}

/// A closed body that no light is in.
pub(super) trait Solid: Debug + Send + Sync {
    /// True strictly inside.
    fn contains(&self, p: DVec3) -> bool;
    /// A length of the body's order, which scales what counts as touching.
    fn size(&self) -> f64;
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Material {
    pub reflectance: Vec3,
    pub emission: Vec3,
}

/// A surface, which way it faces and what it is made of.
#[derive(Debug)]
pub(super) struct Part {
    pub surface: Box<dyn Surface>,
    /// The normal is against ∂f/∂u × ∂f/∂v.
    pub flipped: bool,
    pub material: Material,
    /// The solid that this surface bounds, as an index into [`Model::solids`].
    pub solid: Option<usize>,
}

/// All shapes of a scene.
#[derive(Debug, Default)]
pub(super) struct Model {
    pub parts: Vec<Part>,
    pub solids: Vec<Box<dyn Solid>>,
}

impl Model {
    /// Adds a solid and returns its index.
    pub fn add_solid(&mut self, solid: impl Solid + 'static) -> usize {
        self.solids.push(Box::new(solid));
        self.solids.len() - 1
    }

    /// True where another solid than the surface's own lies over it: inside that solid, or where
    /// the two touch face to face.
    pub fn covered(&self, part: &Part, position: DVec3, normal: DVec3) -> bool {
        self.solids.iter().enumerate().any(|(i, solid)| {
            part.solid != Some(i) && solid.contains(position + normal * (1e-6 * solid.size()))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::file::SceneFile;
    use super::super::sample::sample;
    use super::*;
    use crate::progress::Silent;

    #[test]
    fn every_part_bounds_its_solid_and_faces_away_from_it() {
        let text = r#"
            [[shape]]
            box = { centre = [1, 2, 3], size = [1, 2, 3], rotate = [10, 20, 30] }
            [[shape]]
            sphere = { centre = [1, 2, 3], radius = 2 }
            [[shape]]
            sphere = { centre = [1, 2, 3], radius = 2, bumps = 0.8 }
            [[shape]]
            cave = { start = [1, 2, 3], radius = 2, length = 16, columns = 7 }
        "#;
        let file: SceneFile = toml::from_str(text).unwrap();
        let mut model = Model::default();
        file.shape.iter().for_each(|shape| shape.build(&mut model));
        assert_eq!(model.parts.len(), 6 + 1 + 1 + 3 + 7);
        for part in &model.parts {
            let solid = &model.solids[part.solid.unwrap()];
            for s in sample(&*part.surface, 2_000, 1, &Silent).unwrap() {
                let out = if part.flipped { -s.normal } else { s.normal };
                let step = out * 1e-6 * solid.size();
                assert!(solid.contains(s.position - step), "{part:?}");
                assert!(!solid.contains(s.position + step), "{part:?}");
            }
        }
    }
}
