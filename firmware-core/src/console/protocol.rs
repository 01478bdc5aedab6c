// SPDX-License-Identifier: MIT OR Apache-2.0
//! The messages between a board and its console, and their frames.

use heapless::String;
use serde::{Deserialize, Serialize};

use super::order::MissionOrder;
use crate::{
    SENSORS_MAX, USERS_MAX,
    autopilot::{
        Phase,
        wire::signing::{STREAMS_MAX, SigningState},
    },
    link::{
        self, Decoder, FrameError, FrameTooLong,
        length::{LENGTH, U8, U32, U64, framed, longer},
    },
    onboard::Stage,
    scalar::Position,
    time::Instant,
};

/// The version of the console's messages. Any change of a message needs a new version.
pub const CONSOLE_VERSION: u8 = 133;

/// The length of the longest frame: an order with the largest number of users, sensors and streams
/// of signed frames, and both keys.
pub const CONSOLE_FRAME_MAX: usize = framed(U8 + order_max(USERS_MAX, SENSORS_MAX));

/// The length of the longest text.
pub const TEXT_MAX: usize = 120;

/// The length of the longest frame of a [`BoardReport`].
pub const REPORT_FRAME_MAX: usize = {
    let text = LENGTH + TEXT_MAX;
    let ready = U8 + LENGTH + DIGEST_LENGTH;
    let tock = 2 * U32 + 2 * U8 + (U8 + 3 * REAL) + 3 * U32;
    let footprint = 4 * U32;
    let signing = U8 + SIGNING_STATE;
    framed(
        U8 + longer(
            longer(text, ready),
            longer(longer(tock, footprint), signing),
        ),
    )
};

/// The length of a mission's digest, in hexadecimal digits.
const DIGEST_LENGTH: usize = 64;

/// The most bytes of a number in single precision.
const REAL: usize = 4;

/// The most bytes of the state of MAVLink signing. Its times have 48 bits.
const SIGNING_STATE: usize = {
    const TIME: usize = 7;
    const STREAM: usize = U8 + 2 * U8 + TIME;
    TIME + LENGTH + STREAMS_MAX * STREAM
};

/// Returns the most bytes of a [`MissionOrder`] with up to so many users and sensors.
const fn order_max(users: usize, sensors: usize) -> usize {
    let mission = U32 + 18 * REAL + U8 + LENGTH + users * 2 * REAL + LENGTH + sensors * 2 * REAL;
    let map_origin = 2 * U32;
    let limits = 3 * REAL;
    let geofence = U8 + 5 * REAL;
    let ground_patience = U8 + U64;
    let policy_and_clock = 2 * U8;
    let ground_link = U8 + 32 + 12;
    let mavlink_key = U8 + 32 + U8 + SIGNING_STATE;
    let vehicle = map_origin + limits + geofence;
    mission + vehicle + ground_patience + policy_and_clock + ground_link + mavlink_key
}

/// One moment of a bench's time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tick {
    /// The time.
    pub now: Instant,
    /// Bytes that were sent over the ground link so far, modulo 2^32.
    pub ground_bytes: u32,
    /// Bytes that were sent over MAVLink so far, modulo 2^32.
    pub mavlink_bytes: u32,
}

/// The result of one round on a board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tock {
    /// Bytes that the board sent over the ground link so far, modulo 2^32.
    pub ground_bytes: u32,
    /// Bytes that the board sent over MAVLink so far, modulo 2^32.
    pub mavlink_bytes: u32,
    /// The stage of the mission.
    pub stage: Stage,
    /// The phase of the MAVLink client.
    pub phase: Phase,
    /// The measured position and altitude, metres.
    pub place: Option<(Position<f32>, f32)>,
    /// The computing time of this round.
    pub cost: Cost,
}

/// Computing times on the board's clock, nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cost {
    /// The whole round.
    pub round_ns: u32,
    /// The part spent planning; 0 where no slot was planned.
    pub plan_ns: u32,
    /// The part spent allocating; 0 where no slot was allocated.
    pub allocate_ns: u32,
}

