//! 66 sensors, but an end of the ground link whose frames are long enough for 64 only.
use firmware_core::link::Endpoint;

fn main() {
    let mut end: Endpoint = Endpoint::new();
    end.push::<f64, 16, 66>(0);
}
