//! How much stack was ever in use: paint below the stack pointer, and see what is left of it.
#![allow(unsafe_code)]

use core::ptr::{addr_of, read_volatile, write_volatile};

const PAINT: u32 = 0xC0DE_57AC;
/// The painter's own frames.
const SPARED: usize = 256;

unsafe extern "C" {
    /// The linker script's: the end of .bss and .uninit, to where the stack may grow.
    static __sheap: u32;
    /// Where the stack begins.
    static _stack_start: u32;
}

fn bounds() -> (usize, usize) {
    // Only the addresses are taken; nothing is read through these symbols.
    (addr_of!(__sheap) as usize, addr_of!(_stack_start) as usize)
}

/// Paints what is free. At most 64 KiB, which is far more than is ever used.
#[inline(never)]
pub(super) fn paint() {
    let here = cortex_m::register::msp::read() as usize;
    let (low, _) = bounds();
    let from = low.max(here.saturating_sub(64 * 1024));
    for address in (from..here - SPARED).step_by(4) {
        // SAFETY: between the end of all statics and the stack's pointer, with room for our own
        // frame: nobody's memory, aligned, and interrupts only write below the pointer while they
        // run, which paint cannot hurt because it is written before any is enabled.
        unsafe { write_volatile(address as *mut u32, PAINT) };
    }
}

/// The most that was in use since, bytes.
pub(super) fn high_water_bytes() -> u32 {
    let here = cortex_m::register::msp::read() as usize;
    let (low, top) = bounds();
    let from = low.max(top.saturating_sub(64 * 1024));
    let untouched = (from..here)
        .step_by(4)
        // SAFETY: RAM between the statics and the stack's pointer: readable and aligned.
        .skip_while(|&address| unsafe { read_volatile(address as *const u32) } != PAINT)
        .find(|&address| {
            // SAFETY: as above.
            unsafe { read_volatile(address as *const u32) != PAINT }
        });
    (top - untouched.unwrap_or(here)) as u32
}
