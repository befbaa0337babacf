//! What work takes: time on the wall, and of all threads together.

use std::time::Instant;

/// Seconds that something took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// On the wall.
    pub wall: f64,
    /// Of all threads of the process together, user and system; as the wall where the system does not
    /// tell.
    pub cpu: f64,
}

/// Runs from its start.
pub struct Clock {
    began: Instant,
    cpu: Option<f64>,
}

impl Clock {
    pub fn start() -> Clock {
        Clock {
            began: Instant::now(),
            cpu: cpu_seconds(),
        }
    }

    /// What was spent since the start.
    pub fn spent(&self) -> Spent {
        let wall = self.began.elapsed().as_secs_f64();
        let cpu = cpu_seconds().zip(self.cpu).map(|(now, then)| now - then);
        Spent {
            wall,
            cpu: cpu.unwrap_or(wall),
        }
    }
}

/// Seconds of all threads of this process.
#[cfg(unix)]
fn cpu_seconds() -> Option<f64> {
    let mut usage = std::mem::MaybeUninit::<libc::rusage>::uninit();
    // SAFETY: getrusage fills the struct that it is given; it is read only on success.
    let usage = unsafe {
        if libc::getrusage(libc::RUSAGE_SELF, usage.as_mut_ptr()) != 0 {
            return None;
        }
        usage.assume_init()
    };
    let seconds = |t: libc::timeval| t.tv_sec as f64 + 1e-6 * t.tv_usec as f64;
    Some(seconds(usage.ru_utime) + seconds(usage.ru_stime))
}

/// Seconds of all threads of this process.
#[cfg(not(unix))]
fn cpu_seconds() -> Option<f64> {
    None
}

/// The middle one of some numbers, the mean of two where there is none; NaN of no numbers.
pub fn median(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n => 0.5 * (sorted[(n - 1) / 2] + sorted[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_by_hand() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0]), 2.5);
        assert!(median(&[]).is_nan());
    }

    #[test]
    fn the_clock_sees_work_but_no_sleep() {
        let clock = Clock::start();
        let mut x = 1.0f64;
        while clock.began.elapsed().as_millis() < 30 {
            x = std::hint::black_box(x.sqrt() + 1.0);
        }
        let worked = clock.spent();
        assert!(worked.wall >= 0.03 && worked.cpu > 0.0);
    }
}
