//! The chart from outside: what it writes, and how it goes on.

mod program;

use std::collections::HashMap;
use std::fs;
use std::path::Path;

use fmmgi_gpu::chart::{FILES, Plan};
use program::{fails, run};
use tempfile::TempDir;

const ARGS: &str =
    "chart furnace.toml --points 300,600 --tolerances 0.1 --limit 1000 --quiet -o out";

/// A folder with the furnace, of which the light of the surface is known.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/furnace.toml");
    fs::copy(scene, folder.path().join("furnace.toml")).unwrap();
    folder
}

fn plan() -> Plan {
    Plan {
        points: vec![300, 600],
        tolerances: vec![0.1],
        ..Plan::brief(vec!["furnace.toml".into()])
    }
}

/// Rows of a table, by the names of its columns.
fn table(path: &Path) -> Vec<HashMap<String, String>> {
    let text = fs::read_to_string(path).unwrap();
    let mut lines = text.lines().map(cells);
    let names = lines.next().unwrap();
    let row = |row: Vec<String>| {
        assert_eq!(row.len(), names.len(), "{}", path.display());
        names.iter().cloned().zip(row).collect()
    };
    lines.map(row).collect()
}

/// Cells of a line; commas in quotes are none.
fn cells(line: &str) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => cells.push(String::new()),
            c => cells.last_mut().unwrap().push(c),
        }
    }
    cells
}

fn number(row: &HashMap<String, String>, name: &str) -> f64 {
    row[name].parse().unwrap()
}

// One chart serves all: it takes some thirty processes.
#[test]
fn a_chart_from_end_to_end_and_on() {
    let folder = folder();
    run(folder.path(), ARGS).success();
    let out = folder.path().join("out");
    for name in FILES {
        assert!(fs::metadata(out.join(name)).unwrap().len() > 0, "{name}");
    }

    let solves = table(&out.join("solves.csv"));
    let cases = plan().cases(true);
    assert_eq!(solves.len(), cases.len());
    for (row, case) in solves.iter().zip(&cases) {
        let what = case.describe();
        assert_eq!(number(row, "points"), case.points as f64);
        assert!(
            number(row, "seconds") > 0.0 && number(row, "cpu_seconds") > 0.0,
            "{what}"
        );
        assert!(number(row, "memory_bytes") > 0.0, "{what}");
        // Measured: at most 0.0065 and 0.016, all of 300 points.
        assert!(number(row, "rel_l2") < 0.02, "{what}: {row:?}");
        assert!(number(row, "surface_rel_l2") < 0.04, "{what}: {row:?}");
        if row["method"] == "direct" {
            // It solves what the truth is made of.
            assert!(number(row, "rel_l2") < 1e-4, "{what}: {row:?}");
        }
    }
    // Something is fastest.
    assert!(solves.iter().any(|row| row["pareto"] == "true"));
    assert!(solves.iter().any(|row| row["pareto"] == "false"));

    // Two bases and one in two precisions, by two kinds of lists, at orders 0 to 6.
    let orders = table(&out.join("orders.csv"));
    assert_eq!(orders.len(), 3 * 2 * 7);
    for row in &orders {
        // Measured: at most 1.6e-3, and 9e-7 at order 6 in f32.
        let most = if row["order"] == "6" { 1e-5 } else { 0.01 };
        assert!(number(row, "error") < most, "{row:?}");
    }

    // Eight stages of expansions at three orders, and three without.
    let stages = table(&out.join("stages.csv"));
    assert_eq!(stages.len(), 8 * 3 + 3);
    assert!(stages.iter().all(|row| number(row, "gpu_seconds") > 0.0));

    let json: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(out.join("chart.json")).unwrap()).unwrap();
    assert_eq!(json["solves"].as_array().unwrap().len(), cases.len());
    assert_eq!(json["left_out"].as_array().unwrap().len(), 0);
    assert_eq!(json["auto"].as_array().unwrap().len(), 2);

    // Interrupted while it wrote a line: what was finished is not run again.
    let runs = out.join("runs.jsonl");
    let before = fs::read_to_string(&runs).unwrap();
    let lines: Vec<&str> = before.lines().collect();
    let kept = lines.len() - 10;
    let cut = lines[..kept].join("\n") + "\n" + &lines[kept][..40];
    fs::write(&runs, cut).unwrap();
    fs::remove_file(out.join("solves.csv")).unwrap();
    run(folder.path(), ARGS).success();
    let after = fs::read_to_string(&runs).unwrap();
    assert_eq!(after.lines().count(), lines.len());
    assert!(after.lines().zip(&lines).take(kept).all(|(a, b)| a == *b));
    assert_eq!(table(&out.join("solves.csv")).len(), cases.len());

    // Nothing is left to run: not a byte is added.
    run(folder.path(), ARGS).success();
    assert_eq!(fs::read_to_string(&runs).unwrap(), after);

    // Runs of another machine are not mixed with these.
    fs::write(&runs, after.replacen("\"threads\":", "\"threads\":1", 1)).unwrap();
    fails(&folder, ARGS, 2, "another machine or version");
}

#[test]
fn wrong_usage_is_told() {
    let folder = folder();
    fails(&folder, "chart gone.toml", 2, "no such scene file");
    fails(
        &folder,
        "chart",
        2,
        "scenes/cornell.toml: no such scene file",
    );
    fails(
        &folder,
        "chart furnace.toml --points 1",
        2,
        "1 is not in 2..",
    );
    fails(
        &folder,
        "chart furnace.toml --tolerances 0.1,2",
        2,
        "1e-6 to 0.5",
    );
    fails(&folder, "chart furnace.toml --limit 0", 2, "above 0");
}
