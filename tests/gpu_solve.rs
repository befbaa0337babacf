//! Whole solves with occlusion on a device: every bounce stays there, and the light is that of the
//! CPU.

mod cases;
mod common;

use std::cell::Cell;

use cases::{Case, colours, relative_l2};
use common::{gpu, room};
use fmmgi_gpu::links::{self, Accuracy, Links};
use fmmgi_gpu::octree::{LEAF_SIZE, Octree};
use fmmgi_gpu::operator::{Fields, Fmm, GpuFields, GpuFmm, TransportOperator};
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scene::SceneOptions;
use fmmgi_gpu::solve::{Stop, solve};
use fmmgi_gpu::visibility::{CpuVisibility, Occluders};
use fmmgi_gpu::{Result, Scene, Surfels, lights};
use glam::DVec3;
use wgpu::Buffer;

const TOLERANCE: f64 = 0.03;

/// A scene with the light of its lamps and with links for what is reflected.
struct Lit {
    surfels: Surfels,
    octree: Octree,
    links: Links,
    lights: Vec<DVec3>,
}

impl Lit {
    fn load(name: &str, points: usize) -> Lit {
        let path = format!("{}/scenes/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let options = SceneOptions {
            points: Some(points),
            seed: 1,
            ..SceneOptions::default()
        };
        let scene = Scene::load(path.as_ref(), &options, &Silent).unwrap();
        let prepared = Surfels::prepare(&scene.cloud, &Silent).unwrap();
        let (octree, surfels) = Octree::build(&prepared.surfels, LEAF_SIZE);
        let occluders = Occluders::build(&surfels);
        let visibility = CpuVisibility::<f32>::new(&occluders);
        let lamps = lights::point_lights(&surfels, &scene.lights, &visibility, &Silent).unwrap();
        let sky = lights::sky(
            &surfels,
            scene.sky,
            TOLERANCE,
            1,
            &visibility,
            None,
            &Silent,
        )
        .unwrap();
        let shining = lights::emitters(&surfels, TOLERANCE, 1, &visibility, &Silent).unwrap();
        let lights: Vec<DVec3> = (0..surfels.len())
            .map(|i| lamps.irradiance[i] + sky[i] + shining[i])
            .collect();
        let ambient = lights.iter().sum::<DVec3>() / lights.len() as f64;
        let reflected: Vec<DVec3> = (surfels.reflectance.iter().zip(&lights))
            .map(|(r, h)| r.as_dvec3() * (*h + ambient))
            .collect();
        let accuracy = Accuracy::new(&octree, &reflected, Some(&lights), TOLERANCE, 1, 1);
        let links = links::build(&surfels, &octree, &accuracy, &visibility, &Silent).unwrap();
        println!("{name}: {} surfels, {:?}", surfels.len(), links.counts());
        Lit {
            surfels,
            octree,
            links,
            lights,
        }
    }

    fn irradiance<O: TransportOperator>(&self, operator: &O) -> Vec<DVec3> {
        let fields = operator.fields();
        let reflectance = self.surfels.reflectance.iter().map(|r| r.as_dvec3());
        let reflectance = fields.upload(&reflectance.collect::<Vec<_>>()).unwrap();
        let lights = fields.upload(&self.lights).unwrap();
        let mut source = fields.copy(&lights).unwrap();
        fields.multiply(&reflectance, &mut source).unwrap();
        let stop = Stop {
            residual: 1e-4,
            bounces: None,
        };
        let (reflected, ended) =
            solve(operator, &reflectance, &source, None, stop, &Silent).unwrap();
        assert!(ended.converged, "{ended:?}");
        let mut irradiance = operator.apply(&reflected).unwrap();
        fields.axpy(1.0, &lights, &mut irradiance).unwrap();
        fields.download(&irradiance).unwrap()
    }
}

