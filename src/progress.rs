//! How long work tells where it stands, and hears that it should stop.

use crate::error::{Error, Result};

/// Receives the progress of long stages. Implementations must be cheap: `advance` is called from
/// many threads.
pub trait Progress: Sync {
    /// A stage of `total` units begins.
    fn stage(&self, name: &'static str, total: u64) {
        let _ = (name, total);
    }
    /// `n` more units of the current stage are done.
    fn advance(&self, n: u64) {
        let _ = n;
    }
    /// One line for the user.
    fn note(&self, line: &str) {
        let _ = line;
    }
    /// True once the work should stop.
    fn cancelled(&self) -> bool {
        false
    }
    /// Fails with [`Error::Interrupted`] once the work should stop.
    fn check(&self) -> Result<()> {
        if self.cancelled() {
            Err(Error::Interrupted)
        } else {
            Ok(())
        }
    }
}

/// No report, no stop.
pub struct Silent;
impl Progress for Silent {}
