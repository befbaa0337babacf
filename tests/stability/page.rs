//! The page of findings.

use std::fmt::Write as _;

use crate::harness::{Case, Errors, Found, Outcome, TOLERANCE, WAYS, Way};

const HEAD: &str = "# Where methods break

Written by `cargo test --release --test stability -- --ignored --nocapture`, which lights each case by
every method and prints a line a case and method, with 99th percentile, bias and processor seconds. The same run
asserts what is expected of each case.

A number is the relative L2 error of the irradiance at a tolerance of 3%, against exact sums over the same
points in f64, or where a table says so against what is known: closed forms, the light of the undisturbed
cloud. Of what should be dark it is the most light. In brackets: the 95% bound that the solve itself puts on
its error against exact sums (`error` in the stats). *Not solved* is said by `converged` and exit code 4;
*not met* by `error.met` and the same. *Refused* is an error message. **Bold** is a known issue: off, and
called solved.

Covered by other tests: thin walls, doors and noise of normals by `walls`; blocks on a floor and the edges
of rooms by `contact`; curved walls by `curved`; order of the points, place and unit by `invariance`; noise
against path tracing by `noise`; singular equations by `solve`; lights close to surfaces by `lights`; orders 0
to 6 on smooth sheets by `smooth`; facets of all shapes by `octree`; single points and one place on a device
by `gpu_operator`.
";

/// What a table is about.
pub struct Section {
    pub title: &'static str,
    pub text: &'static str,
    pub cases: fn() -> Vec<Case>,
}

pub fn head() -> String {
    let mut page = String::from(HEAD);
    let _ = writeln!(page, "\nAll at a tolerance of {}%.", 100.0 * TOLERANCE);
    page
}

pub fn table(section: &Section, rows: &[(Case, Vec<Outcome>)]) -> String {
    let mut table = format!("\n## {}\n\n{}\n\n| case |", section.title, section.text);
    for way in WAYS {
        let _ = write!(table, " {way} |");
    }
    table.push_str("\n|---|");
    table.push_str(&"---|".repeat(WAYS.len()));
    for (case, outcomes) in rows {
        let _ = write!(table, "\n| {} |", case.name);
        for outcome in outcomes {
            let _ = write!(table, " {} |", cell(case, outcome));
        }
    }
    table.push('\n');
    let mut remedies: Vec<&str> = rows.iter().map(|(case, _)| case.remedy).collect();
    remedies.dedup();
    for remedy in remedies.into_iter().filter(|r| !r.is_empty()) {
        let _ = writeln!(table, "\n{remedy}");
    }
    table
}

fn percent(x: f64) -> String {
    match 100.0 * x {
        0.0 => "0".into(),
        p if !(0.01..1000.0).contains(&p) => format!("{p:.0e}%"),
        p if p < 10.0 => format!("{p:.2}%"),
        p => format!("{p:.0}%"),
    }
}

fn cell(case: &Case, outcome: &Outcome) -> String {
    let Ok(found) = &outcome.found else {
        return "refused".into();
    };
    let Found {
        errors: Errors { l2, .. },
        bound,
        solved,
        met,
        ..
    } = *found;
    let mut text = percent(l2);
    if case.is_known_issue(outcome.way) {
        text = format!("**{text}**");
    }
    if let (Some(bound), true) = (bound, outcome.way != Way::Device) {
        text = format!("{text} ({})", percent(bound));
    }
    match (solved, met) {
        (false, _) => text + ", not solved",
        (true, false) => text + ", not met",
        (true, true) => text,
    }
}
