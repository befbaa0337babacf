//! Which adapters there are, and opening one: for programs that have no device of their own.

use std::fmt;

use wgpu::{Backend, Backends, DeviceType, Features, InstanceDescriptor, Limits};

use crate::error::{Error, Result};

/// An adapter as the user sees it.
#[derive(Clone, Debug)]
pub struct AdapterInfo {
    /// Its place in [`list`].
    pub index: usize,
    /// As the driver tells it.
    pub name: String,
    /// Discrete, integrated, virtual or software.
    pub device_type: DeviceType,
    /// Name and version of the driver.
    pub driver: String,
    /// Vulkan, Metal or Direct3D 12.
    pub backend: Backend,
}

/// Which adapter to open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The best real GPU.
    Auto,
    /// The best real GPU, or software where there is none.
    Any,
    /// By its index in [`list`] or a part of its name, in any case.
    Named(String),
}

/// A device to work on.
pub struct OpenDevice {
    /// With buffers and textures as large as the adapter offers.
    pub device: wgpu::Device,
    /// The device's queue.
    pub queue: wgpu::Queue,
    /// The adapter that was opened.
    pub info: AdapterInfo,
}

impl AdapterInfo {
    fn new(index: usize, adapter: &wgpu::Adapter) -> AdapterInfo {
        let info = adapter.get_info();
        AdapterInfo {
            index,
            name: info.name,
            device_type: info.device_type,
            driver: format!("{} {}", info.driver, info.driver_info),
            backend: info.backend,
        }
    }

    /// Whether it computes on the CPU.
    pub fn is_software(&self) -> bool {
        self.device_type == DeviceType::Cpu
    }

    /// Place among the preferred kinds; 0 is best.
    fn rank(&self) -> u32 {
        match self.device_type {
            DeviceType::DiscreteGpu => 0,
            DeviceType::IntegratedGpu => 1,
            DeviceType::VirtualGpu => 2,
            DeviceType::Other => 3,
            DeviceType::Cpu => 4,
        }
    }

    fn is_named(&self, name: &str) -> bool {
        self.name.to_lowercase().contains(&name.to_lowercase())
    }
}

impl fmt::Display for AdapterInfo {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let kind = match self.device_type {
            DeviceType::DiscreteGpu => "discrete GPU",
            DeviceType::IntegratedGpu => "integrated GPU",
            DeviceType::VirtualGpu => "virtual GPU",
            DeviceType::Cpu => "software",
            DeviceType::Other => "other",
        };
        write!(f, "{}: {} ({kind}; {}", self.index, self.name, self.backend)?;
        match self.driver.trim() {
            "" => write!(f, ")"),
            driver => write!(f, "; {driver})"),
        }
    }
}

/// All adapters that can compute.
pub fn list() -> Vec<AdapterInfo> {
    adapters().into_iter().map(|(info, _)| info).collect()
}

/// Opens an adapter.
///
/// Fails with [`Error::NoBackend`], which says what there is and what can be installed.
pub fn open(choice: &AdapterChoice) -> Result<OpenDevice> {
    let mut all = adapters();
    let infos: Vec<AdapterInfo> = all.iter().map(|(info, _)| info.clone()).collect();
    let index = choose(&infos, choice)?;
    let (info, adapter) = all.swap_remove(index);
    let (device, queue) = request(&adapter)
        .map_err(|e| Error::NoBackend(format!("adapter {info} does not open: {e}")))?;
    Ok(OpenDevice {
        device,
        queue,
        info,
    })
}

fn adapters() -> Vec<(AdapterInfo, wgpu::Adapter)> {
    let instance = wgpu::Instance::new(InstanceDescriptor::new_without_display_handle_from_env());
    pollster::block_on(instance.enumerate_adapters(Backends::all()))
        .into_iter()
        .filter(|adapter| {
            let capabilities = adapter.get_downlevel_capabilities().flags;
            capabilities.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS)
        })
        .enumerate()
        .map(|(index, adapter)| (AdapterInfo::new(index, &adapter), adapter))
        .collect()
}

