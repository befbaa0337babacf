//! The chart as tables, as JSON, and what follows from it.

use std::path::Path;

use serde::Serialize;

use super::draw;
use super::fit::{exponent, pareto};
use super::measure::{Case, Solve, word};
use super::plan::Charted;
use crate::Method;
use crate::error::{Error, Result};
use crate::output::write_atomic;

/// Tolerance at which growth is looked at, or the nearest that there is.
const GROWTH_TOLERANCE: f64 = 0.03;

/// A size: surfels, seconds on the wall and of all threads, bytes.
pub type Size = (usize, f64, f64, Option<u64>);

/// How one way grows with the number of points.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Growth {
    pub scene: String,
    /// For example "fmm, cpu".
    pub curve: String,
    pub method: Method,
    pub gpu: bool,
    pub setting: String,
    /// Of seconds on the wall, and of memory, to the number of points.
    pub time_exponent: Option<f64>,
    pub memory_exponent: Option<f64>,
    /// Surfels, seconds, CPU seconds, bytes.
    pub points: Vec<Size>,
}

/// What is left to open choice, against the best setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Choice {
    pub case: Case,
    pub seconds: f64,
    pub error: f64,
    /// The fastest of all that was no less accurate, and how many times its seconds auto took.
    pub best: String,
    pub best_seconds: f64,
    pub ratio: f64,
}

