//! Where the passes run: what was asked for, what is there, what is taken and why.

use clap::ValueEnum;
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice, OpenDevice};
use fmmgi_gpu::{Backend, Error, Method, Result};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Choice {
    /// A real GPU if there is one, otherwise the CPU
    Auto,
    /// A GPU, or software Vulkan where there is none
    Gpu,
    /// All threads of the CPU
    Cpu,
}

/// What was taken, and why.
pub struct Chosen {
    gpu: Option<OpenDevice>,
    why: String,
}

impl Chosen {
    pub fn backend(&self) -> Backend<'_> {
        match &self.gpu {
            None => Backend::Cpu,
            Some(gpu) => Backend::Gpu {
                device: &gpu.device,
                queue: &gpu.queue,
                adapter: &gpu.info.name,
            },
        }
    }

    /// For example "cpu (no GPU was found)".
    pub fn describe(&self) -> String {
        match &self.gpu {
            None => format!("cpu ({})", self.why),
            Some(gpu) => format!("gpu {} ({})", gpu.info, self.why),
        }
    }
}

/// Opens what is asked for.
///
/// Software Vulkan computes on the CPU, and slower than the CPU passes do: it is taken only when
/// a GPU or this adapter is asked for.
pub fn choose(choice: Choice, adapter: Option<&str>, method: Method) -> Result<Chosen> {
    let cpu = |why: &str| {
        let why = why.to_owned();
        Ok(Chosen { gpu: None, why })
    };
    let gpu = |choice: AdapterChoice, why: &str| {
        let gpu = adapter::open(&choice)?;
        let why = why.to_owned();
        Ok(Chosen {
            gpu: Some(gpu),
            why,
        })
    };
    match (choice, adapter) {
        (Choice::Cpu, Some(_)) => Err(Error::Usage(
            "--adapter chooses a GPU, but --backend cpu asks for none: give only one".to_owned(),
        )),
        (Choice::Gpu, _) | (_, Some(_)) if method == Method::Direct => Err(Error::Usage(
            "--method direct runs on the CPU only: leave out --backend and --adapter".to_owned(),
        )),
        (_, Some(name)) => gpu(
            AdapterChoice::Named(name.to_owned()),
            "asked for by --adapter",
        ),
        (Choice::Gpu, None) => gpu(AdapterChoice::Any, "asked for by --backend gpu"),
        (Choice::Cpu, None) => cpu("asked for by --backend cpu"),
        (Choice::Auto, None) if method == Method::Direct => {
            cpu("the direct method runs on it only")
        }
        (Choice::Auto, None) => match adapter::list() {
            all if all.is_empty() => cpu("no GPU was found"),
            all if all.iter().all(|info| info.is_software()) => {
                cpu("no GPU was found but software Vulkan, which --backend gpu would use")
            }
            _ => gpu(AdapterChoice::Auto, "the best GPU found")
                .or_else(|error| cpu(&error.to_string())),
        },
    }
}
