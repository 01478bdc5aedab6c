//! Arm's MPS2 board with a Cortex-M7 (AN500), as QEMU models it: `-M mps2-an500`.
//!
//! | what | where | interrupts |
//! |---|---|---|
//! | ground link | UART0, 0x4000_4000 | 0 in, 1 out |
//! | MAVLink | UART1, 0x4000_5000 | 2 in, 3 out |
//! | console | UART2, 0x4000_6000 | 4 in, 5 out |
//! | clock | TIMER0, 0x4000_0000, 25 MHz | |
//! | watchdog | 0x4000_8000, 25 MHz | NMI, then reset |
#![allow(unsafe_code)]

mod register;
mod uart;
mod watchdog;

use core::{fmt::Display, panic::PanicInfo};

use cortex_m::peripheral::{Peripherals, SYST, syst::SystClkSource};
use cortex_m_rt::exception;
use cortex_m_semihosting::{debug, hprintln};
use firmware_core::{
    console::{self, BoardReport, REPORT_FRAME_MAX},
    time::{Duration, Instant},
};

use super::{Board, Line, stack};
use register::Register;
use uart::{Irq, Uart};
use watchdog::Watchdog;

const CLOCK_HZ: u32 = 25_000_000;

static GROUND: Uart = Uart::new(0x4000_4000);
static MAVLINK: Uart = Uart::new(0x4000_5000);
static CONSOLE: Uart = Uart::new(0x4000_6000);
static LINES: [&Uart; 3] = [&GROUND, &MAVLINK, &CONSOLE];

/// A counter from 2^32 - 1 down, without interrupts.
const TIMER_CONTROL: Register = Register::new(0x4000_0000);
const TIMER_VALUE: Register = Register::new(0x4000_0004);
const TIMER_RELOAD: Register = Register::new(0x4000_0008);

/// The board. There is one.
#[allow(missing_debug_implementations)] // a peripheral has none
pub struct Mps2 {
    tick: SYST,
    ticking: bool,
    watchdog: Watchdog,
    /// Cycles up to `seen`.
    passed: u64,
    seen: u32,
}

impl Mps2 {
    /// Sets everything up; `None` the second time.
    pub fn take() -> Option<Self> {
        let peripherals = Peripherals::take()?;
        stack::paint();
        TIMER_RELOAD.write(u32::MAX);
        TIMER_VALUE.write(u32::MAX);
        TIMER_CONTROL.write(1);
        for line in LINES {
            line.enable();
        }
        for irq in 0..2 * LINES.len() as u16 {
            // SAFETY: the handler below is linked in and takes these interrupts; no critical
            // section relies on their being masked.
            unsafe { cortex_m::peripheral::NVIC::unmask(Irq(irq)) };
        }
        let mut board = Self {
            tick: peripherals.SYST,
            ticking: false,
            watchdog: Watchdog::new(),
            passed: 0,
            seen: 0,
        };
        board.seen = board.cycles();
        Some(board)
    }

    fn line(line: Line) -> &'static Uart {
        match line {
            Line::Ground => &GROUND,
            Line::Mavlink => &MAVLINK,
            Line::Console => &CONSOLE,
        }
    }
}

impl Board for Mps2 {
    const NANOS_PER_CYCLE: u32 = 1_000_000_000 / CLOCK_HZ;
    // The watchdog counts 2^32 - 1 cycles at most.
    const LONGEST_WATCH: Duration = Duration::from_secs((u32::MAX / CLOCK_HZ) as u64);

    fn receive(&mut self, line: Line, buffer: &mut [u8]) -> usize {
        Self::line(line).take(buffer)
    }

    fn send(&mut self, line: Line, frame: &[u8]) -> bool {
        Self::line(line).queue(frame)
    }

    fn now(&mut self) -> Instant {
        let cycles = self.cycles();
        self.passed += u64::from(cycles.wrapping_sub(self.seen));
        self.seen = cycles;
        Instant::from_micros(self.passed / u64::from(CLOCK_HZ / 1_000_000))
    }

    fn cycles(&self) -> u32 {
        u32::MAX - TIMER_VALUE.read()
    }

    fn watch(&mut self, patience: Option<Duration>) {
        match patience {
            Some(patience) => {
                let micros = patience.min(Self::LONGEST_WATCH).as_micros();
                let cycles = micros * u64::from(CLOCK_HZ / 1_000_000);
                self.watchdog
                    .feed(u32::try_from(cycles).unwrap_or(u32::MAX));
            }
            None => self.watchdog.stop(),
        }
    }

    fn rest(&mut self, ticking: bool) {
        if ticking && !self.ticking {
            self.tick.set_clock_source(SystClkSource::Core);
            self.tick.set_reload(CLOCK_HZ / 100 - 1);
            self.tick.clear_current();
            self.tick.enable_counter();
            self.tick.enable_interrupt();
            self.ticking = true;
        }
        // An interrupt that comes between the look and the rest stays pending, and ends the rest.
        critical_section::with(|_| {
            if LINES.iter().all(|line| line.is_idle()) {
                cortex_m::asm::wfi();
            }
        });
    }

    fn stack_bytes(&self) -> u32 {
        stack::high_water_bytes()
    }

    fn losses(&self) -> (u32, u32) {
        LINES.iter().fold((0, 0), |(bytes, frames), line| {
            let (lost, unsent) = line.losses();
            (bytes.wrapping_add(lost), frames.wrapping_add(unsent))
        })
    }

    fn halt(&mut self, why: &dyn Display) -> ! {
        self.watchdog.stop();
        // What was queued before is still to be heard: a STATUSTEXT may say why, too. Without
        // interrupts nothing would send it. (Not after a panic, which may hold a queue.)
        for line in LINES {
            line.drain();
        }
        last_words(&why)
    }
}

/// The last thing that an image does: tells the console why, by hand, and stops. What stops with
/// it are the setpoints, on which the autopilot's own failsafe acts.
fn last_words(why: &dyn Display) -> ! {
    cortex_m::interrupt::disable();
    let report = BoardReport::Aborted(console::words(&why));
    let mut frame = [0; REPORT_FRAME_MAX];
    if let Ok(frame) = console::encode_report(&report, &mut frame) {
        CONSOLE.write_by_hand(frame);
    }
    // QEMU is told, too; a board without a debugger must not do this.
    hprintln!("{}", why);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::wfi();
    }
}

/// Ends QEMU as a success: a bench is through.
pub fn succeed() -> ! {
    debug::exit(debug::EXIT_SUCCESS);
    loop {
        cortex_m::asm::wfi();
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    last_words(&info)
}

/// Bytes in, bytes out.
#[exception]
// SAFETY: `exception` asks for this signature; the handler shares nothing but the lines, which
// are behind critical sections.
unsafe fn DefaultHandler(irq: i16) {
    let Some(line) = usize::try_from(irq).ok().and_then(|irq| LINES.get(irq / 2)) else {
        last_words(&format_args!("unexpected interrupt {irq}"));
    };
    if irq % 2 == 0 {
        line.byte_came();
    } else {
        line.byte_left();
    }
}

#[exception]
fn SysTick() {
    // Only ends a rest.
}

/// The watchdog's first warning; its second is a reset.
#[exception]
// SAFETY: as above.
unsafe fn NonMaskableInt() -> ! {
    last_words(&"watchdog: a slot took too long")
}

#[exception]
// SAFETY: as above.
unsafe fn HardFault(frame: &cortex_m_rt::ExceptionFrame) -> ! {
    last_words(&format_args!("hard fault at {:#010x}", frame.pc()))
}
