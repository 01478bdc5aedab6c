//! Arm's CMSDK watchdog: counts down, warns by NMI, and at the next zero resets the board.

use super::register::Register;

const LOAD: Register = Register::new(0x4000_8000);
const CONTROL: Register = Register::new(0x4000_8008);
const CLEAR: Register = Register::new(0x4000_800C);
const LOCK: Register = Register::new(0x4000_8C00);
const KEY: u32 = 0x1ACC_E551;
/// Count, warn and reset.
const RUN: u32 = 0b11;

/// The board's watchdog. Its registers stay locked but for the moment of a feeding.
#[derive(Debug)]
pub(super) struct Watchdog {
    running: bool,
}

impl Watchdog {
    pub(super) const fn new() -> Self {
        Self { running: false }
    }

    /// So many cycles from now on.
    pub(super) fn feed(&mut self, cycles: u32) {
        LOCK.write(KEY);
        LOAD.write(cycles);
        CLEAR.write(1);
        CONTROL.write(RUN);
        LOCK.write(0);
        self.running = true;
    }

    pub(super) fn stop(&mut self) {
        if self.running {
            LOCK.write(KEY);
            CONTROL.write(0);
            LOCK.write(0);
            self.running = false;
        }
    }
}
