//! How much memory the process took, how much there is, and whether that is enough.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::cgroup;
use crate::error::{Error, Result};

/// Largest resident size of this process so far, in bytes; `None` where the system does not tell.
#[cfg(unix)]
pub fn peak_bytes() -> Option<u64> {
    // What getrusage tells on Linux goes back to the process that started this one.
    if let Some(bytes) = told("/proc/self/status", "VmHWM:") {
        return Some(bytes);
    }
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

/// Bytes of memory that can be taken without swapping, and within the limits of a container, where the
/// system tells (Linux), otherwise `None`.
pub fn available() -> Option<u64> {
    [
        told("/proc/meminfo", "MemAvailable:"),
        cgroup::left(Path::new("/")),
    ]
    .into_iter()
    .flatten()
    .min()
}

/// Bytes that a file of Linux tells under a name.
fn told(path: &str, name: &str) -> Option<u64> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|l| l.strip_prefix(name))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

/// What may be taken by work whose size shows only as it goes on: what was free at its start.
pub(crate) struct Budget {
    free: u64,
    taken: AtomicU64,
}

impl Budget {
    pub fn new() -> Budget {
        Budget {
            free: available().unwrap_or(u64::MAX),
            taken: AtomicU64::new(0),
        }
    }

    /// Takes some bytes; fails with [`Error::TooLarge`] where they would not fit.
    pub fn take(&self, bytes: usize) -> Result<()> {
        let taken = self.taken.fetch_add(bytes as u64, Ordering::Relaxed) + bytes as u64;
        if taken > self.free {
            return Err(Error::TooLarge(format!(
                "the links do not fit into {} MiB of memory: ask for a larger tolerance, or take \
                 fewer points",
                self.free >> 20
            )));
        }
        Ok(())
    }
}

/// Memory that a link by rays takes at most, while links are put together and carried to a device.
const BYTES_A_RAY: u64 = 32;

/// Refuses rays whose hits would not fit into the memory that is free, where that is known, before
/// they are cast. Rays of one surfel that meet the same other one take no more memory than one.
pub fn check_rays(surfels: usize, rays: u32, free: Option<u64>) -> Result<()> {
    let needed = surfels as u64 * u64::from(rays).min(surfels as u64) * BYTES_A_RAY;
    match free {
        Some(free) if needed > free => Err(Error::TooLarge(format!(
            "{rays} rays from each of {surfels} points need {} MiB of memory, but only {} MiB are \
             free: take fewer rays or points, or ask for a larger tolerance",
            needed >> 20,
            free >> 20
        ))),
        _ => Ok(()),
    }
}

/// Memory that a solve takes a point without its links.
const BYTES_A_POINT: u64 = 1000;
/// Memory that reading takes a point; measured are 55 bytes (LAZ, with colours) to 70 (E57).
const BYTES_A_POINT_READ: u64 = 70;

/// Refuses a number of points that cannot be held in the memory that is free, before they are read.
pub fn check_reading(count: u64) -> Result<()> {
    let needed = count.saturating_mul(BYTES_A_POINT_READ);
    match available() {
        Some(free) if needed > free => Err(Error::TooLarge(format!(
            "{count} points take {} MiB of memory to read, but only {} MiB are free",
            needed >> 20,
            free >> 20
        ))),
        _ => Ok(()),
    }
}

/// Three of the 32 bits of an occluder's number hold the size of its leaf.
const MOST_POINTS: u64 = (1 << 29) - 1;

/// Refuses a number of points that cannot be lit in the memory that is free, before anything is
/// allocated for them.
pub fn check_points(count: u64) -> Result<()> {
    if count > MOST_POINTS {
        return Err(Error::TooLarge(format!(
            "{count} points: no more than {MOST_POINTS} can be numbered"
        )));
    }
    let needed = count * BYTES_A_POINT;
    match available() {
        Some(free) if needed > free => Err(Error::TooLarge(format!(
            "{count} points need at least {} MiB of memory, but only {} MiB are free: take fewer \
             points",
            needed >> 20,
            free >> 20
        ))),
        _ => Ok(()),
    }
}

/// Memory a surfel beside what its file holds: facets with their measures, what stands in the way, its
/// colours and those that are handed back.
const LOADED_BYTES_A_SURFEL: u64 = 400;

/// Refuses a kept operator of so many bytes that would not fit into the memory that is free.
pub fn check_operator(bytes: u64, surfels: u64) -> Result<()> {
    if surfels > MOST_POINTS {
        return Err(Error::TooLarge(format!(
            "{surfels} surfels: no more than {MOST_POINTS} can be numbered"
        )));
    }
    let needed = bytes + surfels * LOADED_BYTES_A_SURFEL;
    match available() {
        Some(free) if needed > free => Err(Error::TooLarge(format!(
            "an operator of {} MiB for {surfels} surfels needs {} MiB of memory, but only {} MiB \
             are free",
            bytes >> 20,
            needed >> 20,
            free >> 20
        ))),
        _ => Ok(()),
    }
}
