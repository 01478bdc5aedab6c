//! `.tlog`: the MAVLink log that ground stations and pymavlink read.
//!
//! Each record is the time as 8 bytes, microseconds since 1970, big-endian, and then the frame
//! as it went over the link.

use std::io::{self, Write};

use firmware_core::time::{Duration, Instant};

/// Where simulated time begins, so that the log of a simulated run depends on nothing else:
/// 2026-01-01 00:00 UTC, microseconds since 1970.
pub const SIMULATED_EPOCH_US: u64 = 1_767_225_600_000_000;

/// Writes records.
#[derive(Debug)]
pub struct TlogWriter<W> {
    out: W,
    epoch_us: u64,
    /// When what is held back is written out next.
    flush_due: Instant,
}

/// How much of a log a process that is killed may lose.
const FLUSH_INTERVAL: Duration = Duration::from_secs(1);

impl<W: Write> TlogWriter<W> {
    /// A log whose time begins at `epoch_us`: [`SIMULATED_EPOCH_US`], or the wall clock when
    /// the run began.
    pub fn new(out: W, epoch_us: u64) -> Self {
        Self {
            out,
            epoch_us,
            flush_due: Instant::ZERO,
        }
    }

    /// Appends a frame that was sent or received at `now`. Once a second of that time the log is
    /// written out, so that a process that is killed leaves one.
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

    /// Writes out what is still held back.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// What was written to.
    pub fn into_inner(self) -> W {
        self.out
    }
}

/// The wall clock, microseconds since 1970.
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
