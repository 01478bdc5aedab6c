//! The image that flies, with a policy for any mission in flash.
#![no_std]
#![no_main]

use firmware::{ANY_MISSION_POLICY, board::mps2::Mps2, flight, trained::AnyMission};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut board) = Mps2::take() else {
        // Nobody else runs before this.
        unreachable!("the board is taken once");
    };
    flight::run::<AnyMission, _>(&mut board, ANY_MISSION_POLICY)
}
