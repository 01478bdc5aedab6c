//! A buffer that is too short for frames to the ground.
use firmware_core::{onboard::Onboard, policy::StraightLine};

type Computer = Onboard<f32, StraightLine<f32, 4>, 4, 8>;

fn send(computer: &mut Computer) {
    computer.take_ground_frame(&mut [0; 100]);
}

fn main() {
    std::hint::black_box(send as fn(_));
}
