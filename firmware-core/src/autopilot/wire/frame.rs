// SPDX-License-Identifier: MIT OR Apache-2.0
//! A checked frame and the address of its sender.

use mavlink::dialects::common::{
    ESTIMATOR_STATUS_DATA, EstimatorStatusFlags, MavMessage, STATUSTEXT_DATA,
};
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, Message};
use serde::{Deserialize, Serialize};

use super::client;
use super::layout::{self, HEADER, SIGNED, ekf_status_report, field};

/// The address of a sender or receiver: a system (vehicle, ground station) and a component in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Address {
    /// System id, 1 to 255; 0 addresses every system.
    pub system: u8,
    /// Component id, 1 to 255; 0 addresses every component of the system.
    pub component: u8,
}

/// One checked frame, still as bytes.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    bytes: &'a [u8],
    header: &'a [u8; HEADER],
    payload: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Wraps bytes that form a whole frame; `None` if they are too few.
    pub(super) fn new(bytes: &'a [u8]) -> Option<Self> {
        let header = bytes.first_chunk()?;
        let payload = bytes.get(field::payload(header[field::LENGTH].into()))?;
        Some(Self {
            bytes,
            header,
            payload,
        })
    }

    /// Returns the frame as it was received, from the start byte to the checksum or signature.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Returns the address of the sender.
    pub fn sender(&self) -> Address {
        Address {
            system: self.header[field::SYSTEM],
            component: self.header[field::COMPONENT],
        }
    }

    /// Returns the sender's sequence number, modulo 256.
    pub fn sequence(&self) -> u8 {
        self.header[field::SEQUENCE]
    }

    /// Returns the message id.
    pub fn message_id(&self) -> u32 {
        layout::message_id(self.header)
    }

    /// Returns whether the frame carries a signature, valid or not.
    pub fn is_signed(&self) -> bool {
        self.header[field::INCOMPATIBILITY_FLAGS] & SIGNED != 0
    }

    /// Returns the message in the frame, or `None` if it is not one that
    /// [`Autopilot`](crate::autopilot::Autopilot) takes. A program that calls only this function
    /// does not contain the parsers of all other messages, some 250 kB of code.
    ///
    /// # Errors
    /// As [`message`](Self::message).
    pub fn client_message(&self) -> Result<Option<MavMessage>, ParserError> {
        if self.message_id() == ekf_status_report::ID {
            return Ok(Some(self.ekf_status_report()));
        }
        client::parse(self.message_id(), self.payload)
    }

    /// Returns the message in the frame.
    ///
    /// # Errors
    /// Returns an error for a value outside an enumeration. The stream can be read on after it.
    pub fn message(&self) -> Result<MavMessage, ParserError> {
        if self.message_id() == ekf_status_report::ID {
            return Ok(self.ekf_status_report());
        }
        MavMessage::parse(MavlinkVersion::V2, self.message_id(), self.payload)
    }

    /// Returns ArduPilot's report in the form of the `common` dialect.
    fn ekf_status_report(&self) -> MavMessage {
        // Trailing zeros are not sent, so the flags can be cut off.
        let mut flags = [0; ekf_status_report::FLAGS.end - ekf_status_report::FLAGS.start];
        let sent = self.payload.get(ekf_status_report::FLAGS.start..);
        for (flag, &byte) in flags.iter_mut().zip(sent.unwrap_or_default()) {
            *flag = byte;
        }
        let flags = u16::from_le_bytes(flags);
        MavMessage::ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA {
            flags: EstimatorStatusFlags::from_bits_retain(flags),
            ..ESTIMATOR_STATUS_DATA::DEFAULT
        })
    }
}

/// Returns the readable part of a STATUSTEXT: the bytes up to the first NUL, with `?` for every
/// byte that is not printable ASCII. At most 50 characters.
pub fn status_text(message: &STATUSTEXT_DATA) -> heapless::String<50> {
    let mut text = heapless::String::new();
    for &byte in message.text.iter().take_while(|&&b| b != 0) {
        let shown = match byte {
            b' '..=b'~' => char::from(byte),
            _ => '?',
        };
        // One ASCII character per byte: 50 always fit.
        let _ = text.push(shown);
    }
    text
}
