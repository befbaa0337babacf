//! The pictures: what is drawn in which panel.

mod canvas;
mod panel;
mod picture;

use self::panel::{Axis, Curve, Drawn, Look, Mark, Panel, Unit};
use self::picture::Picture;
use super::measure::Solve;
use super::plan::Charted;
use crate::Method;

// Colours that colour-blind people tell apart (Okabe and Ito).
const BLACK: [u8; 3] = [0, 0, 0];
const BLUE: [u8; 3] = [0, 114, 178];
const SKY: [u8; 3] = [86, 180, 233];
const GREEN: [u8; 3] = [0, 158, 115];
const ORANGE: [u8; 3] = [230, 159, 0];
const VERMILLION: [u8; 3] = [213, 94, 0];
const PURPLE: [u8; 3] = [204, 121, 167];
const GREY: [u8; 3] = [190, 190, 190];

/// The Pareto front, behind all else.
const FRONT: Look = Look {
    colour: GREY,
    dashed: false,
    width: 8.0,
    mark: Mark::End,
};

/// All pictures of a chart for which something was measured.
pub fn pictures(charted: &Charted) -> Vec<Picture> {
    let pictures = [
        error_time(charted),
        growth(charted),
        order(charted),
        stages(charted),
    ];
    pictures.into_iter().flatten().collect()
}

/// Colour by method, line and mark by backend.
fn look(method: Method, order: Option<usize>, gpu: bool) -> Look {
    let colour = match (method, order) {
        (Method::Direct, _) => BLACK,
        (Method::Fmm, None) => BLUE,
        (Method::Fmm, Some(2)) => SKY,
        (Method::Fmm, Some(_)) => PURPLE,
        (Method::Classic, _) => ORANGE,
        (Method::Gather, _) => VERMILLION,
        (Method::Auto, _) => GREEN,
    };
    let mark = match (method, gpu) {
        (Method::Auto, _) => Mark::Ring,
        (_, true) => Mark::Square,
        (_, false) => Mark::Dot,
    };
    Look {
        colour,
        dashed: gpu,
        width: 1.8,
        mark,
    }
}

/// Curves in the order in which they come up, each with its solves by falling tolerance.
fn curves<'a>(solves: impl Iterator<Item = &'a Solve>) -> Vec<(String, Look, Vec<&'a Solve>)> {
    let mut curves: Vec<(String, Look, Vec<&Solve>)> = Vec::new();
    for solve in solves {
        let name = solve.case.curve();
        // The list of classic is over orders.
        let order = solve
            .case
            .order
            .filter(|_| solve.case.method == Method::Fmm);
        match curves.iter_mut().find(|c| c.0 == name) {
            Some(curve) => curve.2.push(solve),
            None => {
                let look = look(solve.case.method, order, solve.case.gpu);
                curves.push((name, look, vec![solve]));
            }
        }
    }
    curves
}

fn error_time(charted: &Charted) -> Option<Picture> {
    let panels = charted.panels();
    let mut scenes: Vec<&str> = panels.iter().map(|p| p.0.as_str()).collect();
    scenes.dedup();
    let mut sizes: Vec<usize> = panels.iter().map(|p| p.1).collect();
    sizes.sort_unstable();
    sizes.dedup();
    let mut drawn = Vec::new();
    for &points in &sizes {
        for &scene in &scenes {
            let of = panels
                .iter()
                .find(|p| (p.0.as_str(), p.1) == (scene, points));
            let solves = of.map_or(&[][..], |p| &p.2);
            let at = |s: &Solve| (s.measured.seconds, s.point.rel_l2);
            let mut all = vec![Curve {
                look: FRONT,
                points: steps(
                    charted
                        .front(solves)
                        .iter()
                        .map(|&k| at(&charted.solves[k])),
                ),
                label: None,
            }];
            let listed = solves.iter().map(|&k| &charted.solves[k]);
            all.extend(curves(listed).into_iter().map(|(_, look, solves)| Curve {
                look,
                points: solves.into_iter().map(at).collect(),
                label: None,
            }));
            drawn.push(Panel {
                title: format!("{scene}, {} points", thousands(points)),
                x: Axis::log("time of a solve", Unit::Seconds),
                y: Axis::log("relative L2 error", Unit::Percent),
                drawn: Drawn::Curves(all),
            });
        }
    }
    let mut legend: Vec<(String, Look)> = curves(charted.solves.iter())
        .into_iter()
        .map(|(name, look, _)| (name, look))
        .collect();
    legend.push(("nothing beats (Pareto front)".into(), FRONT));
    (!drawn.is_empty()).then(|| Picture {
        name: "error_time",
        title: "Error against time".into(),
        about: "Relative L2 error of the irradiance against exact sums over the same points; time on the \
                wall from points to verified light, median of up to 3 runs."
            .into(),
        machine: charted.machine.caption(),
        columns: scenes.len(),
        panel: (430, 300),
        panels: drawn,
        legend,
    })
}

