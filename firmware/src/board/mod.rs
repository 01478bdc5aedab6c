//! What the controller asks of a board.
//!
//! Another board is another folder here: three serial lines with interrupts, a timer of a
//! microsecond or finer, a watchdog. docs/target.md goes through it for an STM32H7.

pub mod mps2;
mod stack;

use firmware_core::time::{Duration, Instant};

/// The serial lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Channel state in, slot commands out.
    Ground,
    /// The autopilot.
    Mavlink,
    /// Orders in, reports out; a bench's clock.
    Console,
}

/// A board, as the controller sees it. Nothing here waits.
pub trait Board {
    /// Takes what came on a line, as much as fits: how many bytes.
    fn receive(&mut self, line: Line, buffer: &mut [u8]) -> usize;

    /// Queues a frame. Where there is no room for all of it, it is dropped whole, counted, and
    /// the answer is false.
    fn send(&mut self, line: Line, frame: &[u8]) -> bool;

    /// The board's own clock. Asked at least once a minute.
    fn now(&mut self) -> Instant;

    /// A counter of [`NANOS_PER_CYCLE`](Self::NANOS_PER_CYCLE) that wraps around: to measure with.
    fn cycles(&self) -> u32;

    /// What a step of [`cycles`](Self::cycles) is worth, nanoseconds.
    const NANOS_PER_CYCLE: u32;

    /// The longest that [`watch`](Self::watch) can be told; a mission with longer slots is refused.
    const LONGEST_WATCH: Duration;

    /// The controller is given so long until it says so again; after that the board stops it.
    /// `None`: as long as it likes.
    fn watch(&mut self, patience: Option<Duration>);

    /// Rests until a byte comes, or for 10 ms if `ticking`; not at all if one is there already.
    fn rest(&mut self, ticking: bool);

    /// The most stack that was ever in use, bytes.
    fn stack_bytes(&self) -> u32;

    /// Bytes that came and had no room, and frames that had none.
    fn losses(&self) -> (u32, u32);

    /// Sends what is queued, says why on the console, and stops for good: the vehicle is left to
    /// its own failsafe.
    fn halt(&mut self, why: &dyn core::fmt::Display) -> !;
}
