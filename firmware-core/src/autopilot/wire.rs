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

use mavlink::dialects::common::{
    ESTIMATOR_STATUS_DATA, EstimatorStatusFlags, MavMessage, STATUSTEXT_DATA,
};
use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, Message, calculate_crc};

/// First byte of a MAVLink 2 frame.
const START: u8 = 0xFD;
/// Bytes before the payload, the start byte included.
const HEADER: usize = 10;
/// Bytes of the checksum behind the payload.
const CHECKSUM: usize = 2;
/// Bytes of the signature behind the checksum, where the frame has one.
pub(super) const SIGNATURE: usize = 13;
/// Incompatibility flag of a signed frame; frames with any other flag must be dropped.
pub(super) const SIGNED: u8 = 0x01;
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

/// What went by, for the log and for judging a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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

    /// The message in it. An error is a value outside an enumeration: log it and go on.
    pub fn message(&self) -> Result<MavMessage, ParserError> {
        let (id, _, offset) = EKF_STATUS_REPORT;
        if self.message_id() == id {
            // Trailing zeros are not sent, so the flags can be cut off.
            let byte = |i: usize| self.payload().get(offset + i).copied().unwrap_or(0);
            let flags = u16::from_le_bytes([byte(0), byte(1)]);
            return Ok(MavMessage::ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA {
                flags: EstimatorStatusFlags::from_bits_retain(flags),
                ..ESTIMATOR_STATUS_DATA::DEFAULT
            }));
        }
        MavMessage::parse(MavlinkVersion::V2, self.message_id(), self.payload())
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
    // The crate answers 0 for unknown ids; two known messages could have that seed too.
    let seed = MavMessage::extra_crc(id);
    (seed != 0 || MavMessage::default_message_from_id(id).is_some()).then_some(seed)
}

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
            },
            newest: None,
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
                    self.counters.frames = self.counters.frames.wrapping_add(1);
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
                    self.counters.frames = self.counters.frames.wrapping_add(1);
                    self.spent = length;
                    return Some(Frame {
                        bytes: &self.buffer[..length],
                    });
                }
                Candidate::Drop(count) => self.spent = count,
                Candidate::Incomplete => {
                    self.counters.skipped_bytes = self.counters.skipped_bytes.wrapping_add(1);
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
            self.counters.skipped_bytes = self.counters.skipped_bytes.wrapping_add(noise as u32);
            return Candidate::Drop(noise);
        }
        if held.len() < HEADER {
            return Candidate::Incomplete;
        }
        let flags = held[2];
        if flags & !SIGNED != 0 {
            self.counters.unknown_flags = self.counters.unknown_flags.wrapping_add(1);
            return Candidate::Drop(1);
        }
        let unsigned = HEADER + usize::from(held[1]) + CHECKSUM;
        let whole = unsigned + if flags & SIGNED != 0 { SIGNATURE } else { 0 };
        if held.len() < whole {
            return Candidate::Incomplete;
        }
        let Some(seed) = checksum_seed(message_id(held)) else {
            // Autopilots send many messages of their own dialects: step over the whole of it.
            self.counters.unknown_message = self.counters.unknown_message.wrapping_add(1);
            return Candidate::Drop(whole);
        };
        let checksum = u16::from_le_bytes([held[unsigned - 2], held[unsigned - 1]]);
        if checksum == calculate_crc(&held[1..unsigned - CHECKSUM], seed) {
            let frame = Frame { bytes: held };
            if let Some(newest) = &mut self.newest
                && newest.is_late(frame.sender(), frame.sequence())
            {
                self.counters.out_of_order = self.counters.out_of_order.wrapping_add(1);
                return Candidate::Drop(whole);
            }
            Candidate::Frame(whole)
        } else {
            // The start byte may have been payload: look for the next one inside.
            self.counters.bad_checksum = self.counters.bad_checksum.wrapping_add(1);
            Candidate::Drop(1)
        }
    }
}

/// Messages in, frames out; numbers them.
#[derive(Clone, Debug)]
pub struct Encoder {
    own: Address,
    sequence: u8,
}

/// Room for one frame.
pub type FrameBuffer = [u8; MAX_FRAME];

impl Encoder {
    /// An encoder that sends as `own`.
    pub const fn new(own: Address) -> Self {
        Self { own, sequence: 0 }
    }

    /// Who it sends as.
    pub fn own(&self) -> Address {
        self.own
    }

