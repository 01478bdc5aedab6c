//! Arm's CMSDK UART, driven by interrupts, with a queue in each direction.
#![allow(unsafe_code)]

use core::cell::RefCell;

use cortex_m::interrupt::InterruptNumber;
use critical_section::Mutex;
use heapless::Deque;

use super::register::Register;

/// Bytes that may wait, in each direction.
const QUEUE: usize = 1024;

const TX_FULL: u32 = 1 << 0;
const RX_FULL: u32 = 1 << 1;
/// Both directions, with an interrupt each.
const ENABLE: u32 = 0b1111;
const TX_INTERRUPT: u32 = 1 << 0;
const RX_INTERRUPT: u32 = 1 << 1;

/// The number of an interrupt.
#[derive(Clone, Copy, Debug)]
pub(super) struct Irq(pub(super) u16);

// SAFETY: the numbers are those of the board, and stay the same.
unsafe impl InterruptNumber for Irq {
    fn number(self) -> u16 {
        self.0
    }
}

#[derive(Debug)]
struct Queues {
    came: Deque<u8, QUEUE>,
    to_send: Deque<u8, QUEUE>,
    /// A byte is on its way out; an interrupt will ask for the next.
    sending: bool,
    lost_bytes: u32,
    unsent_frames: u32,
}

/// One of the board's UARTs.
#[derive(Debug)]
pub(super) struct Uart {
    data: Register,
    state: Register,
    control: Register,
    interrupts: Register,
    divider: Register,
    queues: Mutex<RefCell<Queues>>,
}

impl Uart {
    pub(super) const fn new(base: usize) -> Self {
        Self {
            data: Register::new(base),
            state: Register::new(base + 0x04),
            control: Register::new(base + 0x08),
            interrupts: Register::new(base + 0x0C),
            divider: Register::new(base + 0x10),
            queues: Mutex::new(RefCell::new(Queues {
                came: Deque::new(),
                to_send: Deque::new(),
                sending: false,
                lost_bytes: 0,
                unsent_frames: 0,
            })),
        }
    }

    /// 25 MHz / 27 = 926 kBd.
    pub(super) fn enable(&self) {
        self.divider.write(27);
        self.control.write(ENABLE);
    }

    fn with<R>(&self, act: impl FnOnce(&mut Queues) -> R) -> R {
        critical_section::with(|section| act(&mut self.queues.borrow_ref_mut(section)))
    }

    /// Interrupt: a byte has come.
    pub(super) fn byte_came(&self) {
        self.interrupts.write(RX_INTERRUPT);
        self.with(|queues| {
            while self.state.read() & RX_FULL != 0 {
                let byte = self.data.read() as u8;
                if queues.came.push_back(byte).is_err() {
                    queues.lost_bytes = queues.lost_bytes.wrapping_add(1);
                }
            }
        });
    }

    /// Interrupt: a byte has left.
    pub(super) fn byte_left(&self) {
        self.interrupts.write(TX_INTERRUPT);
        self.with(|queues| self.send_next(queues));
    }

    fn send_next(&self, queues: &mut Queues) {
        queues.sending = false;
        if self.state.read() & TX_FULL == 0
            && let Some(byte) = queues.to_send.pop_front()
        {
            queues.sending = true;
            self.data.write(byte.into());
        }
    }

    /// Takes what came.
    pub(super) fn take(&self, buffer: &mut [u8]) -> usize {
        self.with(|queues| {
            let mut taken = 0;
            for (slot, byte) in buffer
                .iter_mut()
                .zip(core::iter::from_fn(|| queues.came.pop_front()))
            {
                *slot = byte;
                taken += 1;
            }
            taken
        })
    }

    /// Queues all of a frame or nothing.
    pub(super) fn queue(&self, frame: &[u8]) -> bool {
        self.with(|queues| {
            if queues.to_send.capacity() - queues.to_send.len() < frame.len() {
                queues.unsent_frames = queues.unsent_frames.wrapping_add(1);
                return false;
            }
            queues.to_send.extend(frame.iter().copied());
            if !queues.sending {
                self.send_next(queues);
            }
            true
        })
    }

    pub(super) fn is_idle(&self) -> bool {
        self.with(|queues| queues.came.is_empty())
    }

    pub(super) fn losses(&self) -> (u32, u32) {
        self.with(|queues| (queues.lost_bytes, queues.unsent_frames))
    }

    /// Sends all that is queued, waiting for each byte: 11 ms at most.
    pub(super) fn drain(&self) {
        self.with(|queues| {
            while let Some(byte) = queues.to_send.pop_front() {
                self.write_by_hand(&[byte]);
            }
        });
    }

    /// Without interrupts, waiting for each byte: for last words.
    pub(super) fn write_by_hand(&self, bytes: &[u8]) {
        for &byte in bytes {
            while self.state.read() & TX_FULL != 0 {}
            self.data.write(byte.into());
        }
    }
}
