//! What is charted, and doing it.

use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec3;

use super::machine::Machine;
use super::measure::{Case, Measured, Solve, load, name_of};
use super::orders::{Open, OrderRow};
use super::records::{Finished, Records};
use super::stages::{self, StageRow};
use super::truth::{PointTruth, SurfaceTruth};
use crate::Method;
use crate::error::{Error, Result};
use crate::passes::gpu::Gpu;
use crate::passes::gpu::adapter::OpenDevice;
use crate::progress::{Progress, Silent};

/// Tolerance to which exact sums are solved.
const DIRECT_TOLERANCE: f64 = 1e-3;
/// Tolerance of the lists of the report, whose error follows from states and order.
const CLASSIC_TOLERANCE: f64 = 0.01;
/// Rays, and the tolerance for lights that goes with them.
const RAYS: [(u32, f64); 4] = [(16, 0.1), (64, 0.05), (256, 0.03), (1024, 0.01)];
/// Most points of which all are receivers of the point truth; else so many, and so many pairs with all surfels at
/// most beyond `FEWEST` receivers.
const ALL: usize = 10_000;
const RECEIVERS: usize = 300;
const FEWEST: usize = 60;
const PAIRS: usize = 30_000_000;
/// Points, at most, of scenes whose orders are compared, and whose stages are.
const ORDER_POINTS: usize = 10_000;
const STAGE_POINTS: usize = 50_000;
/// Orders of the expansions in the comparison of stages.
const STAGE_ORDERS: [usize; 3] = [1, 2, 4];
/// The file of finished runs.
const RUNS: &str = "runs.jsonl";

/// Files that a chart writes into its folder.
pub const FILES: [&str; 13] = [
    RUNS,
    "chart.json",
    "solves.csv",
    "orders.csv",
    "stages.csv",
    "error_time.svg",
    "error_time.png",
    "growth.svg",
    "growth.png",
    "order.svg",
    "order.png",
    "stages.svg",
    "stages.png",
];

/// What is charted.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Scene files.
    pub scenes: Vec<PathBuf>,
    /// Numbers of points.
    pub points: Vec<usize>,
    /// Tolerances of links.
    pub tolerances: Vec<f64>,
    /// Orders of fmm beside its own, and those of classic.
    pub orders: Vec<usize>,
    /// Largest order where nothing is in the way.
    pub open_order: usize,
    /// Seconds that a run may be expected to take; what would take longer is left out.
    pub limit: f64,
}

/// All that was measured for a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Charted {
    pub machine: Machine,
    pub solves: Vec<Solve>,
    pub orders: Vec<OrderRow>,
    pub stages: Vec<StageRow>,
    /// What was not run, and why.
    pub left_out: Vec<String>,
}

/// Runs one case, in a process of its own, and returns the irradiance of the points. Fails with
/// [`Error::TooLarge`] for a case that is to be left out.
pub type Solver<'a> = &'a dyn Fn(&Case) -> Result<(Measured, Vec<Vec3>)>;

impl Plan {
    /// A chart of some minutes.
    pub fn brief(scenes: Vec<PathBuf>) -> Plan {
        Plan {
            scenes,
            points: vec![2_000, 10_000, 50_000],
            tolerances: vec![0.1, 0.03, 0.01],
            orders: vec![2],
            open_order: 6,
            limit: 4.0,
        }
    }

    /// A chart of some hours.
    pub fn full(scenes: Vec<PathBuf>) -> Plan {
        Plan {
            points: vec![2_000, 10_000, 20_000, 50_000, 200_000, 600_000, 2_000_000],
            tolerances: vec![0.1, 0.05, 0.03, 0.02, 0.01, 0.005],
            orders: vec![2, 3, 4],
            open_order: 10,
            limit: 1000.0,
            ..Plan::brief(scenes)
        }
    }

    /// All that is to be solved: scene by scene, from few points to many.
    pub fn cases(&self, gpu: bool) -> Vec<Case> {
        let mut cases = Vec::new();
        for (scene, &points) in self.sizes() {
            let case = |method, tolerance| Case {
                scene: scene.to_owned(),
                points,
                method,
                gpu: false,
                tolerance,
                order: None,
                rays: None,
            };
            let mut both = |case: Case| {
                if gpu {
                    cases.push(Case {
                        gpu,
                        ..case.clone()
                    });
                }
                cases.push(case);
            };
            for &tolerance in &self.tolerances {
                both(case(Method::Fmm, tolerance));
            }
            for &order in &self.orders {
                let order = Some(order);
                let classic = case(Method::Classic, CLASSIC_TOLERANCE);
                both(Case { order, ..classic });
            }
            for (rays, tolerance) in RAYS {
                let rays = Some(rays);
                let gather = case(Method::Gather, tolerance);
                both(Case { rays, ..gather });
            }
            cases.push(case(Method::Direct, DIRECT_TOLERANCE));
            for &tolerance in &self.tolerances {
                cases.push(case(Method::Auto, tolerance));
                for &order in &self.orders {
                    let order = Some(order);
                    let fmm = case(Method::Fmm, tolerance);
                    cases.push(Case { order, ..fmm });
                }
            }
        }
        cases
    }

