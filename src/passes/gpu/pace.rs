//! How much work to give a device at once.

use std::time::Duration;

/// A dispatch should take about so long: well under the seconds after which drivers and desktops
/// take a device for hung, and long against the 0.1 ms that a submission costs.
const TARGET: Duration = Duration::from_millis(40);
/// Most that a piece grows or shrinks by from one to the next.
const STEP: f64 = 4.0;

/// Sizes pieces of work by how long the pieces before them took.
pub struct Pace {
    size: usize,
    most: usize,
}

impl Pace {
    /// Begins with pieces of `first` and never exceeds `most`.
    pub fn new(first: usize, most: usize) -> Pace {
        Pace {
            size: first.min(most),
            most,
        }
    }

    /// Size of the next piece, at least 1.
    pub fn size(&self) -> usize {
        self.size.max(1)
    }

    /// Learns that a piece of `size` took so long.
    pub fn took(&mut self, size: usize, time: Duration) {
        let factor = TARGET.as_secs_f64() / time.as_secs_f64().max(1e-6);
        let fitting = size as f64 * factor.clamp(1.0 / STEP, STEP);
        // A small last piece says nothing about larger ones, unless it was slow.
        if size >= self.size || factor < 1.0 {
            self.size = (fitting as usize).clamp(1, self.most.max(1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs the pace against a device that takes `each` for every unit.
    fn settle(pace: &mut Pace, each: Duration) -> usize {
        for _ in 0..50 {
            pace.took(pace.size(), each * pace.size() as u32);
        }
        pace.size()
    }

    #[test]
    fn pieces_settle_at_the_target() {
        let mut pace = Pace::new(100, 1_000_000);
        let fitting = TARGET.as_micros() as usize;
        assert_eq!(settle(&mut pace, Duration::from_micros(1)), fitting);
        assert_eq!(settle(&mut pace, Duration::from_micros(100)), fitting / 100);
        assert_eq!(settle(&mut pace, Duration::from_secs(1)), 1);
        assert_eq!(settle(&mut pace, Duration::ZERO), 1_000_000);
    }

    #[test]
    fn a_small_quick_piece_changes_nothing() {
        let mut pace = Pace::new(1000, 10_000);
        pace.took(3, Duration::from_micros(10));
        assert_eq!(pace.size(), 1000);
    }
}
