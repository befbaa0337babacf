//! What is finished: a file of lines, to which each run adds one.

use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::machine::Machine;
use super::measure::Solve;
use super::orders::OrderRow;
use super::stages::StageRow;
use crate::error::{Error, Result};
use crate::output::write_atomic;

/// A finished piece of work.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Finished {
    Solve(Solve),
    Orders {
        scene: PathBuf,
        points: usize,
        order: usize,
        rows: Vec<OrderRow>,
    },
    Stages {
        scene: PathBuf,
        points: usize,
        rows: Vec<StageRow>,
    },
}

/// The file, open at its end, and what is in it.
pub struct Records {
    path: PathBuf,
    file: File,
    pub finished: Vec<Finished>,
}

impl Records {
    /// Opens the file or begins it. Its first line is the machine. A last line that was not written to
    /// its end is taken off.
    ///
    /// Fails with [`Error::Usage`] where another machine or version has begun it, with
    /// [`Error::Input`] where it holds something else.
    pub fn open(path: &Path, machine: &Machine) -> Result<Records> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == ErrorKind::NotFound => String::new(),
            Err(e) => return Err(Error::io(path, "cannot be read", e)),
        };
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        let mut finished = Vec::new();
        let mut lines = whole.lines().enumerate();
        match lines.next() {
            None => {
                let first = line(path, machine)?;
                write_atomic(path, |file| file.write_all(first.as_bytes()))?;
            }
            Some((_, first)) => {
                let other: Machine = parsed(path, 1, first)?;
                if other != *machine {
                    return Err(Error::Usage(format!(
                        "{} holds runs of another machine or version ({}; this is {}): take another \
                         folder, or delete the file",
                        path.display(),
                        other.caption(),
                        machine.caption()
                    )));
                }
                for (k, text) in lines {
                    finished.push(parsed(path, k + 1, text)?);
                }
                if whole.len() < text.len() {
                    write_atomic(path, |file| file.write_all(whole.as_bytes()))?;
                }
            }
        }
        let file = OpenOptions::new().append(true).open(path);
        Ok(Records {
            path: path.to_owned(),
            file: file.map_err(|e| Error::io(path, "cannot be written", e))?,
            finished,
        })
    }

    /// Adds a line; it is on the disk when this returns.
    pub fn add(&mut self, finished: Finished) -> Result<()> {
        let line = line(&self.path, &finished)?;
        let written = self.file.write_all(line.as_bytes());
        written
            .and_then(|()| self.file.sync_data())
            .map_err(|e| Error::io(&self.path, "cannot be written", e))?;
        self.finished.push(finished);
        Ok(())
    }
}

fn line(path: &Path, value: &impl Serialize) -> Result<String> {
    let text = serde_json::to_string(value)
        .map_err(|e| Error::input(path, format!("a run cannot be written: {e}")))?;
    Ok(text + "\n")
}

fn parsed<T: for<'a> Deserialize<'a>>(path: &Path, number: usize, text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|e| {
        Error::input(
            path,
            format!("line {number} is no run of a chart ({e}): take another folder"),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine() -> Machine {
        Machine {
            version: "1".into(),
            cpu: "a CPU".into(),
            threads: 2,
            adapter: None,
        }
    }

    fn orders(order: usize) -> Finished {
        Finished::Orders {
            scene: "a.toml".into(),
            points: 10,
            order,
            rows: Vec::new(),
        }
    }

    #[test]
    fn what_was_finished_is_there_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("runs.jsonl");
        let mut records = Records::open(&path, &machine()).unwrap();
        records.add(orders(1)).unwrap();
        records.add(orders(2)).unwrap();
        drop(records);
        // Killed while it wrote.
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"orders\":{\"sce").unwrap();
        let mut records = Records::open(&path, &machine()).unwrap();
        assert_eq!(records.finished, [orders(1), orders(2)]);
        records.add(orders(3)).unwrap();
        let records = Records::open(&path, &machine()).unwrap();
        assert_eq!(records.finished, [orders(1), orders(2), orders(3)]);
    }

    #[test]
    fn other_files_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("runs.jsonl");
        Records::open(&path, &machine()).unwrap();
        let other = Machine {
            threads: 4,
            ..machine()
        };
        let told = |machine: &Machine| Records::open(&path, machine).err().unwrap().to_string();
        assert!(told(&other).contains("another machine or version"));
        std::fs::write(&path, "x y z\n").unwrap();
        assert!(told(&machine()).contains("line 1 is no run"));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "x y z\n");
    }
}
