//! The length of a frame with more users and sensors than a slot command can count.
use firmware_core::link::secure_frame_max;

static FRAME: [u8; secure_frame_max::<f32>(40_000, 40_000)] = [0; secure_frame_max::<f32>(40_000, 40_000)];

fn main() {
    std::hint::black_box(&FRAME);
}
