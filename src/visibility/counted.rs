//! How many segments were tested, and how long that took.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use super::{Segment, Visibility};
use crate::error::Result;

/// Passes segments on and counts those that need a test.
pub struct Counted<'a> {
    inner: &'a dyn Visibility,
    segments: AtomicU64,
    nanoseconds: AtomicU64,
}

impl<'a> Counted<'a> {
    pub fn new(inner: &'a dyn Visibility) -> Self {
        Counted {
            inner,
            segments: AtomicU64::new(0),
            nanoseconds: AtomicU64::new(0),
        }
    }

    /// What tests them, without the count.
    pub fn inner(&self) -> &'a dyn Visibility {
        self.inner
    }

    /// Segments tested so far.
    pub fn segments(&self) -> u64 {
        self.segments.load(Ordering::Relaxed)
    }

    /// Goes on from another number.
    pub(crate) fn set_segments(&self, segments: u64) {
        self.segments.store(segments, Ordering::Relaxed);
    }

    /// Seconds spent testing them.
    pub fn seconds(&self) -> f64 {
        self.nanoseconds.load(Ordering::Relaxed) as f64 * 1e-9
    }
}

impl Visibility for Counted<'_> {
    fn visible(&self, segments: &[Segment]) -> Result<Vec<bool>> {
        if self.is_open() {
            return self.inner.visible(segments);
        }
        let start = Instant::now();
        let answers = self.inner.visible(segments);
        self.segments
            .fetch_add(segments.len() as u64, Ordering::Relaxed);
        self.nanoseconds
            .fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
        answers
    }

    fn is_open(&self) -> bool {
        self.inner.is_open()
    }
}