/// Index of the chosen adapter.
fn choose(all: &[AdapterInfo], choice: &AdapterChoice) -> Result<usize> {
    let best = |fits: &dyn Fn(&AdapterInfo) -> bool| {
        let fitting = all.iter().filter(|info| fits(info));
        fitting.min_by_key(|info| info.rank()).map(|a| a.index)
    };
    let chosen = match choice {
        AdapterChoice::Auto => best(&|info| !info.is_software()),
        AdapterChoice::Any => best(&|_| true),
        AdapterChoice::Named(name) => {
            let index = name.parse().ok().filter(|&i: &usize| i < all.len());
            index.or_else(|| best(&|info| info.is_named(name)))
        }
    };
    chosen.ok_or_else(|| Error::NoBackend(nothing_fits(all, choice)))
}

fn nothing_fits(all: &[AdapterInfo], choice: &AdapterChoice) -> String {
    let wanted = match choice {
        AdapterChoice::Auto => "no GPU was found".to_owned(),
        AdapterChoice::Any => "no GPU and no software Vulkan was found".to_owned(),
        AdapterChoice::Named(name) => format!("no adapter has the index or name \"{name}\""),
    };
    if all.is_empty() {
        return format!(
            "{wanted}; the system offers no adapter at all. Install the driver of your GPU, or \
             software Vulkan (Debian and Ubuntu: apt install mesa-vulkan-drivers)"
        );
    }
    let offered: Vec<String> = all.iter().map(|info| format!("\n  {info}")).collect();
    format!("{wanted}; the system offers:{}", offered.concat())
}

/// A device with the adapter's buffers and tables, and subgroups where it has them; for the rest
/// with what every device has.
fn request(
    adapter: &wgpu::Adapter,
) -> std::result::Result<(wgpu::Device, wgpu::Queue), wgpu::RequestDeviceError> {
    let offered = adapter.limits();
    let required_limits = Limits {
        max_buffer_size: offered.max_buffer_size,
        max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
        max_texture_dimension_2d: offered.max_texture_dimension_2d,
        ..Limits::default()
    };
    pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
        label: Some("fmmgi"),
        required_features: adapter.features() & Features::SUBGROUP,
        required_limits,
        ..Default::default()
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info(index: usize, name: &str, device_type: DeviceType) -> AdapterInfo {
        AdapterInfo {
            index,
            name: name.to_owned(),
            device_type,
            driver: String::new(),
            backend: Backend::Vulkan,
        }
    }

    fn named(name: &str) -> AdapterChoice {
        AdapterChoice::Named(name.to_owned())
    }

    #[test]
    fn the_best_real_gpu_comes_first() {
        let all = [
            info(0, "llvmpipe", DeviceType::Cpu),
            info(1, "Iris Xe", DeviceType::IntegratedGpu),
            info(2, "RTX 4090", DeviceType::DiscreteGpu),
        ];
        assert_eq!(choose(&all, &AdapterChoice::Auto).unwrap(), 2);
        assert_eq!(choose(&all, &AdapterChoice::Any).unwrap(), 2);
        assert_eq!(choose(&all, &named("1")).unwrap(), 1);
        assert_eq!(choose(&all, &named("LLVM")).unwrap(), 0);
        assert_eq!(choose(&all, &named("4090")).unwrap(), 2);
    }

    #[test]
    fn software_is_taken_only_when_allowed() {
        let all = [info(0, "llvmpipe", DeviceType::Cpu)];
        assert_eq!(choose(&all, &AdapterChoice::Any).unwrap(), 0);
        let error = choose(&all, &AdapterChoice::Auto).unwrap_err();
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().contains("0: llvmpipe (software; "));
    }

    #[test]
    fn errors_say_what_there_is_or_what_to_install() {
        let error = choose(&[], &AdapterChoice::Any).unwrap_err().to_string();
        assert!(error.contains("apt install mesa-vulkan-drivers"), "{error}");
        let all = [info(0, "llvmpipe", DeviceType::Cpu)];
        let error = choose(&all, &named("radeon")).unwrap_err().to_string();
        assert!(
            error.contains("\"radeon\"") && error.contains("llvmpipe"),
            "{error}"
        );
    }
}