/// The use of a board's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Footprint {
    /// The largest use of the stack so far, bytes.
    pub stack_bytes: u32,
    /// The size of the onboard computer itself, bytes.
    pub computer_bytes: u32,
    /// Received bytes that were lost because a buffer was full.
    pub lost_bytes: u32,
    /// Frames that were not sent because a buffer was full.
    pub unsent_frames: u32,
}

/// A message to the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // no allocator
pub enum Call {
    /// An order to fly a mission.
    Order(MissionOrder),
    /// On a bench: the present time.
    Tick(Tick),
    /// A person asks the vehicle to land.
    Stop,
    /// A request for the use of memory.
    Footprint,
    /// A request for the state of MAVLink signing, to save it.
    Signing,
}

/// A message from the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum BoardReport {
    /// The order was accepted.
    Ready {
        /// The digest of the mission that the policy was trained for, by which the bench finds that
        /// it is another mission; `None` if the policy is a rule, or is for any mission.
        scenario_digest: Option<String<DIGEST_LENGTH>>,
    },
    /// The order was refused for this reason; another may follow.
    Refused(String<TEXT_MAX>),
    /// A round is done.
    Tock(Tock),
    /// A description of an event.
    Event(String<TEXT_MAX>),
    /// The mission was aborted for this reason.
    Aborted(String<TEXT_MAX>),
    /// The use of memory.
    Footprint(Footprint),
    /// The state of MAVLink signing, which the next order carries; `None` if the board does not
    /// sign.
    Signing(Option<SigningState>),
}

/// Writes a call as a frame.
///
/// # Errors
/// Returns an error if the frame does not fit; [`CONSOLE_FRAME_MAX`] bytes always suffice.
pub fn encode_call<'f>(call: &Call, frame: &'f mut [u8]) -> Result<&'f [u8], FrameTooLong> {
    link::seal(CONSOLE_VERSION, call, frame)
}

/// Writes a report as a frame.
///
/// # Errors
/// Returns an error if the frame does not fit; [`REPORT_FRAME_MAX`] bytes always suffice.
pub fn encode_report<'f>(
    report: &BoardReport,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    link::seal(CONSOLE_VERSION, report, frame)
}

/// The board's decoder: finds calls in a stream of bytes.
#[derive(Clone, Debug, Default)]
pub struct Calls(Decoder<CONSOLE_FRAME_MAX>);

impl Calls {
    /// Takes a byte. At the end of a frame it returns the call, or the error if there is none.
    pub fn push(&mut self, byte: u8) -> Option<Result<Call, FrameError>> {
        let call = self.0.push_of(CONSOLE_VERSION, byte);
        if matches!(call, Some(Ok(Call::Order(_)) | Err(_))) {
            // An order may carry a key.
            self.0.erase();
        }
        call
    }
}

/// The bench's decoder: finds reports in a stream of bytes.
#[derive(Clone, Debug, Default)]
pub struct Reports(Decoder<REPORT_FRAME_MAX>);

impl Reports {
    /// Takes a byte. At the end of a frame it returns the report, or the error if there is none.
    pub fn push(&mut self, byte: u8) -> Option<Result<BoardReport, FrameError>> {
        self.0.push_of(CONSOLE_VERSION, byte)
    }
}

/// Formats a value as text, truncated to [`TEXT_MAX`].
pub fn words(what: &impl core::fmt::Display) -> String<TEXT_MAX> {
    struct Cut(String<TEXT_MAX>);
    impl core::fmt::Write for Cut {
        fn write_str(&mut self, text: &str) -> core::fmt::Result {
            text.chars()
                .try_for_each(|letter| self.0.push(letter))
                .map_err(|_| core::fmt::Error)
        }
    }
    let mut cut = Cut(String::new());
    // The error means that the text was truncated.
    let _ = core::fmt::Write::write_fmt(&mut cut, format_args!("{what}"));
    cut.0
}

#[cfg(test)]
mod tests {
    use super::super::MavlinkKey;
    use super::{super::order::tests::order, *};
    use crate::autopilot::{
        frames::Geodetic,
        wire::{
            Address,
            signing::{SigningKey, SigningTime, StreamTime},
        },
    };
    use crate::time::Duration;

