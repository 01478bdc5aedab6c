//! MAVLink 2 on the wire: bytes to messages and back, without allocation.
//!
//! [`Decoder`] takes bytes as they come, in pieces of any size, and yields whole frames whose
//! checksum is right. Whatever else arrives (noise, half frames, MAVLink 1, dialects unknown
//! here) is skipped and counted in [`Counters`]; it never ends the stream. On a datagram link
//! the caller marks the end of each datagram with [`Decoder::end_of_datagram`], so that a
//! truncated one cannot hold back the frames after it.
//!
//! Messages are those of MAVLink's `common` dialect plus one: ArduPilot reports its position
//! estimate in EKF_STATUS_REPORT (193), which `common` does not have. Its flags carry the bits
//! of ESTIMATOR_STATUS (230), so it is read as that message and the client knows one form only.

mod client;
mod encoder;
pub mod signing;

use mavlink::dialects::common::{
    ESTIMATOR_STATUS_DATA, EstimatorStatusFlags, MavMessage, STATUSTEXT_DATA,
};
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, Message, calculate_crc};
use serde::{Deserialize, Serialize};

use crate::link::status::count;
pub use encoder::{Encoder, FrameBuffer};
use signing::{Verdict, Verifier};

/// First byte of a MAVLink 2 frame.
const START: u8 = 0xFD;
/// Bytes before the payload, the start byte included.
const HEADER: usize = 10;
/// Bytes of the checksum behind the payload.
const CHECKSUM: usize = 2;
/// Bytes of the signature behind the checksum, where the frame has one.
const SIGNATURE: usize = 13;
/// Incompatibility flag of a signed frame; frames with any other flag must be dropped.
const SIGNED: u8 = 0x01;
/// The longest frame: header, 255 bytes of payload, checksum, signature.
pub const MAX_FRAME: usize = HEADER + 255 + CHECKSUM + SIGNATURE;

/// ArduPilot's EKF_STATUS_REPORT: id, CRC seed, and offset of its flags (u16) in the payload.
const EKF_STATUS_REPORT: (u32, u8, usize) = (193, 71, 20);

/// Who sends or is meant: a system (vehicle, ground station) and a component in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Address {
    /// System id, 1 to 255; 0 addresses everyone.
    pub system: u8,
    /// Component id, 1 to 255; 0 addresses every component of the system.
    pub component: u8,
}

/// What went by, for the log and for judging a link. Counters stay at their largest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Frames whose checksum was right.
    pub frames: u32,
    /// Candidates whose checksum was wrong.
    pub bad_checksum: u32,
    /// Frames of a message that is not in the dialect; their checksum cannot be judged.
    pub unknown_message: u32,
    /// Frames with an incompatibility flag that is not known here.
    pub unknown_flags: u32,
    /// Bytes that belonged to no frame.
    pub skipped_bytes: u32,
    /// Good frames that came twice or after a later one of the same sender, and were dropped
    /// ([`Decoder::in_order`]).
    pub out_of_order: u32,
    /// Good frames without a signature where one is required.
    pub unsigned: u32,
    /// Good frames with a wrong signature.
    pub bad_signature: u32,
    /// Rightly signed frames that are too old: a recording.
    pub replayed: u32,
}

impl Counters {
    /// Good frames that were refused for their signature, or for having none.
    pub fn refused(&self) -> u32 {
        [self.unsigned, self.bad_signature, self.replayed]
            .into_iter()
            .fold(0, u32::saturating_add)
    }
}

/// One checked frame, still as bytes.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    bytes: &'a [u8],
}

impl<'a> Frame<'a> {
    /// The frame as it came, start byte to checksum or signature.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Who sent it.
    pub fn sender(&self) -> Address {
        Address {
            system: self.bytes[5],
            component: self.bytes[6],
        }
    }

    /// The sender's running number, modulo 256.
    pub fn sequence(&self) -> u8 {
        self.bytes[4]
    }

    /// Message id.
    pub fn message_id(&self) -> u32 {
        message_id(self.bytes)
    }

    /// Whether it carries a signature (right or wrong).
    pub fn is_signed(&self) -> bool {
        self.bytes[2] & SIGNED != 0
    }