/// The corners of a staircase through points that fall.
fn steps(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut corners: Vec<(f64, f64)> = Vec::new();
    for point in points {
        if let Some(&(_, above)) = corners.last() {
            corners.push((point.0, above));
        }
        corners.push(point);
    }
    corners
}

fn growth(charted: &Charted) -> Option<Picture> {
    let all = charted.growth();
    let all: Vec<_> = all.iter().filter(|g| g.points.len() > 1).collect();
    let mut scenes: Vec<&str> = all.iter().map(|g| g.scene.as_str()).collect();
    scenes.dedup();
    let mut panels = Vec::new();
    for memory in [false, true] {
        for &scene in &scenes {
            let of_scene = all.iter().filter(|g| g.scene == scene);
            let curves = of_scene.filter(|g| !g.curve.contains("order")).map(|g| {
                let exponent = [g.time_exponent, g.memory_exponent][usize::from(memory)];
                let at = |p: &(usize, f64, f64, Option<u64>)| match memory {
                    false => Some((p.0 as f64, p.1)),
                    true => Some((p.0 as f64, p.3.filter(|&b| b > 0)? as f64)),
                };
                Curve {
                    look: look(g.method, None, g.gpu),
                    points: g.points.iter().filter_map(at).collect(),
                    label: exponent.map(|e| format!("{} N^{e:.2}", g.curve)),
                }
            });
            panels.push(Panel {
                title: format!("{scene}: {}", if memory { "memory" } else { "time" }),
                x: Axis::log("points", Unit::Count),
                y: match memory {
                    false => Axis::log("time of a solve", Unit::Seconds),
                    true => Axis::log("memory of a solve", Unit::Bytes),
                },
                drawn: Drawn::Curves(curves.collect()),
            });
        }
    }
    (!panels.is_empty()).then(|| Picture {
        name: "growth",
        title: "Time and memory against the number of points N".into(),
        about: "fmm at the tolerance nearest to 0.03, gather with its rays. Time on the wall; most memory \
                of the process less that before it read the scene; exponents by least squares."
            .into(),
        machine: charted.machine.caption(),
        columns: scenes.len(),
        panel: (470, 330),
        panels,
        legend: Vec::new(),
    })
}