    fn sizes(&self) -> impl Iterator<Item = (&Path, &usize)> {
        let sizes = |scene| self.points.iter().map(move |points| (scene, points));
        self.scenes.iter().map(PathBuf::as_path).flat_map(sizes)
    }

    /// The largest size up to a limit, or the smallest there is.
    fn up_to(&self, limit: usize) -> usize {
        let fitting = self.points.iter().filter(|&&n| n <= limit).max();
        *fitting.or(self.points.iter().min()).expect("some size")
    }

    /// Does all that is not in the folder yet, and tells what was found. What is finished stays in the
    /// folder when this fails or is interrupted.
    pub fn run(
        &self,
        folder: &Path,
        machine: &Machine,
        gpu: Option<&OpenDevice>,
        solver: Solver,
        progress: &dyn Progress,
    ) -> Result<Charted> {
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, "cannot be made", e))?;
        let records = Records::open(&folder.join(RUNS), machine)?;
        let mut run = Run {
            plan: self,
            records,
            progress,
            charted: Charted {
                machine: machine.clone(),
                solves: Vec::new(),
                orders: Vec::new(),
                stages: Vec::new(),
                left_out: Vec::new(),
            },
        };
        run.solves(gpu.is_some(), solver)?;
        run.orders()?;
        if let Some(gpu) = gpu {
            run.stages(&Gpu::new(&gpu.device, &gpu.queue))?;
        }
        Ok(run.charted)
    }
}

struct Run<'a> {
    plan: &'a Plan,
    records: Records,
    progress: &'a dyn Progress,
    charted: Charted,
}

/// The truths of one scene with one number of points.
struct Truths {
    scene: PathBuf,
    points: usize,
    point: PointTruth,
    surface: Option<SurfaceTruth>,
}