    fn payload(&self) -> &'a [u8] {
        &self.bytes[HEADER..HEADER + usize::from(self.bytes[1])]
    }

    /// The message in it, if it is one that [`Autopilot`](super::Autopilot) takes. Where nothing
    /// else is called, the reading of all other messages, some 250 kB of code, stays out of a
    /// target's flash.
    ///
    /// # Errors
    /// As [`message`](Self::message).
    pub fn client_message(&self) -> Result<Option<MavMessage>, ParserError> {
        if self.message_id() == EKF_STATUS_REPORT.0 {
            return Ok(Some(self.ekf_status_report()));
        }
        client::parse(self.message_id(), self.payload())
    }

    /// The message in it. An error is a value outside an enumeration: log it and go on.
    pub fn message(&self) -> Result<MavMessage, ParserError> {
        if self.message_id() == EKF_STATUS_REPORT.0 {
            return Ok(self.ekf_status_report());
        }
        MavMessage::parse(MavlinkVersion::V2, self.message_id(), self.payload())
    }

    /// ArduPilot's report in the standard's form.
    fn ekf_status_report(&self) -> MavMessage {
        let (_, _, offset) = EKF_STATUS_REPORT;
        // Trailing zeros are not sent, so the flags can be cut off.
        let byte = |i: usize| self.payload().get(offset + i).copied().unwrap_or(0);
        let flags = u16::from_le_bytes([byte(0), byte(1)]);
        MavMessage::ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA {
            flags: EstimatorStatusFlags::from_bits_retain(flags),
            ..ESTIMATOR_STATUS_DATA::DEFAULT
        })
    }
}

fn message_id(frame: &[u8]) -> u32 {
    u32::from_le_bytes([frame[7], frame[8], frame[9], 0])
}

/// CRC seed of a known message.
fn checksum_seed(id: u32) -> Option<u8> {
    if id == EKF_STATUS_REPORT.0 {
        return Some(EKF_STATUS_REPORT.1);
    }
    // The crate answers 0 for unknown ids, too. Asking it for the message itself would take every
    // message's defaults into a target's flash.
    let seed = MavMessage::extra_crc(id);
    (seed != 0 || id == SEED_ZERO).then_some(seed)
}

/// The only message whose seed is 0 (a test holds it): COMPONENT_INFORMATION.
const SEED_ZERO: u32 = 395;

/// Senders whose running numbers are followed.
const SENDERS: usize = 8;
/// A running number behind the last one by no more than this is late; further behind, the
/// sender has started anew or many frames were lost.
const LATE: u8 = 32;

/// The last running number of each sender. A heartbeat has no time in it: one that was
/// overtaken on the way would bring back a mode that is over.
#[derive(Clone, Copy, Debug, Default)]
struct Newest {
    last: [Option<(Address, u8)>; SENDERS],
    next: usize,
}

impl Newest {
    /// Notes a frame; true if it is a duplicate or was overtaken.
    fn is_late(&mut self, sender: Address, sequence: u8) -> bool {
        for (known, last) in self.last.iter_mut().flatten() {
            if *known == sender {
                let late = last.wrapping_sub(sequence) <= LATE;
                if !late {
                    *last = sequence;
                }
                return late;
            }
        }
        self.last[self.next] = Some((sender, sequence));
        self.next = (self.next + 1) % SENDERS;
        false
    }
}

/// Bytes in, frames out.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_FRAME],
    /// Bytes held.
    length: usize,
    /// Bytes at the front that were yielded or refused and go with the next call.
    spent: usize,
    counters: Counters,
    newest: Option<Newest>,
    verifier: Option<Verifier>,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// What the bytes at the front of the buffer are.
enum Candidate {
    /// Too short to tell.
    Incomplete,
    /// A good frame of this length.
    Frame(usize),
    /// Not a frame: drop this many bytes.
    Drop(usize),
}

