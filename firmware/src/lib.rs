//! The onboard controller as a bare-metal image.
//!
//! All that decides lives in `firmware-core`. Here is what a board adds:
//!
//! | room | what it owns |
//! |---|---|
//! | [`board`] | one small trait, and a folder for each board: serial lines, timer, watchdog |
//! | [`flight`] | the loop: an order over the console, then slot after slot |
//! | [`planner`] | the planner's memory |
//!
//! No allocator, no operating system, no `static mut`. docs/target.md says how to build it, what
//! it costs, and what another board takes.
#![no_std]

pub mod board;
pub mod flight;
pub mod planner;

/// The trained policy, as it lies in flash: shifted so that its numbers lie on the boundaries of
/// words (build.rs).
pub static TRAINED: &[u8] = {
    const SHIFT: usize = include!(concat!(env!("OUT_DIR"), "/shift.rs"));
    static FLASH: Aligned<
        [u8; SHIFT + include_bytes!(concat!(env!("OUT_DIR"), "/trained.policy")).len()],
    > = Aligned(shifted(include_bytes!(concat!(
        env!("OUT_DIR"),
        "/trained.policy"
    ))));
    FLASH.0.split_at(SHIFT).1
};

#[repr(align(4))]
struct Aligned<T>(T);

/// `bytes` at the end of a longer array.
const fn shifted<const N: usize, const L: usize>(bytes: &[u8; N]) -> [u8; L] {
    let mut shifted = [0; L];
    shifted.split_at_mut(L - N).1.copy_from_slice(bytes);
    shifted
}
