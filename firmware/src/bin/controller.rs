//! The image that flies.
#![no_std]
#![no_main]

use firmware::{TRAINED, board::mps2::Mps2, flight};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut board) = Mps2::take() else {
        // Nobody else runs before this.
        unreachable!("the board is taken once");
    };
    flight::run(&mut board, TRAINED)
}
