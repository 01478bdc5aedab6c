//! Bytes of MAVLink to the message of a frame, signatures included.
#![no_std]
#![no_main]

use firmware_core::autopilot::wire::Decoder;
use firmware_core::mavlink::{dialects::common::MavMessage, error::ParserError};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    decoder: &mut Decoder,
    input: &mut &[u8],
    datagram: bool,
) -> Option<Result<Option<MavMessage>, ParserError>> {
    let frame = if datagram {
        decoder.end_of_datagram()
    } else {
        decoder.next_frame(input)
    };
    Some(frame?.client_message())
}
