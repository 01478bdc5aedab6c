//! How much processor time something takes, which a busy machine changes less than wall-clock time.

use std::time::Instant;

/// A measurement that has begun.
#[derive(Clone, Copy, Debug)]
pub struct ProcessorTime {
    begun_s: Option<f64>,
    begun: Instant,
}

impl ProcessorTime {
    /// Begins a measurement.
    pub fn start() -> Self {
        Self {
            begun_s: used_s(),
            begun: Instant::now(),
        }
    }

    /// Returns the time that this process has used since then on all processors, seconds; where the
    /// operating system does not tell, the wall-clock time.
    pub fn seconds(&self) -> f64 {
        match (self.begun_s, used_s()) {
            (Some(begun_s), Some(now_s)) => now_s - begun_s,
            _ => self.begun.elapsed().as_secs_f64(),
        }
    }
}

/// Returns the time that this process has used on all processors, seconds.
#[cfg(unix)]
fn used_s() -> Option<f64> {
    let used = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Some(used.tv_sec as f64 + 1e-9 * used.tv_nsec as f64)
}

#[cfg(not(unix))]
fn used_s() -> Option<f64> {
    None
}