impl Decoder {
    /// An empty decoder.
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME],
            length: 0,
            spent: 0,
            counters: Counters {
                frames: 0,
                bad_checksum: 0,
                unknown_message: 0,
                unknown_flags: 0,
                skipped_bytes: 0,
                out_of_order: 0,
                unsigned: 0,
                bad_signature: 0,
                replayed: 0,
            },
            newest: None,
            verifier: None,
        }
    }

    /// An empty decoder that drops frames which come twice, or after a later frame of the same
    /// sender: for whoever judges a vehicle's state by them.
    pub const fn in_order() -> Self {
        let mut decoder = Self::new();
        decoder.newest = Some(Newest {
            last: [None; SENDERS],
            next: 0,
        });
        decoder
    }

    /// Takes only frames that are rightly signed, from now on.
    pub fn require_signatures(&mut self, verifier: Verifier) {
        self.verifier = Some(verifier);
    }

    /// What checks signatures, to set its clock.
    pub fn verifier_mut(&mut self) -> Option<&mut Verifier> {
        self.verifier.as_mut()
    }

    /// What went by so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Takes bytes from the front of `input` until a frame is whole; `None` when the input
    /// is used up. Call until `None`. Each input byte is looked at a bounded number of times
    /// (at most the length of a frame, in noise made of start bytes).
    pub fn next_frame(&mut self, input: &mut &[u8]) -> Option<Frame<'_>> {
        loop {
            self.discard_spent();
            match self.candidate() {
                Candidate::Frame(length) => {
                    count(&mut self.counters.frames);
                    self.spent = length;
                    return Some(Frame {
                        bytes: &self.buffer[..length],
                    });
                }
                Candidate::Drop(count) => self.spent = count,
                Candidate::Incomplete => {
                    let count = input.len().min(MAX_FRAME - self.length);
                    if count == 0 {
                        return None;
                    }
                    let (head, tail) = input.split_at(count);
                    self.buffer[self.length..self.length + count].copy_from_slice(head);
                    self.length += count;
                    *input = tail;
                }
            }
        }
    }

    /// The datagram is over: what is still held can no longer become whole. Yields the frames
    /// that hide in it (behind a false start); call until `None`.
    pub fn end_of_datagram(&mut self) -> Option<Frame<'_>> {
        loop {
            self.discard_spent();
            if self.length == 0 {
                return None;
            }
            match self.candidate() {
                Candidate::Frame(length) => {
                    count(&mut self.counters.frames);
                    self.spent = length;
                    return Some(Frame {
                        bytes: &self.buffer[..length],
                    });
                }
                Candidate::Drop(count) => self.spent = count,
                Candidate::Incomplete => {
                    count(&mut self.counters.skipped_bytes);
                    self.spent = 1;
                }
            }
        }
    }

    fn discard_spent(&mut self) {
        let spent = core::mem::take(&mut self.spent);
        if spent > 0 {
            self.buffer.copy_within(spent..self.length, 0);
            self.length -= spent;
        }
    }

    fn candidate(&mut self) -> Candidate {
        let held = &self.buffer[..self.length];
        if held.is_empty() {
            return Candidate::Incomplete;
        }
        if held[0] != START {
            let noise = held.iter().position(|&b| b == START).unwrap_or(held.len());
            self.counters.skipped_bytes = self.counters.skipped_bytes.saturating_add(noise as u32);
            return Candidate::Drop(noise);
        }
        if held.len() < HEADER {
            return Candidate::Incomplete;
        }
        let flags = held[2];
        if flags & !SIGNED != 0 {
            count(&mut self.counters.unknown_flags);
            return Candidate::Drop(1);
        }
        let unsigned = HEADER + usize::from(held[1]) + CHECKSUM;
        let whole = unsigned + if flags & SIGNED != 0 { SIGNATURE } else { 0 };
        if held.len() < whole {
            return Candidate::Incomplete;
        }
        let Some(seed) = checksum_seed(message_id(held)) else {
            // Autopilots send many messages of their own dialects: step over the whole of it.
            count(&mut self.counters.unknown_message);
            return Candidate::Drop(whole);
        };
        let checksum = u16::from_le_bytes([held[unsigned - 2], held[unsigned - 1]]);
        if checksum == calculate_crc(&held[1..unsigned - CHECKSUM], seed) {
            let frame = Frame {
                bytes: &held[..whole],
            };
            if let Some(verifier) = &mut self.verifier {
                let refused = match verifier.judge(&frame) {
                    Verdict::Good => None,
                    Verdict::Unsigned => Some(&mut self.counters.unsigned),
                    Verdict::Wrong => Some(&mut self.counters.bad_signature),
                    Verdict::Replayed => Some(&mut self.counters.replayed),
                };
                if let Some(counter) = refused {
                    count(counter);
                    return Candidate::Drop(whole);
                }
            }
            if let Some(newest) = &mut self.newest
                && newest.is_late(frame.sender(), frame.sequence())
            {
                count(&mut self.counters.out_of_order);
                return Candidate::Drop(whole);
            }
            Candidate::Frame(whole)
        } else {
            // The start byte may have been payload: look for the next one inside.
            count(&mut self.counters.bad_checksum);
            Candidate::Drop(1)
        }
    }
}

/// The readable part of a STATUSTEXT: up to the first NUL, other bytes than printable ASCII
/// as `?`. At most 50 characters.
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

#[cfg(test)]
mod tests;
