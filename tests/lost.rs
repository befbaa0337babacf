//! Devices that are lost in the middle of the work, or too small for it: an error, whenever it comes.

mod common;

use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use common::{limited, scene};
use fmmgi_gpu::passes::gpu::adapter;
use fmmgi_gpu::progress::Silent;
use fmmgi_gpu::{Backend, Error, Method, Options, Progress, Result, illuminate};

fn options() -> Options {
    Options {
        method: Method::Fmm,
        ..Options::default()
    }
}

/// Loses a device as the stage of a number begins.
struct Loses<'a> {
    device: Option<&'a wgpu::Device>,
    after: usize,
    stages: AtomicUsize,
}

impl Progress for Loses<'_> {
    fn stage(&self, _: &'static str, _: u64) {
        if self.stages.fetch_add(1, Relaxed) == self.after
            && let Some(device) = self.device
        {
            device.destroy();
        }
    }
}

/// How a solve ends whose device is lost after so many stages, and how many there were.
fn lose(after: usize) -> (Result<()>, usize) {
    let open = adapter::open(&adapter::AdapterChoice::Any).unwrap();
    let progress = Loses {
        device: Some(&open.device),
        after,
        stages: AtomicUsize::new(0),
    };
    let backend = Backend::Gpu {
        device: &open.device,
        queue: &open.queue,
        adapter: "test",
    };
    let lit = illuminate(&scene("cornell", 1500), &options(), backend, &progress);
    (lit.map(|_| ()), progress.stages.into_inner())
}

#[test]
fn a_lost_device_is_an_error_whenever_it_is_lost() {
    let (whole, stages) = lose(usize::MAX);
    whole.unwrap();
    assert!(stages > 8, "{stages}");
    for after in 0..stages {
        let (lost, begun) = lose(after);
        match lost {
            // At the trial of the device, or in the work.
            Err(Error::Device(_) | Error::NoBackend(_)) => {}
            // Nothing was left for it to do.
            Ok(()) => assert!(after + 2 >= stages, "{after} of {stages}"),
            Err(other) => panic!("{after}: {other:?}"),
        }
        assert!(begun <= stages);
    }
}

/// The tables and buffers of a room do not fit into what this device offers, which is enough for its
/// trial.
#[test]
fn a_device_without_the_memory_is_an_error() {
    let small = limited(
        wgpu::Limits {
            max_texture_dimension_2d: 8192,
            max_buffer_size: 1 << 16,
            max_storage_buffer_binding_size: 1 << 16,
            ..Default::default()
        },
        wgpu::Features::empty(),
    );
    let backend = Backend::Gpu {
        device: &small.device,
        queue: &small.queue,
        adapter: "small",
    };
    let lit = illuminate(&scene("cornell", 20_000), &options(), backend, &Silent);
    let error = lit.map(|_| ()).unwrap_err();
    assert!(matches!(error, Error::TooLarge(_)), "{error:?}");
}
