mod cli;

fn main() -> std::process::ExitCode {
    #[cfg(unix)]
    calm_vulkan();
    cli::run()
}

/// Mesa's Vulkan layer "device select" asks the Wayland display which device to prefer. Where
/// there is none, Wayland's library prints an error that is none. The layer is not needed:
/// adapters are chosen by their kind or by name.
#[cfg(unix)]
fn calm_vulkan() {
    let is_set = |name| std::env::var_os(name).is_some();
    let used = [
        "XDG_RUNTIME_DIR",
        "NODEVICE_SELECT",
        "MESA_VK_DEVICE_SELECT",
    ];
    if !used.into_iter().any(is_set) {
        // SAFETY: called before any thread is started.
        unsafe { std::env::set_var("NODEVICE_SELECT", "1") };
    }
}
