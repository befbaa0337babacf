//! The stages of the operator one by one, on the CPU in f32 and on an adapter.

use glam::Vec3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use super::usage::{Clock, median};
use crate::error::Result;
use crate::expansion::Surface;
use crate::illuminate::prepared;
use crate::links::{self, Accuracy, Entry, Links, MIXED_ORDER, Rows};
use crate::octree::{LEAF_SIZE, Octree};
use crate::passes::cpu;
use crate::passes::gpu::{Batch, Batches, Gpu, GpuVisibility, Stages};
use crate::points::Surfels;
use crate::progress::{Progress, Silent};
use crate::scene::Scene;
use crate::visibility::{CpuVisibility, Occluders, Segment, Visibility, face};

/// Error of the links, in units of the mean irradiance.
const ERROR: f32 = 0.03;
/// Neighbours in the octree's order that each leaf meets surfel by surfel.
const NEIGHBOURS: usize = 24;
/// Segments that are tested.
const SEGMENTS: usize = 100_000;
/// Runs of a stage of which the time is the median, at most, and seconds after which there are no more.
const RUNS: usize = 7;
const ENOUGH: f64 = 0.5;

/// A stage on both sides.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageRow {
    pub scene: String,
    pub surfels: usize,
    pub stage: String,
    /// Order of the expansions; `None` where there are none.
    pub order: Option<usize>,
    /// What it handles, so many of them: surfels, facets, links, pairs, segments.
    pub elements: usize,
    /// Seconds on the CPU, in f32 on all threads.
    pub cpu_seconds: f64,
    /// Seconds on the adapter.
    pub gpu_seconds: f64,
}

/// A scene with the links of an even light.
pub struct Linked {
    pub surfels: Surfels,
    pub octree: Octree,
    pub occluders: Occluders,
    pub links: Links,
}

/// What is done with a stage: its name, how much it handles, the stage on the CPU and on the adapter.
pub type Visit<'a> = &'a mut dyn FnMut(&str, usize, &mut dyn FnMut(), Option<OnGpu>) -> Result<()>;
/// A stage on the adapter, from its start to its end.
pub type OnGpu<'a> = &'a dyn Fn() -> Result<()>;

impl Linked {
    pub fn new(scene: &Scene, progress: &dyn Progress) -> Result<Linked> {
        let (octree, surfels) = Octree::build(&prepared(scene, progress)?.0, LEAF_SIZE);
        let occluders = Occluders::build(&surfels);
        let facets = octree.facets.len();
        let accuracy = Accuracy {
            order: 1,
            error: ERROR,
            radiosity: vec![1.0; facets],
            target_factor: vec![1.0; facets],
            seed: 1,
        };
        let visibility = CpuVisibility::<f32>::new(&occluders);
        let links = links::build(&surfels, &octree, &accuracy, &visibility, progress)?;
        Ok(Linked {
            surfels,
            octree,
            occluders,
            links,
        })
    }

