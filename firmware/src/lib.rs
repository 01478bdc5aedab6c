//! The onboard controller as a bare-metal image.
//!
//! All that decides lives in `firmware-core`. Here is what a board adds:
//!
//! | room | what it owns |
//! |---|---|
//! | [`board`] | one small trait, and a folder for each board: serial lines, timer, watchdog |
//! | [`flight`] | the loop: an order over the console, then slot after slot |
//! | [`trained`] | the two kinds of trained policies, and their memory |
//! | [`planner`] | the planner's memory |
//!
//! No allocator, no operating system, no `static mut`. docs/target.md says how to build it, what
//! it costs, and what another board takes.
#![no_std]

pub mod board;
pub mod flight;
pub mod planner;
pub mod trained;

/// A file in flash, shifted so that its end lies on the boundary of a word (build.rs).
macro_rules! in_flash {
    ($file:literal, $shift:literal) => {{
        const SHIFT: usize = include!(concat!(env!("OUT_DIR"), "/", $shift));
        const FILE: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/", $file));
        static FLASH: Aligned<[u8; SHIFT + FILE.len()]> = Aligned(shifted(FILE));
        FLASH.0.split_at(SHIFT).1
    }};
}

/// The policy for one mission. Its numbers lie on the boundaries of words.
pub static ONE_MISSION_POLICY: &[u8] = in_flash!("one_mission.policy", "one_mission.shift");

/// The policy for any mission. Its weights lie on the boundaries of half words.
pub static ANY_MISSION_POLICY: &[u8] = in_flash!("any_mission.policy", "any_mission.shift");

#[repr(align(4))]
struct Aligned<T>(T);

/// `bytes` at the end of a longer array.
const fn shifted<const L: usize>(bytes: &[u8]) -> [u8; L] {
    let mut shifted = [0; L];
    shifted
        .split_at_mut(L - bytes.len())
        .1
        .copy_from_slice(bytes);
    shifted
}
