//! `fmmgi-gpu adapters`

use fmmgi_gpu::Result;

use super::Done;
use fmmgi_gpu::passes::gpu::adapter;

/// List the GPU adapters, real and software, that "--adapter" of "solve" and "visible" can name.
#[derive(clap::Args)]
pub struct Args {}

pub fn run() -> Result<Done> {
    let all = adapter::list();
    if all.is_empty() {
        super::print(
            "no adapter: install the driver of your GPU, or software Vulkan \
             (Debian and Ubuntu: apt install mesa-vulkan-drivers)",
        )?;
    }
    for info in all {
        super::print(&info.to_string())?;
    }
    Ok(Done::Well)
}
