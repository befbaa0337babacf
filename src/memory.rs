//! How much memory the process took.

/// Largest resident size of this process so far, in bytes; `None` where the system does not tell.
#[cfg(unix)]
pub fn peak_bytes() -> Option<u64> {
    let mut usage = std::mem::MaybeUninit::<libc::rusage>::uninit();
    // SAFETY: getrusage fills the struct that it is given; it is read only on success.
    let usage = unsafe {
        if libc::getrusage(libc::RUSAGE_SELF, usage.as_mut_ptr()) != 0 {
            return None;
        }
        usage.assume_init()
    };
    // Linux counts in KiB, macOS in bytes.
    let unit = if cfg!(target_vendor = "apple") {
        1
    } else {
        1024
    };
    Some(u64::try_from(usage.ru_maxrss).ok()? * unit)
}

/// Largest resident size of this process so far, in bytes; `None` where the system does not tell.
#[cfg(not(unix))]
pub fn peak_bytes() -> Option<u64> {
    None
}
