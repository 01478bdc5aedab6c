//! The image that flies, with a policy for one mission in flash.
#![no_std]
#![no_main]

use firmware::{ONE_MISSION_POLICY, board::mps2::Mps2, flight, trained::OneMission};

#[cortex_m_rt::entry]
fn main() -> ! {
    let Some(mut board) = Mps2::take() else {
        // Nobody else runs before this.
        unreachable!("the board is taken once");
    };
    flight::run::<OneMission, _>(&mut board, ONE_MISSION_POLICY)
}
