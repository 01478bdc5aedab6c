//! The `.tlog` format: the MAVLink log that ground stations and pymavlink read.
//!
//! Each record consists of the time as 8 bytes (microseconds since 1970, big-endian) and the frame
//! as it was sent over the link.

use std::io::{self, Write};

use firmware_core::time::{Duration, Instant};

/// The beginning of simulated time, fixed so that the log of a simulated run is reproducible:
/// 2026-01-01 00:00 UTC, microseconds since 1970.
pub const SIMULATED_EPOCH_US: u64 = 1_767_225_600_000_000;

/// Writes records to a log.
#[derive(Debug)]
pub struct TlogWriter<W> {
    out: W,
    epoch_us: u64,
    /// The time when buffered records are written out next.
    flush_due: Instant,
}

/// The longest part of a log that is lost if the process is killed.
const FLUSH_INTERVAL: Duration = Duration::from_secs(1);

impl<W: Write> TlogWriter<W> {
    /// Creates a log whose time begins at `epoch_us`: [`SIMULATED_EPOCH_US`], or the wall clock at
    /// the beginning of the run.
    pub fn new(out: W, epoch_us: u64) -> Self {
        Self {
            out,
            epoch_us,
            flush_due: Instant::ZERO,
        }
    }

    /// Appends a frame that was sent or received at `now`. The log is flushed once per second of
    /// that time, so that a log remains if the process is killed.
    pub fn record(&mut self, now: Instant, frame: &[u8]) -> io::Result<()> {
        let time = self.epoch_us.saturating_add(now.as_micros());
        self.out.write_all(&time.to_be_bytes())?;
        self.out.write_all(frame)?;
        if now >= self.flush_due {
            self.flush_due = now + FLUSH_INTERVAL;
            self.out.flush()?;
        }
        Ok(())
    }

    /// Writes out what is still buffered.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Returns the underlying writer.
    pub fn into_inner(self) -> W {
        self.out
    }
}

/// Returns the wall clock, microseconds since 1970.
pub fn wall_clock_us() -> u64 {
    std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |since| since.as_micros() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_big_endian_time_and_the_frame() {
        let mut log = TlogWriter::new(Vec::new(), 0x0102_0304_0000_0000);
        log.record(Instant::from_micros(0x0506_0708), b"\xFDframe")
            .unwrap();
        assert_eq!(
            log.into_inner(),
            b"\x01\x02\x03\x04\x05\x06\x07\x08\xFDframe"
        );
    }
}