    /// The stages of expansions, all of one order: the far links of the scene, and those of them that
    /// end or begin at a leaf as M2P and P2L, those between leaves as mixed links.
    pub fn expansions(&self, gpu: Option<&Gpu>, order: usize, visit: Visit) -> Result<()> {
        let (octree, facets) = (&self.octree, self.octree.facets.len());
        let far = &self.links.m2l[1];
        let of = |keep: &dyn Fn(usize, usize) -> bool| {
            let entries =
                (0..facets).flat_map(|t| far.row(t).map(move |(s, weight)| (t, s, weight)));
            let kept = entries.filter(|&(t, s, _)| keep(t, s));
            Rows::new(
                facets,
                kept.map(|(t, s, weight)| entry(t, s, weight)).collect(),
            )
        };
        let leaf = |f: usize| octree.facets[f].is_leaf();
        let mut links = Links {
            m2l: vec![Rows::none(facets); order + 1],
            m2p: of(&|t, _| leaf(t)),
            p2l: of(&|_, s| leaf(s)),
            mixed: of(&|t, s| leaf(t) && leaf(s)),
            ..self.links.clone()
        };
        links.m2l[order] = far.clone();
        let links = &links;
        let surface = &Surface::<f32>::new(&self.surfels);
        let radiosity = &vec![Vec3::ONE; self.surfels.len()];
        let mut moments = cpu::p2m(order, octree, surface, radiosity);
        cpu::m2m(octree, &mut moments);
        let mut locals = cpu::m2l(octree, links, &moments);
        let mut irradiance = cpu::l2p(octree, surface, &locals);
        let device = gpu.map(|gpu| OnDevice::new(gpu, self, links)).transpose()?;
        if let Some(device) = &device {
            device.run(&|stages, batch, field| {
                stages.take(batch, field);
                stages.p2m(batch)?;
                stages.m2m(batch)?;
                stages.m2l(batch)
            })?;
        }
        let mut stage =
            |name: &str, elements: usize, on_cpu: &mut dyn FnMut(), on_gpu: Dispatch| {
                both(visit, device.as_ref(), name, elements, on_cpu, on_gpu)
            };
        let n = self.surfels.len();
        stage(
            "P2M",
            n,
            &mut || drop(cpu::p2m(order, octree, surface, radiosity)),
            &|stages, batch, _| stages.p2m(batch),
        )?;
        stage(
            "M2M",
            facets,
            &mut || cpu::m2m(octree, &mut moments),
            &|stages, batch, _| stages.m2m(batch),
        )?;
        stage(
            "M2L",
            far.len(),
            &mut || drop(cpu::m2l(octree, links, &moments)),
            &|stages, batch, _| stages.m2l(batch),
        )?;
        let pairs = |rows: &Rows, of_source: bool| -> usize {
            let surfels =
                |(t, s): (usize, usize)| octree.facets[if of_source { s } else { t }].len();
            (0..facets)
                .flat_map(|t| rows.row(t).map(move |(s, _)| (t, s)))
                .map(surfels)
                .sum()
        };
        stage(
            "P2L",
            pairs(&links.p2l, true),
            &mut || cpu::p2l(octree, &links.p2l, surface, radiosity, &mut locals),
            &|stages, batch, _| stages.p2l(batch),
        )?;
        stage(
            "M2P",
            pairs(&links.m2p, false),
            &mut || cpu::m2p(octree, &links.m2p, surface, &moments, &mut irradiance),
            &|stages, batch, field| stages.m2p(batch, field),
        )?;
        let mut inherited = cpu::m2l(octree, links, &moments);
        stage(
            "L2L",
            facets,
            &mut || cpu::l2l(octree, &mut inherited),
            &|stages, batch, _| stages.l2l(batch),
        )?;
        stage(
            "L2P",
            n,
            &mut || drop(cpu::l2p::<f32, Vec3>(octree, surface, &inherited)),
            &|stages, batch, field| stages.l2p(batch, field),
        )?;
        let mixed_order = order.min(MIXED_ORDER);
        stage(
            "mixed",
            links.mixed.len(),
            &mut || {
                cpu::mixed(
                    mixed_order,
                    octree,
                    &links.mixed,
                    surface,
                    radiosity,
                    &moments,
                    &mut irradiance,
                )
            },
            &|stages, batch, field| stages.mixed(batch, field),
        )
    }

    /// The stages without expansions: stored form factors, pairs of surfels, and lines of sight.
    pub fn pairs(&self, gpu: Option<&Gpu>, visit: Visit) -> Result<()> {
        let (octree, n) = (&self.octree, self.surfels.len());
        let surface = &Surface::<f32>::new(&self.surfels);
        let radiosity = &vec![Vec3::ONE; n];
        let mut irradiance = vec![Vec3::ZERO; n];
        let links = Links {
            m2l: vec![Rows::none(octree.facets.len()); 2],
            near: self.links.near.clone(),
            p2p: neighbours(octree),
            ..Links::none(octree.facets.len(), n)
        };
        let device = gpu
            .map(|gpu| OnDevice::new(gpu, self, &links))
            .transpose()?;
        if let Some(device) = &device {
            device.run(&|stages, batch, field| {
                stages.take(batch, field);
                Ok(())
            })?;
        }
        let mut stage =
            |name: &str, elements: usize, on_cpu: &mut dyn FnMut(), on_gpu: Dispatch| {
                both(visit, device.as_ref(), name, elements, on_cpu, on_gpu)
            };
        stage(
            "near field",
            links.near.len(),
            &mut || cpu::near_field::<f32, _>(&links.near, radiosity, &mut irradiance),
            &|stages, batch, field| stages.near_field(batch, field),
        )?;
        let facets = &octree.facets;
        let pairs = |t: usize| -> usize {
            let sources = links.p2p.row(t).map(|(s, _)| facets[s].len());
            facets[t].len() * sources.sum::<usize>()
        };
        stage(
            "P2P",
            (0..facets.len()).map(pairs).sum(),
            &mut || cpu::p2p(octree, surface, &links.p2p, radiosity, &mut irradiance),
            &|stages, batch, field| stages.p2p(batch, field),
        )?;
        let segments = segments(&self.surfels, 1, SEGMENTS);
        let on_cpu = CpuVisibility::<f32>::new(&self.occluders);
        let on_gpu = gpu
            .map(|gpu| GpuVisibility::new(gpu, &self.occluders))
            .transpose()?;
        let test = |on: &dyn Visibility| on.visible(&segments).map(drop);
        let run = on_gpu.as_ref().map(|on_gpu| move || test(on_gpu));
        visit(
            "visibility",
            segments.len(),
            &mut || test(&on_cpu).expect("the CPU tests any segment"),
            run.as_ref().map(|run| run as OnGpu),
        )
    }

