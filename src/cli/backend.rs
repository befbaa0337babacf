//! Where the passes run: what was asked for, what is there, what is taken and why.

use clap::ValueEnum;
use fmmgi_gpu::passes::gpu::adapter::{self, AdapterChoice, OpenDevice};
use fmmgi_gpu::{Backend, Error, Method, Progress, Result};

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
    /// Whether the CPU will do as well.
    is_free: bool,
}

impl Chosen {
    /// Does the work there. Where a GPU fails that nobody asked for, the CPU takes over.
    pub fn run<T>(
        &mut self,
        progress: &dyn Progress,
        work: impl Fn(Backend) -> Result<T>,
    ) -> Result<T> {
        progress.note(&format!("backend: {}", self.describe()));
        let done = work(self.backend());
        match (done, &self.gpu) {
            (Err(Error::Device(why) | Error::NoBackend(why) | Error::TooLarge(why)), Some(gpu))
                if self.is_free =>
            {
                self.why = format!("it takes over from {}: {why}", gpu.info.name);
                self.gpu = None;
                progress.note(&format!("backend: {}", self.describe()));
                work(Backend::Cpu)
            }
            (done, _) => done,
        }
    }

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
        Ok(Chosen {
            gpu: None,
            why,
            is_free: true,
        })
    };
    let gpu = |choice: AdapterChoice, why: &str| {
        let gpu = adapter::open(&choice)?;
        let why = why.to_owned();
        Ok(Chosen {
            gpu: Some(gpu),
            why,
            is_free: choice == AdapterChoice::Auto,
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

#[cfg(test)]
mod tests {
    use fmmgi_gpu::glam::{DVec3, Vec3};
    use fmmgi_gpu::progress::Silent;
    use fmmgi_gpu::{Options, PointCloud, Scene, illuminate};

    use super::*;

    /// Light on a floor, by a device that is lost.
    fn lit_by_a_lost_device(is_free: bool) -> (Result<String>, Chosen) {
        let mut scene = Scene {
            sky: Vec3::ONE,
            ..Scene::default()
        };
        for k in 0..16 {
            let PointCloud {
                positions,
                normals,
                reflectance,
                emission,
                ..
            } = &mut scene.cloud;
            positions.push(DVec3::new(f64::from(k % 4), f64::from(k / 4), 0.0));
            normals.push(Vec3::Z);
            reflectance.push(Vec3::splat(0.5));
            emission.push(Vec3::ZERO);
        }
        let gpu = adapter::open(&AdapterChoice::Any).unwrap();
        gpu.device.destroy();
        let mut chosen = Chosen {
            gpu: Some(gpu),
            why: "the test's".into(),
            is_free,
        };
        let work = |backend: Backend| illuminate(&scene, &Options::default(), backend, &Silent);
        let lit = chosen.run(&Silent, work);
        (lit.map(|lit| lit.stats.backend), chosen)
    }

    #[test]
    fn the_cpu_takes_over_where_it_may() {
        let (backend, chosen) = lit_by_a_lost_device(true);
        assert_eq!(backend.unwrap(), "cpu");
        assert!(chosen.describe().starts_with("cpu (it takes over from "));
        let (backend, chosen) = lit_by_a_lost_device(false);
        assert!(matches!(backend, Err(Error::NoBackend(_))));
        assert!(chosen.describe().starts_with("gpu "));
    }
}
