//! Light on point clouds: the diffuse light at every point, direct and after all bounces, with
//! what stands in its way.
//!
//! [`illuminate()`] does the whole job: a [`Scene`] in, an [`IlluminationMap`] and [`Stats`] out. A
//! [`Transport`] does it for one light after the other, and finds once what no light changes. A [`Plan`]
//! says beforehand what will be done, why, and what it will take.
//! It works on the CPU, or in WGSL on a [`wgpu::Device`] that the caller made: a renderer hands
//! over its own.
//!
//! ```
//! use fmmgi_gpu::glam::{DVec3, Vec3};
//! use fmmgi_gpu::progress::Silent;
//! use fmmgi_gpu::{Backend, Options, PointCloud, Scene, illuminate};
//!
//! // Two unit squares that face each other at distance 1, in 20 by 20 points each: the lower one
//! // shines with 1, the upper one reflects half of what it gets.
//! let mut cloud = PointCloud::default();
//! for k in 0..400 {
//!     let [x, y] = [k % 20, k / 20].map(|i| (f64::from(i) + 0.5) / 20.0);
//!     for (z, normal, emission, reflectance) in
//!         [(0.0, Vec3::Z, 1.0, 0.0), (1.0, Vec3::NEG_Z, 0.0, 0.5)]
//!     {
//!         cloud.positions.push(DVec3::new(x, y, z));
//!         cloud.normals.push(normal);
//!         cloud.emission.push(Vec3::splat(emission));
//!         cloud.reflectance.push(Vec3::splat(reflectance));
//!     }
//! }
//! let scene = Scene { cloud, ..Scene::default() };
//!
//! let lit = illuminate(&scene, &Options::default(), Backend::Cpu, &Silent)?;
//!
//! // The form factor from square to square is 0.1998.
//! let upper = lit.map.irradiance.iter().skip(1).step_by(2);
//! let mean = upper.map(|h| h.x).sum::<f32>() / 400.0;
//! assert!((mean - 0.1998).abs() < 0.002);
//! # Ok::<(), fmmgi_gpu::Error>(())
//! ```
//!
//! # The way
//!
//! 1. [`scan`] reads a file of points, [`scene`] a scene file with shapes, scans, lights and a
//!    camera: a [`PointCloud`].
//! 2. [`points`] turns points into [`Surfels`]: each gets a *cell*, the piece of surface that it
//!    stands for, which is its area, its shape as a source nearby, and what blocks light.
//! 3. [`octree`] sorts the surfels into *facets*: parts of space with normals of one direction.
//! 4. [`visibility`] tests segments against the cells, in batches; [`lights`] finds the direct
//!    light of each surfel with it.
//!    [`smoothing`] takes off what is noise of samples, of shadows and of the light that links bring.
//! 5. [`links`] decides which facet gives light to which, and measures how much of it gets
//!    through. Far away, [`expansion`] stands for all surfels of a facet; nearby, surfels are
//!    linked one by one. Where nothing stands in the way, [bounds alone](links::build_open()) make
//!    them. With the method [`Gather`](Method::Gather) [rays](links::gather()) do, surfel by surfel,
//!    beside [close pairs](links::Close); with [`Classic`](Method::Classic) the
//!    [visibility](links::classic()) of all pairs of points.
//!    Links that geometry alone makes, the [lists](links::adaptive()) of the adaptive method and those
//!    of a [dual traversal](links::dual()), are there to compare with.
//! 6. [`operator`] applies the links: radiosity in, irradiance out. Its stages are in [`passes`],
//!    under one name in Rust and in WGSL.
//! 7. [`mod@solve`] finds the radiosity that the operator and the reflectance keep as it is;
//!    [`illuminate::checks`] says how far the operator is from what physics asks of it.
//! 8. [`map`] hands the light of the surfels to the points of the cloud; [`output`] writes it to
//!    files, [`render`] takes a picture, [`mod@compare`] says how far two maps are apart.
//!
//! [`chart`] measures all ways of doing it, one against the other.
//!
//! # Units
//!
//! Lengths are in the unit of the scan, areas in its square. Light is linear RGB in any unit:
//! emission, irradiance H and radiosity B have the same one, and B = emission + reflectance · H.
//! The irradiance of surfel i is
//! H_i = Σ_j A_j B_j max(0, cos_i) max(0, cos_j) V_ij / (π r²), where V_ij says whether i and j see
//! each other; a point light of intensity I gives I cos / r², a uniform sky an open plane its value.
//! A surfel shines and reflects to the side of its normal only, and blocks light from both sides.

// The whole job, and what it will take.
pub mod illuminate;
pub mod plan;

// Points from files.
pub mod scan;
pub mod scene;

// Surfels from points, and their order in space.
pub mod octree;
pub mod points;

// Who sees whom, and what comes straight from the lights.
pub mod lights;
pub mod smoothing;
pub mod visibility;

// Transport between surfels: what is linked, how it is applied.
pub mod expansion;
pub mod links;
pub mod operator;
pub mod passes;

// The solution and what is made of it.
pub mod compare;
pub mod map;
pub mod output;
pub mod render;
pub mod solve;

// Speed against accuracy.
pub mod chart;

// Used all along the way.
pub mod cgroup;
pub mod colour;
pub mod error;
pub mod math;
pub mod memory;
pub mod progress;
mod random;

pub use error::{Error, Result};
pub use illuminate::stats::Stats;
pub use illuminate::{
    Backend, Checkpoint, Illumination, Method, Occlusion, Options, Transport, illuminate,
};
pub use map::IlluminationMap;
pub use plan::Plan;
pub use points::{PointCloud, Surfels};
pub use progress::Progress;
pub use scene::Scene;

// Vectors and devices of these versions are what the library takes.
pub use {glam, wgpu};