/// Links and answers of segments are those of the CPU: what is left is rounding.
fn compare(name: &str, points: usize) {
    let lit = Lit::load(name, points);
    let (surfels, octree, links) = (&lit.surfels, &lit.octree, &lit.links);
    let found = lit.irradiance(&GpuFmm::new(gpu(), surfels, octree, links).unwrap());
    let expected = lit.irradiance(&Fmm::<f32>::new(surfels, octree, links));
    let off = relative_l2(&found, &expected);
    println!("{name}: {off:.1e}");
    assert!(off < 1e-5, "{name}: {off}");
}

#[test]
fn cornell_is_lit_as_on_the_cpu() {
    compare("cornell", 20_000);
}

#[test]
fn two_rooms_are_lit_as_on_the_cpu() {
    compare("two_rooms", 5000);
}

#[test]
fn the_organic_body_is_lit_as_on_the_cpu() {
    compare("organic", 5000);
}

#[test]
fn the_cave_is_lit_as_on_the_cpu() {
    compare("cave", 5000);
}

/// A device's fields, and what passes between it and the host.
struct Watched<'a> {
    operator: &'a GpuFmm,
    uploads: Cell<usize>,
    downloads: Cell<usize>,
    /// Waits for inner products.
    waits: Cell<usize>,
}

fn count(counter: &Cell<usize>) {
    counter.set(counter.get() + 1);
}

impl Fields for Watched<'_> {
    type Field = Buffer;
    const EPSILON: f64 = GpuFields::EPSILON;

    fn upload(&self, values: &[DVec3]) -> Result<Buffer> {
        count(&self.uploads);
        self.inner().upload(values)
    }

    fn download(&self, field: &Buffer) -> Result<Vec<DVec3>> {
        count(&self.downloads);
        self.inner().download(field)
    }

    fn copy(&self, field: &Buffer) -> Result<Buffer> {
        self.inner().copy(field)
    }

    fn add(&self, terms: &[(f64, &Buffer)], y: &mut Buffer) -> Result<()> {
        self.inner().add(terms, y)
    }

    fn scale(&self, a: f64, x: &mut Buffer) -> Result<()> {
        self.inner().scale(a, x)
    }

    fn multiply(&self, factor: &Buffer, x: &mut Buffer) -> Result<()> {
        self.inner().multiply(factor, x)
    }

    fn dots(&self, xs: &[&Buffer], y: &Buffer) -> Result<Vec<f64>> {
        count(&self.waits);
        self.inner().dots(xs, y)
    }
}

impl Watched<'_> {
    fn inner(&self) -> &GpuFields {
        self.operator.fields()
    }
}

impl TransportOperator for Watched<'_> {
    type Fields = Self;

    fn fields(&self) -> &Self {
        self
    }

    fn apply(&self, radiosity: &Buffer) -> Result<Buffer> {
        self.operator.apply(radiosity)
    }
}

#[test]
fn a_bounce_brings_back_a_few_numbers() {
    let case = Case::linked("room", &room(10), 0.02);
    let n = case.surfels.len();
    let operator = case.operator();
    let fields = operator.fields();
    let source = fields.upload(&colours(n, 4)).unwrap();
    let reflectance: Vec<DVec3> = colours(n, 5).iter().map(|c| *c * 0.45).collect();
    let reflectance = fields.upload(&reflectance).unwrap();
    for bounces in [None, Some(6)] {
        let watched = Watched {
            operator: &operator,
            uploads: Cell::new(0),
            downloads: Cell::new(0),
            waits: Cell::new(0),
        };
        let stop = Stop {
            residual: 1e-5,
            bounces,
        };
        let (_, ended) = solve(&watched, &reflectance, &source, None, stop, &Silent).unwrap();
        assert!(ended.converged && ended.iterations >= 5, "{ended:?}");
        assert_eq!((watched.uploads.get(), watched.downloads.get()), (0, 0));
        // Two a bounce, the norm of the source, and that of the first or the last.
        let waits = watched.waits.get();
        assert!(
            waits <= 2 * ended.iterations as usize + 2,
            "{waits} {ended:?}"
        );
    }
}