impl Charted {
    /// Writes tables, JSON and pictures into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let text = |name: &str, text: String| {
            write_atomic(&folder.join(name), |file| file.write_all(text.as_bytes()))
        };
        text("solves.csv", self.solves_csv())?;
        text("orders.csv", self.orders_csv())?;
        text("stages.csv", self.stages_csv())?;
        text("chart.json", self.json()?)?;
        for picture in draw::pictures(self) {
            text(&format!("{}.svg", picture.name), picture.svg()?)?;
            let png = picture.png()?;
            write_atomic(&folder.join(format!("{}.png", picture.name)), |file| {
                file.write_all(&png)
            })?;
        }
        Ok(())
    }

    /// Solves of one scene with one number of points; their places in the list.
    pub fn panels(&self) -> Vec<(String, usize, Vec<usize>)> {
        let mut panels: Vec<(String, usize, Vec<usize>)> = Vec::new();
        for (k, solve) in self.solves.iter().enumerate() {
            let key = (solve.case.name(), solve.case.points);
            match panels.iter_mut().find(|p| (&p.0, p.1) == (&key.0, key.1)) {
                Some(panel) => panel.2.push(k),
                None => panels.push((key.0, key.1, vec![k])),
            }
        }
        panels
    }

    /// Which of some solves nothing beats in time and error.
    pub fn front(&self, solves: &[usize]) -> Vec<usize> {
        let at = |&k: &usize| (self.solves[k].measured.seconds, self.solves[k].point.rel_l2);
        let points: Vec<(f64, f64)> = solves.iter().map(at).collect();
        pareto(&points).into_iter().map(|k| solves[k]).collect()
    }

    /// How all ways but auto grow, each at the tolerance that is nearest to the default.
    pub fn growth(&self) -> Vec<Growth> {
        let mut all: Vec<Growth> = Vec::new();
        let solves = || self.solves.iter().filter(|s| s.case.method != Method::Auto);
        let distance = |case: &Case| (case.tolerance / GROWTH_TOLERANCE).ln().abs();
        for solve in solves() {
            let (scene, curve) = (solve.case.name(), solve.case.curve());
            if all.iter().any(|g| (&g.scene, &g.curve) == (&scene, &curve)) {
                continue;
            }
            let of_curve: Vec<&Solve> = solves()
                .filter(|s| s.case.scene == solve.case.scene && s.case.curve() == curve)
                .collect();
            let nearest = of_curve
                .iter()
                .min_by(|a, b| distance(&a.case).total_cmp(&distance(&b.case)))
                .expect("there is one");
            let setting = |case: &Case| (case.tolerance, case.order, case.rays);
            let points: Vec<Size> = of_curve
                .iter()
                .filter(|s| setting(&s.case) == setting(&nearest.case))
                .map(|s| &s.measured)
                .map(|m| (m.surfels, m.seconds, m.cpu_seconds, m.memory_bytes))
                .collect();
            let fit = |of: &dyn Fn(&Size) -> f64| {
                exponent(
                    &points
                        .iter()
                        .map(|p| (p.0 as f64, of(p)))
                        .collect::<Vec<_>>(),
                )
            };
            all.push(Growth {
                scene,
                curve,
                method: nearest.case.method,
                gpu: nearest.case.gpu,
                setting: nearest
                    .case
                    .describe()
                    .rsplit(", ")
                    .next()
                    .unwrap_or("")
                    .into(),
                time_exponent: fit(&|p| p.1),
                memory_exponent: fit(&|p| p.3.unwrap_or(0) as f64),
                points,
            });
        }
        all
    }

    /// Every run of auto against the best of all others on any backend.
    pub fn choices(&self) -> Vec<Choice> {
        let autos = self.solves.iter().filter(|s| s.case.method == Method::Auto);
        let choice = |auto: &Solve| {
            let fits = |s: &&Solve| {
                (&s.case.scene, s.case.points) == (&auto.case.scene, auto.case.points)
                    && s.case.method != Method::Auto
                    && s.point.rel_l2 <= auto.point.rel_l2
            };
            let seconds = |s: &&Solve| s.measured.seconds;
            let others = self.solves.iter().filter(fits);
            let best = others.min_by(|a, b| seconds(a).total_cmp(&seconds(b)))?;
            Some(Choice {
                case: auto.case.clone(),
                seconds: auto.measured.seconds,
                error: auto.point.rel_l2,
                best: best.case.describe(),
                best_seconds: best.measured.seconds,
                ratio: auto.measured.seconds / best.measured.seconds,
            })
        };
        autos.filter_map(choice).collect()
    }

    fn json(&self) -> Result<String> {
        let value = serde_json::json!({
            "machine": self.machine,
            "solves": self.solves,
            "orders": self.orders,
            "stages": self.stages,
            "growth": self.growth(),
            "auto": self.choices(),
            "left_out": self.left_out,
        });
        serde_json::to_string_pretty(&value)
            .map(|text| text + "\n")
            .map_err(|e| Error::Invalid(format!("the chart cannot be written as JSON: {e}")))
    }

    fn solves_csv(&self) -> String {
        let mut text = String::from(
            "scene,points,surfels,method,backend,tolerance,order,rays,method_taken,order_taken,runs,\
             seconds,cpu_seconds,memory_bytes,iterations,segments,kept,receivers,rel_l2,p99,bias,\
             surface_receivers,surface_rel_l2,surface_p99,surface_bias,pareto\n",
        );
        let panels = self.panels();
        let fronts: Vec<usize> = panels.iter().flat_map(|p| self.front(&p.2)).collect();
        for (
            k,
            Solve {
                case,
                measured: m,
                point,
                surface,
            },
        ) in self.solves.iter().enumerate()
        {
            let surface = |of: fn(&super::truth::Errors) -> String| surface.as_ref().map(of);
            row(
                &mut text,
                [
                    quoted(&case.name()),
                    case.points.to_string(),
                    m.surfels.to_string(),
                    word(case.method).into(),
                    if case.gpu { "gpu" } else { "cpu" }.into(),
                    case.tolerance.to_string(),
                    cell(case.order),
                    cell(case.rays),
                    word(m.method).into(),
                    cell(m.order),
                    m.runs.to_string(),
                    m.seconds.to_string(),
                    m.cpu_seconds.to_string(),
                    cell(m.memory_bytes),
                    m.iterations.to_string(),
                    m.segments.to_string(),
                    m.kept.to_string(),
                    point.receivers.to_string(),
                    point.rel_l2.to_string(),
                    point.p99.to_string(),
                    point.bias.to_string(),
                    cell(surface(|e| e.receivers.to_string())),
                    cell(surface(|e| e.rel_l2.to_string())),
                    cell(surface(|e| e.p99.to_string())),
                    cell(surface(|e| e.bias.to_string())),
                    fronts.contains(&k).to_string(),
                ],
            );
        }
        text
    }

    fn orders_csv(&self) -> String {
        let mut text = String::from("scene,surfels,basis,lists,order,error,seconds\n");
        for r in &self.orders {
            row(
                &mut text,
                [
                    quoted(&r.scene),
                    r.surfels.to_string(),
                    quoted(&r.basis),
                    quoted(&r.lists),
                    r.order.to_string(),
                    r.error.to_string(),
                    r.seconds.to_string(),
                ],
            );
        }
        text
    }

    fn stages_csv(&self) -> String {
        let mut text = String::from("scene,surfels,stage,order,elements,cpu_seconds,gpu_seconds\n");
        for r in &self.stages {
            row(
                &mut text,
                [
                    quoted(&r.scene),
                    r.surfels.to_string(),
                    quoted(&r.stage),
                    cell(r.order),
                    r.elements.to_string(),
                    r.cpu_seconds.to_string(),
                    r.gpu_seconds.to_string(),
                ],
            );
        }
        text
    }
}

fn row<const N: usize>(text: &mut String, cells: [String; N]) {
    text.push_str(&cells.join(","));
    text.push('\n');
}

fn cell(value: Option<impl ToString>) -> String {
    value.map_or(String::new(), |v| v.to_string())
}

/// With quotes where it needs them.
fn quoted(text: &str) -> String {
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    }
}
