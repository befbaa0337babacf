//! The few things that all stages do with a device: tables, buffers, reading back, and errors.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytemuck::Pod;
use wgpu::{BufferUsages, ErrorFilter, PollType};

use super::Shader;
use crate::error::{Error, Result};

/// Longest wait for a device; its work is cut into pieces of a fraction of a second.
const TIMEOUT: Duration = Duration::from_secs(60);

/// A device and its queue, borrowed from whoever made them (both are handles, cheap to clone), and
/// the pipelines made on it so far, which its clones share.
#[derive(Clone, Debug)]
pub struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pipelines: Arc<Mutex<HashMap<Shader, wgpu::ComputePipeline>>>,
}

impl Gpu {
    pub fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Gpu {
        Gpu {
            device: device.clone(),
            queue: queue.clone(),
            pipelines: Arc::default(),
        }
    }

    /// The pipeline of a stage, made by the first who asks for it.
    pub(super) fn pipeline(&self, shader: &Shader) -> Result<wgpu::ComputePipeline> {
        let mut pipelines = (self.pipelines.lock()).unwrap_or_else(PoisonError::into_inner);
        if let Some(made) = pipelines.get(shader) {
            return Ok(made.clone());
        }
        let made = self.watch(shader.name, || Ok(shader.compile(&self.device)))?;
        pipelines.insert(*shader, made.clone());
        Ok(made)
    }

    /// Takes the pipeline of another shader for that of a stage: so a driver that computes wrongly can
    /// be had for tests.
    #[doc(hidden)]
    pub fn mistake(&self, stage: &Shader, other: &Shader) -> Result<()> {
        let made = self.watch(other.name, || Ok(other.compile(&self.device)))?;
        let mut pipelines = (self.pipelines.lock()).unwrap_or_else(PoisonError::into_inner);
        pipelines.insert(*stage, made);
        Ok(())
    }

    /// Runs `work` and turns what the device has to say against it into an error.
    ///
    /// The device's own handlers stay untouched: they belong to whoever made it.
    pub fn watch<T>(&self, what: &str, work: impl FnOnce() -> Result<T>) -> Result<T> {
        let filters = [
            ErrorFilter::Validation,
            ErrorFilter::OutOfMemory,
            ErrorFilter::Internal,
        ];
        let scopes = filters.map(|filter| self.device.push_error_scope(filter));
        let result = work();
        let mut failure = None;
        for scope in scopes.into_iter().rev() {
            failure = pollster::block_on(scope.pop()).or(failure);
        }
        match failure {
            None => result,
            Some(wgpu::Error::OutOfMemory { .. }) => Err(Error::TooLarge(format!(
                "{what}: the device has not enough memory"
            ))),
            Some(error) => Err(Error::Device(format!("{what}: {error}"))),
        }
    }

    /// Largest number of elements of `bytes` that one binding of a storage buffer can hold.
    pub fn most_bound(&self, bytes: usize) -> usize {
        let limits = self.device.limits();
        let most = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        most as usize / bytes
    }

    /// A storage buffer that can be copied to and from. It may be larger than one binding.
    pub fn storage(&self, what: &str, bytes: usize) -> Result<wgpu::Buffer> {
        let most = self.device.limits().max_buffer_size as usize;
        if bytes > most {
            return Err(Error::TooLarge(format!(
                "{what}: {:.1} MiB do not fit into a buffer of this device, which holds {:.1} MiB",
                mib(bytes),
                mib(most)
            )));
        }
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        self.buffer(what, bytes, usage)
    }

    /// A uniform buffer that holds `data`.
    pub fn uniform<T: Pod>(&self, what: &str, data: &[T]) -> Result<wgpu::Buffer> {
        let usage = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let buffer = self.buffer(what, size_of_val(data), usage)?;
        self.watch(what, || {
            self.queue
                .write_buffer(&buffer, 0, bytemuck::cast_slice(data));
            Ok(buffer)
        })
    }

    /// A buffer to read results from.
    pub fn staging(&self, what: &str, bytes: usize) -> Result<wgpu::Buffer> {
        self.buffer(what, bytes, BufferUsages::MAP_READ | BufferUsages::COPY_DST)
    }

    fn buffer(&self, what: &str, bytes: usize, usage: BufferUsages) -> Result<wgpu::Buffer> {
        self.watch(what, || {
            Ok(self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(what),
                size: bytes as u64,
                usage,
                mapped_at_creation: false,
            }))
        })
    }

    /// Submits what was recorded, waits until it is done, and hands the first `count` elements of
    /// `staging` to `read`.
    pub fn run_and_read<T: Pod, R>(
        &self,
        what: &str,
        encoder: wgpu::CommandEncoder,
        staging: &wgpu::Buffer,
        count: usize,
        read: impl FnOnce(&[T]) -> R,
    ) -> Result<R> {
        let failed = |why: &str| Error::Device(format!("{what}: {why}"));
        let slice = staging.slice(..(count * size_of::<T>()) as u64);
        let (sender, receiver) = std::sync::mpsc::channel();
        self.queue.submit([encoder.finish()]);
        slice.map_async(wgpu::MapMode::Read, move |result| {
            let _ = sender.send(result);
        });
        self.wait(what)?;
        // Another thread that waits for the same device may be the one that calls back.
        match receiver.recv_timeout(TIMEOUT) {
            Ok(Ok(())) => {}
            _ => return Err(failed("the device was lost or gave no result")),
        }
        let view = slice
            .get_mapped_range()
            .map_err(|e| failed(&e.to_string()))?;
        let result = read(bytemuck::cast_slice(&view));
        drop(view);
        staging.unmap();
        Ok(result)
    }

    /// Waits for the device, which may be gone: wgpu panics if it is lost during the wait.
    pub(super) fn wait(&self, what: &str) -> Result<()> {
        let poll = || {
            self.device.poll(PollType::Wait {
                submission_index: None,
                timeout: Some(TIMEOUT),
            })
        };
        match catch_unwind(AssertUnwindSafe(poll)) {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(e)) => Err(Error::Device(format!("{what}: {e}"))),
            Err(_) => Err(Error::Device(format!("{what}: the device was lost"))),
        }
    }
}

pub(super) fn mib(bytes: usize) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}