    /// The longest state: every stream in use, at the latest time.
    fn longest_state() -> SigningState {
        let mut state = SigningState::at(SigningTime::LAST);
        let stream = StreamTime {
            link: u8::MAX,
            sender: Address {
                system: u8::MAX,
                component: u8::MAX,
            },
            time: SigningTime::LAST,
        };
        while state.streams.push(stream).is_ok() {}
        state
    }

    /// The bound is that of the longest frame, but for `lengths` lengths of vectors, which take one
    /// byte of the three that the bound has for each, and what COBS saves.
    fn assert_is_tight(frame: &[u8], bound: usize, lengths: usize) {
        let plain = cobs::decode_in_place(&mut frame[1..frame.len() - 1].to_vec());
        let message = plain.expect("a frame") - 5;
        assert_eq!(framed(message + 2 * lengths), bound);
    }

    #[test]
    fn the_longest_order_fits_and_survives() {
        let mut order = order();
        let place = Position::new(999.0, 1.0);
        while order.mission.users.push(place).is_ok() {}
        while order.mission.sensors.push(place).is_ok() {}
        order.map_origin = Geodetic {
            latitude_e7: i32::MIN,
            longitude_e7: i32::MIN,
        };
        order.mission.slots = u32::MAX;
        order.ground_patience = Some(Duration::from_micros(u64::MAX));
        order.mavlink_key = Some(MavlinkKey {
            key: SigningKey::new([0xAB; 32]),
            link: u8::MAX,
            state: longest_state(),
        });
        assert!(
            !std::format!("{order:?}").contains("171"),
            "the key is shown"
        );
        let mut buffer = [0; CONSOLE_FRAME_MAX];
        let frame = encode_call(&Call::Order(order.clone()), &mut buffer).expect("fits");
        assert_is_tight(frame, CONSOLE_FRAME_MAX, 3);
        let mut calls = Calls::default();
        let got: std::vec::Vec<_> = frame.iter().filter_map(|&b| calls.push(b)).collect();
        assert_eq!(got, [Ok(Call::Order(order))]);
    }

    #[test]
    fn the_longest_report_fits_and_survives() {
        let text = words(&"x".repeat(200));
        assert_eq!(text.len(), TEXT_MAX);
        let footprint = Footprint {
            stack_bytes: u32::MAX,
            computer_bytes: u32::MAX,
            lost_bytes: u32::MAX,
            unsent_frames: u32::MAX,
        };
        let tock = Tock {
            ground_bytes: u32::MAX,
            mavlink_bytes: u32::MAX,
            stage: Stage::Aborted,
            phase: Phase::Failed,
            place: Some((Position::new(1.0, 2.0), 3.0)),
            cost: Cost {
                round_ns: u32::MAX,
                plan_ns: u32::MAX,
                allocate_ns: u32::MAX,
            },
        };
        let mut longest = std::vec::Vec::new();
        for report in [
            BoardReport::Aborted(text),
            BoardReport::Footprint(footprint),
            BoardReport::Tock(tock),
            BoardReport::Signing(Some(longest_state())),
        ] {
            let mut buffer = [0; REPORT_FRAME_MAX];
            let frame = encode_report(&report, &mut buffer).expect("fits");
            if frame.len() > longest.len() {
                longest = frame.to_vec();
            }
            let mut reports = Reports::default();
            let got: std::vec::Vec<_> = frame.iter().filter_map(|&b| reports.push(b)).collect();
            assert_eq!(got, [Ok(report)]);
        }
        assert_is_tight(&longest, REPORT_FRAME_MAX, 1);
    }

    /// The bytes of a frame are a format: a change of them is a new version.
    #[test]
    fn the_format_is_stable() {
        let tick = Call::Tick(Tick {
            now: Instant::from_micros(300),
            ground_bytes: 1,
            mavlink_bytes: 2,
        });
        let mut buffer = [0; 32];
        let frame = encode_call(&tick, &mut buffer).expect("fits");
        assert_eq!(frame[..8], [0, 11, 133, 1, 172, 2, 1, 2]);
    }
}