    /// Writes `message` as the next frame into `buffer` and returns it.
    pub fn encode<'b>(&mut self, message: &MavMessage, buffer: &'b mut FrameBuffer) -> &'b [u8] {
        let length = message.ser(MavlinkVersion::V2, &mut buffer[HEADER..HEADER + 255]);
        let id = message.message_id();
        self.finish(id, length, MavMessage::extra_crc(id), buffer)
    }

    /// ArduPilot's form of ESTIMATOR_STATUS: an EKF_STATUS_REPORT with these flags.
    pub fn encode_ekf_status_report<'b>(
        &mut self,
        flags: EstimatorStatusFlags,
        buffer: &'b mut FrameBuffer,
    ) -> &'b [u8] {
        let (id, seed, offset) = EKF_STATUS_REPORT;
        buffer[HEADER..HEADER + offset].fill(0);
        buffer[HEADER + offset..HEADER + offset + 2].copy_from_slice(&flags.bits().to_le_bytes());
        self.finish(id, offset + 2, seed, buffer)
    }

    fn finish<'b>(
        &mut self,
        id: u32,
        length: usize,
        seed: u8,
        buffer: &'b mut FrameBuffer,
    ) -> &'b [u8] {
        let [id0, id1, id2, _] = id.to_le_bytes();
        buffer[..HEADER].copy_from_slice(&[
            START,
            length as u8,
            0,
            0,
            self.sequence,
            self.own.system,
            self.own.component,
            id0,
            id1,
            id2,
        ]);
        self.sequence = self.sequence.wrapping_add(1);
        let end = HEADER + length;
        let checksum = calculate_crc(&buffer[1..end], seed);
        buffer[end..end + CHECKSUM].copy_from_slice(&checksum.to_le_bytes());
        &buffer[..end + CHECKSUM]
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
mod tests {
    use std::vec::Vec;

    use mavlink::dialects::common::{
        HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavModeFlag, MavState, MavType,
    };
    use proptest::prelude::*;

    use super::*;

    const OWN: Address = Address {
        system: 7,
        component: 191,
    };