fn order(charted: &Charted) -> Option<Picture> {
    let mut scenes: Vec<(&str, usize)> = Vec::new();
    for row in &charted.orders {
        scenes.push((&row.scene, row.surfels));
    }
    scenes.dedup();
    let look = |basis: &str, lists: &str| Look {
        colour: match basis {
            "tensors, f64" => BLUE,
            "tensors, f32" => SKY,
            _ => VERMILLION,
        },
        dashed: lists != "dual traversal",
        width: if basis == "tensors, f64" { 3.5 } else { 1.8 },
        mark: match lists {
            "dual traversal" => Mark::Dot,
            _ => Mark::Square,
        },
    };
    let mut legend: Vec<(String, Look)> = Vec::new();
    for row in &charted.orders {
        let name = format!("{}, {}", row.basis, row.lists);
        if legend.iter().all(|(other, _)| *other != name) {
            legend.push((name, look(&row.basis, &row.lists)));
        }
    }
    let mut panels = Vec::new();
    for time in [false, true] {
        for &(scene, surfels) in &scenes {
            let curves = legend.iter().map(|(name, look)| {
                let rows = charted
                    .orders
                    .iter()
                    .filter(|r| r.scene == scene && *name == format!("{}, {}", r.basis, r.lists));
                let at =
                    |r: &super::OrderRow| (r.order as f64, if time { r.seconds } else { r.error });
                Curve {
                    look: *look,
                    points: rows.map(at).collect(),
                    label: None,
                }
            });
            panels.push(Panel {
                title: format!("{scene}, {} points", thousands(surfels)),
                x: Axis::linear("order of the expansions", Unit::Count),
                y: match time {
                    false => Axis::log("relative L2 error", Unit::Percent),
                    true => Axis::log("time of one application", Unit::Seconds),
                },
                drawn: Drawn::Curves(curves.collect()),
            });
        }
    }
    (!panels.is_empty()).then(|| Picture {
        name: "order",
        title: "Error and time against the order, nothing in the way".into(),
        about: "One application of the operator on the CPU, Cartesian tensors and the spherical basis of \
                the report, by the same links; relative L2 error against exact sums."
            .into(),
        machine: charted.machine.caption(),
        columns: scenes.len(),
        panel: (430, 300),
        panels,
        legend,
    })
}

fn stages(charted: &Charted) -> Option<Picture> {
    let mut scenes: Vec<(&str, usize)> = Vec::new();
    for row in &charted.stages {
        scenes.push((&row.scene, row.surfels));
    }
    scenes.dedup();
    let [cpu, gpu] = [(BLUE, Mark::Dot), (VERMILLION, Mark::Square)].map(|(colour, mark)| Look {
        colour,
        dashed: false,
        width: 1.8,
        mark,
    });
    let panels = scenes.iter().map(|&(scene, surfels)| {
        let rows = charted.stages.iter().filter(|r| r.scene == scene);
        let mut rows: Vec<_> = rows.collect();
        // A stage at all its orders, in the order of the stages.
        let mut names: Vec<&str> = Vec::new();
        for row in &rows {
            if !names.contains(&row.stage.as_str()) {
                names.push(&row.stage);
            }
        }
        rows.sort_by_key(|r| (names.iter().position(|n| *n == r.stage), r.order));
        let rows = rows.into_iter().map(|r| {
            let order = r.order.map_or(String::new(), |p| format!(", order {p}"));
            (
                format!("{}{order}", r.stage),
                [(r.cpu_seconds, cpu), (r.gpu_seconds, gpu)],
                format!("{:.1}", r.gpu_seconds / r.cpu_seconds),
            )
        });
        Panel {
            title: format!("{scene}, {} points", thousands(surfels)),
            x: Axis::log("time of a stage; behind it gpu / cpu", Unit::Seconds),
            y: Axis::linear("", Unit::Count),
            drawn: Drawn::Rows(rows.collect()),
        }
    });
    let panels: Vec<Panel> = panels.collect();
    let adapter = charted.machine.adapter.as_deref().unwrap_or_default();
    (!panels.is_empty()).then(|| Picture {
        name: "stages",
        title: "The stages on the adapter against the CPU".into(),
        about: "Medians of up to 7 runs; f32 on all threads of the CPU, and WGSL from the first dispatch \
                to the last."
            .into(),
        machine: charted.machine.caption(),
        columns: panels.len(),
        panel: (460, 640),
        panels,
        legend: vec![("cpu".into(), cpu), (format!("gpu: {adapter}"), gpu)],
    })
}

/// 50,000 for 50000.
fn thousands(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}