    /// Medians of all stages on both sides.
    pub fn measure(&self, scene: &str, gpu: &Gpu, orders: &[usize]) -> Result<Vec<StageRow>> {
        let mut rows = Vec::new();
        for order in orders.iter().copied().map(Some).chain([None]) {
            let mut visit =
                |stage: &str, elements: usize, on_cpu: &mut dyn FnMut(), on_gpu: Option<OnGpu>| {
                    let cpu_seconds = seconds(&mut || {
                        on_cpu();
                        Ok(())
                    })?;
                    let on_gpu = on_gpu.expect("there is an adapter");
                    rows.push(StageRow {
                        scene: scene.to_owned(),
                        surfels: self.surfels.len(),
                        stage: stage.to_owned(),
                        order,
                        elements,
                        cpu_seconds,
                        gpu_seconds: seconds(&mut || on_gpu())?,
                    });
                    Ok(())
                };
            match order {
                Some(order) => self.expansions(Some(gpu), order, &mut visit)?,
                None => self.pairs(Some(gpu), &mut visit)?,
            }
        }
        Ok(rows)
    }
}

/// Median of some runs, after one that does not count.
fn seconds(run: &mut dyn FnMut() -> Result<()>) -> Result<f64> {
    run()?;
    let mut times = Vec::new();
    let all = Clock::start();
    while times.len() < RUNS && (times.is_empty() || all.spent().wall < ENOUGH) {
        let clock = Clock::start();
        run()?;
        times.push(clock.spent().wall);
    }
    Ok(median(&times))
}

/// What puts a stage into a batch.
type Dispatch<'a> = &'a dyn Fn(&Stages, &mut Batch, &wgpu::Buffer) -> Result<()>;

/// The stages of some links on a device, and a field for them.
struct OnDevice {
    stages: Stages,
    field: wgpu::Buffer,
    batches: Batches,
}

impl OnDevice {
    fn new(gpu: &Gpu, linked: &Linked, links: &Links) -> Result<OnDevice> {
        Ok(OnDevice {
            stages: Stages::new(gpu, &linked.surfels, &linked.octree, links)?,
            field: gpu.storage("field", linked.surfels.len() * 16)?,
            batches: Batches::new(gpu)?,
        })
    }

    fn run(&self, dispatch: Dispatch) -> Result<()> {
        let run = |batch: &mut Batch| dispatch(&self.stages, batch, &self.field);
        self.batches.run_and_wait("stage", run)
    }
}

fn both(
    visit: Visit,
    device: Option<&OnDevice>,
    name: &str,
    elements: usize,
    on_cpu: &mut dyn FnMut(),
    on_gpu: Dispatch,
) -> Result<()> {
    let run = device.map(|device| move || device.run(on_gpu));
    visit(name, elements, on_cpu, run.as_ref().map(|run| run as OnGpu))
}

fn entry(target: usize, source: usize, weight: f32) -> Entry {
    Entry {
        target: target as u32,
        source: source as u32,
        weight,
    }
}

/// Every leaf from those next to it in the octree's order.
fn neighbours(octree: &Octree) -> Rows {
    let leaves: Vec<usize> = octree.leaves.iter().map(|&f| f as usize).collect();
    let count = NEIGHBOURS.min(leaves.len());
    let mut entries = Vec::with_capacity(leaves.len() * count);
    for (k, &target) in leaves.iter().enumerate() {
        let first = k.saturating_sub(count / 2).min(leaves.len() - count);
        let sources = &leaves[first..first + count];
        entries.extend(sources.iter().map(|&source| entry(target, source, 1.0)));
    }
    Rows::new(octree.facets.len(), entries)
}

/// Segments between surfels that face each other: groups of `group` go from surfels side by side to
/// surfels side by side. Fewer than asked for where few face each other.
pub fn segments(surfels: &Surfels, group: usize, count: usize) -> Vec<Segment> {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let n = surfels.len();
    let mut segments = Vec::with_capacity(count + group);
    for _ in 0..100 * count {
        if segments.len() >= count || n <= group {
            break;
        }
        let [i, j] = [(); 2].map(|_| random.random_range(0..n - group));
        segments.extend(
            (0..group)
                .map(|k| (i + k / 4, j + k % 4))
                .filter(|&(i, j)| face(surfels, i, j))
                .map(|(i, j)| surfels.segment(i, j)),
        );
    }
    segments.truncate(count);
    segments
}

/// Links and stages of a scene, measured on an adapter and on the CPU.
pub fn measure(scene: &str, of: &Scene, gpu: &Gpu, orders: &[usize]) -> Result<Vec<StageRow>> {
    Linked::new(of, &Silent)?.measure(scene, gpu, orders)
}
