//! 100 sensors, but a decoder whose frames are long enough for 64 only.
use firmware_core::link::Decoder;

fn main() {
    let mut decoder: Decoder = Decoder::new();
    decoder.push::<f64, 16, 100>(0);
}