    fn position(x: f32) -> MavMessage {
        MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
            x,
            ..LOCAL_POSITION_NED_DATA::DEFAULT
        })
    }

    fn heartbeat() -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 4,
            mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    }

    fn decode(decoder: &mut Decoder, mut bytes: &[u8]) -> Vec<MavMessage> {
        let mut found = Vec::new();
        while let Some(frame) = decoder.next_frame(&mut bytes) {
            found.push(frame.message().unwrap());
        }
        found
    }

    #[test]
    fn a_heartbeat_has_the_bytes_of_the_standard() {
        let mut buffer = [0; MAX_FRAME];
        let mut encoder = Encoder::new(OWN);
        let frame = encoder.encode(&heartbeat(), &mut buffer).to_vec();
        // Payload in wire order: custom_mode, type 18, autopilot 8, base_mode 0, status 4, version 3.
        assert_eq!(frame[..10], [0xFD, 9, 0, 0, 0, 7, 191, 0, 0, 0]);
        assert_eq!(frame[10..19], [4, 0, 0, 0, 18, 8, 0, 4, 3]);
        assert_eq!(frame.len(), 21);
        assert_eq!(encoder.encode(&heartbeat(), &mut buffer)[4], 1, "sequence");
    }

    #[test]
    fn ardupilots_estimate_is_read_as_the_common_one() {
        let mut buffer = [0; MAX_FRAME];
        let flags = EstimatorStatusFlags::ESTIMATOR_POS_HORIZ_ABS
            | EstimatorStatusFlags::ESTIMATOR_PRED_POS_HORIZ_ABS;
        let mut encoder = Encoder::new(OWN);
        let bytes = encoder.encode_ekf_status_report(flags, &mut buffer);
        let found = decode(&mut Decoder::new(), bytes);
        let [MavMessage::ESTIMATOR_STATUS(status)] = &found[..] else {
            panic!("{found:?}")
        };
        assert_eq!(status.flags, flags);
    }

    #[test]
    fn a_truncated_datagram_holds_nothing_back() {
        let mut buffer = [0; MAX_FRAME];
        let mut encoder = Encoder::new(OWN);
        let frame = encoder.encode(&position(1.0), &mut buffer).to_vec();
        let mut decoder = Decoder::new();
        assert!(decode(&mut decoder, &frame[..frame.len() - 5]).is_empty());
        assert!(decoder.end_of_datagram().is_none());
        assert_eq!(decode(&mut decoder, &frame).len(), 1);
    }

    #[test]
    fn frames_of_other_dialects_are_stepped_over_and_counted() {
        let mut buffer = [0; MAX_FRAME];
        let mut encoder = Encoder::new(OWN);
        // AHRS2 (178) of ardupilotmega, with a start byte in its payload.
        let mut stream = std::vec![START, 3, 0, 0, 0, 1, 1, 178, 0, 0, START, 200, 0, 9, 9];
        stream.extend_from_slice(encoder.encode(&position(2.0), &mut buffer));
        let mut decoder = Decoder::new();
        assert_eq!(decode(&mut decoder, &stream).len(), 1);
        assert_eq!(decoder.counters().unknown_message, 1);
        assert_eq!(decoder.counters().bad_checksum, 0);
    }

    #[test]
    fn duplicates_and_late_frames_are_dropped_where_order_counts() {
        let mut encoder = Encoder::new(OWN);
        let frames: Vec<Vec<u8>> = (0..300)
            .map(|n| {
                encoder
                    .encode(&position(n as f32), &mut [0; MAX_FRAME])
                    .to_vec()
            })
            .collect();
        let order = [0, 1, 1, 3, 2, 4, 299, 298, 0, 1];
        let mut decoder = Decoder::in_order();
        let mut got = Vec::new();
        for n in order {
            for message in decode(&mut decoder, &frames[n]) {
                if let MavMessage::LOCAL_POSITION_NED(p) = message {
                    got.push(p.x as usize);
                }
            }
        }
        // 299 has the running number 43; 0 after it is a sender that started anew.
        assert_eq!(got, [0, 1, 3, 4, 299, 0, 1]);
        assert_eq!(decoder.counters().out_of_order, 3);
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            rng_seed: proptest::test_runner::RngSeed::Fixed(1),
            ..ProptestConfig::with_cases(300)
        })]

        /// Frames in noise without start bytes, cut at any place, all come out, in order.
        #[test]
        fn frames_survive_noise_and_any_cutting(
            xs in proptest::collection::vec(-1e6f32..1e6, 1..20),
            noise in proptest::collection::vec(0u8..0xFD, 0..40),
            piece in 1usize..300,
        ) {
            let mut buffer = [0; MAX_FRAME];
            let mut encoder = Encoder::new(OWN);
            let mut stream = Vec::new();
            for &x in &xs {
                stream.extend_from_slice(&noise);
                stream.extend_from_slice(encoder.encode(&position(x), &mut buffer));
            }
            let mut decoder = Decoder::new();
            let mut got = Vec::new();
            for piece in stream.chunks(piece) {
                for message in decode(&mut decoder, piece) {
                    if let MavMessage::LOCAL_POSITION_NED(p) = message { got.push(p.x) }
                }
            }
            prop_assert_eq!(got, xs.clone());
            prop_assert_eq!(decoder.counters().skipped_bytes as usize, noise.len() * xs.len());
        }

        /// Any bytes at all: no panic, and a good frame after them is found at the latest
        /// when the datagram ends.
        #[test]
        fn any_bytes_are_survived(junk in proptest::collection::vec(any::<u8>(), 0..2000)) {
            let mut buffer = [0; MAX_FRAME];
            let frame = Encoder::new(OWN).encode(&position(3.0), &mut buffer).to_vec();
            let mut decoder = Decoder::new();
            let mut input = &junk[..];
            while let Some(frame) = decoder.next_frame(&mut input) { let _ = frame.message(); }
            while let Some(frame) = decoder.end_of_datagram() { let _ = frame.message(); }
            prop_assert_eq!(decode(&mut decoder, &frame).len(), 1);
        }

        /// One wrong bit never passes as a frame.
        #[test]
        fn a_wrong_bit_is_noticed(x in -1e6f32..1e6, byte in 1usize..40, bit in 0u32..8) {
            let mut buffer = [0; MAX_FRAME];
            let mut frame = Encoder::new(OWN).encode(&position(x), &mut buffer).to_vec();
            let at = byte % frame.len();
            frame[at] ^= 1 << bit;
            let mut decoder = Decoder::new();
            let mut input = &frame[..];
            prop_assert!(decoder.next_frame(&mut input).is_none());
            prop_assert!(decoder.end_of_datagram().is_none());
        }
    }
}
