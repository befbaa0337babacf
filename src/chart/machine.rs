//! The machine that measures.

use std::fs;

use serde::{Deserialize, Serialize};

use crate::passes::gpu::adapter::OpenDevice;

/// What times depend on. Those of another machine, or of another version, are not mixed with these.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Of this program.
    pub version: String,
    /// Model of the CPU, as the system tells it.
    pub cpu: String,
    /// Threads that run at once.
    pub threads: usize,
    /// The adapter that stands for "gpu", if there is one.
    pub adapter: Option<String>,
}

impl Machine {
    pub fn this(gpu: Option<&OpenDevice>) -> Machine {
        Machine {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            cpu: cpu_model().unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            threads: rayon::current_num_threads(),
            adapter: gpu.map(|gpu| gpu.info.name.clone()),
        }
    }

    /// Without what a caption has no room for.
    pub fn caption(&self) -> String {
        let threads = match self.threads {
            1 => "1 thread".to_owned(),
            n => format!("{n} threads"),
        };
        let adapter = self.adapter.as_deref().unwrap_or("no adapter");
        format!(
            "fmmgi-gpu {}, {}, {threads}; gpu: {adapter}",
            self.version, self.cpu
        )
    }
}

fn cpu_model() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    let (_, name) = line.split_once(':')?;
    Some(name.split_whitespace().collect::<Vec<_>>().join(" "))
}
