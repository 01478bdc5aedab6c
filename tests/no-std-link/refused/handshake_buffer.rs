//! A buffer that is shorter than a frame of the handshake.
use firmware_core::link::Endpoint;

fn main() {
    let mut end: Endpoint = Endpoint::new();
    end.take_handshake(&mut [0; 32]);
}
