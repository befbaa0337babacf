//! Files that are damaged or lie: what comes of them, and how much memory they take.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;
use std::sync::Once;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::scan::{self, ReadOptions, Scan};
use fmmgi_gpu::{Error, PointCloud};
use proptest::prelude::*;
use tempfile::NamedTempFile;

/// Notes the largest allocation that was asked for.
pub struct Noting;

static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: all is left to the system's allocator.
unsafe impl GlobalAlloc for Noting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Relaxed);
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Relaxed);
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LARGEST.fetch_max(size, Relaxed);
        unsafe { System.realloc(pointer, layout, size) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// The largest allocation so far, in bytes.
pub fn largest_allocation() -> usize {
    LARGEST.load(Relaxed)
}

static PANICS: AtomicUsize = AtomicUsize::new(0);

/// Panics inside of readers since the first call: they are errors for the caller, but should not
/// be needed.
pub fn panics() -> usize {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            PANICS.fetch_add(1, Relaxed);
            before(info);
        }));
    });
    PANICS.load(Relaxed)
}

pub fn file(bytes: &[u8]) -> NamedTempFile {
    let mut file = NamedTempFile::new().unwrap();
    file.write_all(bytes).unwrap();
    file
}

pub fn read(bytes: &[u8]) -> Result<PointCloud, Error> {
    scan::read(file(bytes).path(), &Silent)
}

pub fn read_scan(bytes: &[u8]) -> Scan {
    Scan::read(file(bytes).path(), &ReadOptions::default(), &Silent).unwrap()
}

/// The message of the error that reading gives; it must name the file.
pub fn error(bytes: &[u8]) -> String {
    let file = file(bytes);
    let error = scan::read(file.path(), &Silent).expect_err("bad input was read");
    let message = error.to_string();
    assert!(
        message.starts_with(file.path().to_str().unwrap()),
        "{message}"
    );
    message
}

/// Bytes of a file with some of them replaced, perhaps cut short. Half of the changes are among
/// the first 400 bytes, where the headers are.
pub fn damaged(files: &'static [Vec<u8>]) -> impl Strategy<Value = Vec<u8>> {
    let place = (any::<prop::sample::Index>(), any::<bool>());
    let byte = prop_oneof![Just(0), Just(255), any::<u8>()];
    let changes = prop::collection::vec((place, byte), 0..6);
    let cut = prop::option::weighted(0.3, any::<prop::sample::Index>());
    (0..files.len(), changes, cut).prop_map(|(k, changes, cut)| {
        let mut bytes = files[k].clone();
        for ((place, early), byte) in changes {
            let length = if early {
                bytes.len().min(400)
            } else {
                bytes.len()
            };
            bytes[place.index(length)] = byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        bytes
    })
}