impl Run<'_> {
    fn solves(&mut self, gpu: bool, solver: Solver) -> Result<()> {
        let cases = self.plan.cases(gpu);
        self.progress.stage("solves", cases.len() as u64);
        let mut truths: Option<Truths> = None;
        for (k, case) in cases.iter().enumerate() {
            self.progress.check()?;
            let known = self.records.finished.iter().find_map(|f| match f {
                Finished::Solve(solve) if solve.case == *case => Some(solve.clone()),
                _ => None,
            });
            let solve = match known {
                Some(solve) => Some(solve),
                None => match self.too_long(case) {
                    Some(why) => {
                        self.leave_out(case, &why);
                        None
                    }
                    None => self.solve(case, (k + 1, cases.len()), solver, &mut truths)?,
                },
            };
            self.charted.solves.extend(solve);
            self.progress.advance(1);
        }
        Ok(())
    }

    fn leave_out(&mut self, case: &Case, why: &str) {
        let left_out = format!("{}: {why}", case.describe());
        self.charted.left_out.push(left_out);
    }

    /// Why a case is left out, by what it took with fewer points: exact sums and states of pairs grow as
    /// the square of their number, all else is taken to grow as the number.
    fn too_long(&self, case: &Case) -> Option<String> {
        let points = self.plan.points.iter().filter(|&&n| n < case.points);
        let before = Case {
            points: *points.max()?,
            ..case.clone()
        };
        let solves = &self.charted.solves;
        let Some(solve) = solves.iter().find(|solve| solve.case == before) else {
            return Some(format!("left out with {} points already", before.points));
        };
        let power = match case.method {
            Method::Direct | Method::Classic => 2,
            _ => 1,
        };
        let ratio = case.points as f64 / before.points as f64;
        let expected = solve.measured.seconds * ratio.powi(power);
        (expected > self.plan.limit).then(|| format!("would take about {expected:.0} s"))
    }

    fn solve(
        &mut self,
        case: &Case,
        (number, count): (usize, usize),
        solver: Solver,
        truths: &mut Option<Truths>,
    ) -> Result<Option<Solve>> {
        let fits = |t: &Truths| t.scene == case.scene && t.points == case.points;
        if !truths.as_ref().is_some_and(fits) {
            // The old ones make room first.
            *truths = None;
            *truths = Some(Truths::find(case, self.progress)?);
        }
        let truths = truths.as_ref().expect("just found");
        let (measured, irradiance) = match solver(case) {
            Ok(solved) => solved,
            Err(Error::TooLarge(why)) => {
                self.leave_out(case, &why);
                return Ok(None);
            }
            Err(error) => return Err(error),
        };
        let about = |e: Error| e.about(&case.scene);
        let surface = truths.surface.as_ref().map(|t| t.errors(&irradiance));
        let solve = Solve {
            case: case.clone(),
            measured,
            point: truths.point.errors(&irradiance).map_err(about)?,
            surface: surface.transpose().map_err(about)?,
        };
        self.progress.note(&format!(
            "{number}/{count} {}: {:.3} s, error {:.2}%",
            case.describe(),
            solve.measured.seconds,
            100.0 * solve.point.rel_l2
        ));
        self.records.add(Finished::Solve(solve.clone()))?;
        Ok(Some(solve))
    }

    /// Both bases at all orders, as long as one takes no longer than the limit.
    fn orders(&mut self) -> Result<()> {
        let plan = self.plan;
        let size = plan.up_to(ORDER_POINTS);
        let count = plan.scenes.len() * (plan.open_order + 1);
        self.progress.stage("orders", count as u64);
        for path in &plan.scenes {
            let mut open = None;
            for of in 0..=plan.open_order {
                self.progress.check()?;
                let known = self.records.finished.iter().find_map(|f| match f {
                    Finished::Orders {
                        scene,
                        points,
                        order,
                        rows,
                    } if (scene, *points, *order) == (path, size, of) => Some(rows.clone()),
                    _ => None,
                });
                let rows = match known {
                    Some(rows) => rows,
                    None => {
                        if open.is_none() {
                            let scene = load(path, size)?;
                            open = Some(Open::new(&name_of(path), &scene, &Silent)?);
                        }
                        let rows = open.as_ref().expect("just made").at(of)?;
                        self.progress
                            .note(&format!("{}: order {of}", name_of(path)));
                        self.records.add(Finished::Orders {
                            scene: path.clone(),
                            points: size,
                            order: of,
                            rows: rows.clone(),
                        })?;
                        rows
                    }
                };
                let longest = rows.iter().map(|r| r.seconds).fold(0.0, f64::max);
                self.charted.orders.extend(rows);
                self.progress.advance(1);
                if longest > plan.limit {
                    break;
                }
            }
        }
        Ok(())
    }

    fn stages(&mut self, gpu: &Gpu) -> Result<()> {
        let plan = self.plan;
        let size = plan.up_to(STAGE_POINTS);
        self.progress.stage("stages", plan.scenes.len() as u64);
        for path in &plan.scenes {
            self.progress.check()?;
            let known = self.records.finished.iter().find_map(|f| match f {
                Finished::Stages {
                    scene,
                    points,
                    rows,
                } if (scene, *points) == (path, size) => Some(rows.clone()),
                _ => None,
            });
            let rows = match known {
                Some(rows) => rows,
                None => {
                    let scene = load(path, size)?;
                    let rows = stages::measure(&name_of(path), &scene, gpu, &STAGE_ORDERS)?;
                    self.progress.note(&format!("{}: stages", name_of(path)));
                    self.records.add(Finished::Stages {
                        scene: path.clone(),
                        points: size,
                        rows: rows.clone(),
                    })?;
                    rows
                }
            };
            self.charted.stages.extend(rows);
            self.progress.advance(1);
        }
        Ok(())
    }
}

impl Truths {
    fn find(case: &Case, progress: &dyn Progress) -> Result<Truths> {
        let scene = load(&case.scene, case.points)?;
        let n = scene.cloud.len();
        let receivers = match n <= ALL {
            true => n,
            false => (PAIRS / n).clamp(FEWEST, RECEIVERS),
        };
        Ok(Truths {
            scene: case.scene.clone(),
            points: case.points,
            point: PointTruth::find(&scene, receivers, &Quiet(progress))
                .map_err(|e| e.about(&case.scene))?,
            surface: SurfaceTruth::of(&case.scene, &scene)?,
        })
    }
}

/// Can be stopped, but tells nothing.
struct Quiet<'a>(&'a dyn Progress);

impl Progress for Quiet<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
