//! The onboard computers that can fly a mission, and what the flight loop asks of them.
//!
//! ```text
//!   Ground  <-- ground link -->  OnboardComputer  <-- MAVLink -->  vehicle
//!                                        ^
//!   clock   <-- rounds, events ----------+
//! ```
//!
//! | computer | is |
//! |---|---|
//! | [`InProcess`] | the controller in this process, in double precision |
//! | [`Twin`] | the computer of a board in this process, in single precision |
//! | [`Image`] | the microcontroller image at the other end of three serial lines |
//! | [`Campaign`] | an image and its twin, which must do the same under faults of the ground link |
//!
//! In all cases the host provides the time: a flight with the built-in vehicle is reproducible byte
//! for byte, however slow the computer is, and an image flies like its twin as far as the
//! arithmetic is the same.

mod campaign;
mod image;
mod in_process;
mod order;
mod parameters;
mod twin;

use std::{fmt, io};

use firmware_core::{
    Position, Scalar,
    autopilot::{
        Phase,
        wire::{MAX_FRAME, signing::SigningState},
    },
    console::Footprint,
    inner::SlotSolver,
    link::FRAME_MAX,
    onboard::{Onboard, Stage},
    policy::Policy,
    time::{Duration, Instant},
};
use vehicle::Profile;

use super::{outcome::FlightError, reason};

pub use campaign::{Campaign, SLOTS_EACH, Tally};
pub use image::Image;
pub use in_process::InProcess;
pub use order::{check_order, order};
pub use twin::Twin;

/// What a computer receives in a round.
#[derive(Clone, Copy, Debug)]
pub struct RoundInput<'a> {
    /// The time of the flight.
    pub now: Instant,
    /// The clock of signatures, microseconds since 1970.
    pub unix_us: u64,
    /// The frames of the vehicle.
    pub from_vehicle: &'a [Vec<u8>],
    /// The bytes of the ground.
    pub from_ground: &'a [u8],
}

/// The output of a computer in a round.
#[derive(Debug, Default)]
pub struct Round {
    /// The frames for the vehicle.
    pub to_vehicle: Vec<Vec<u8>>,
    /// The bytes for the ground.
    pub to_ground: Vec<u8>,
    /// The time spent planning, microseconds; 0 if no slot was planned.
    pub plan_us: f64,
    /// The time spent allocating, microseconds; 0 if no slot was allocated.
    pub allocate_us: f64,
}

impl Round {
    /// Takes all frames that a computer has for both sides.
    fn take_frames<T, P, const M: usize, const J: usize, S>(
        &mut self,
        now: Instant,
        onboard: &mut Onboard<T, P, M, J, S>,
    ) where
        T: Scalar,
        P: Policy<T, M>,
        S: SlotSolver<T>,
    {
        let mut buffer = [0; MAX_FRAME];
        while let Some(frame) = onboard.take_mavlink_frame(now, &mut buffer) {
            self.to_vehicle.push(frame.to_vec());
        }
        let mut buffer = [0; FRAME_MAX];
        while let Some(frame) = onboard.take_ground_frame(&mut buffer) {
            self.to_ground.extend_from_slice(frame);
        }
    }

    /// Returns whether the computer has sent nothing.
    pub(super) fn is_silent(&self) -> bool {
        self.to_vehicle.is_empty() && self.to_ground.is_empty()
    }
}

/// The state of a computer after a round.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComputerState {
    /// The stage of the mission.
    pub stage: Stage,
    /// The phase of the MAVLink client.
    pub phase: Phase,
    /// The measured position and altitude of the vehicle, metres.
    pub place: Option<(Position<f64>, f64)>,
    /// Messages of a vehicle have been received.
    pub is_connected: bool,
}

impl ComputerState {
    /// Returns the state of a board, which does not report its connection by itself.
    fn of_board(stage: Stage, phase: Phase, place: Option<(Position<f32>, f32)>) -> Self {
        Self {
            stage,
            phase,
            place: place.map(|(place, altitude_m)| (place.map(f64::from), altitude_m.into())),
            is_connected: !matches!(phase, Phase::Connecting | Phase::Failed),
        }
    }
}

/// A message of a computer for the record or the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Notice {
    /// An event of the autopilot or its client, for the record.
    Event {
        /// The event in words.
        text: String,
        /// Whether the event is shown to the user when it happens.
        notable: bool,
    },
    /// Something that the user must do.
    Duty(String),
    /// Further information.
    Note(String),
    /// Something that the flight waits for.
    Waiting(String),
}

impl Notice {
    /// Returns the notice of an event that a board reports in words.
    fn of_board(words: String) -> Self {
        Self::Event {
            notable: reason::are_notable(&words),
            text: words,
        }
    }
}

/// An onboard computer that receives time and bytes from the flight loop.
///
/// The provided methods are those of a computer that changes no parameters of the vehicle and has
/// nothing to do once the flight is over.
pub trait OnboardComputer: fmt::Debug {
    /// The precision of the numbers on the ground link.
    type Precision: Scalar;

    /// Takes what was received from both sides, advances, and returns the output. The flight loop
    /// calls it until nothing is pending at this time.
    ///
    /// # Errors
    /// Returns an error if the computer does not answer or cannot fly this vehicle.
    fn round(&mut self, input: &RoundInput<'_>) -> Result<Round, FlightError>;

    /// Returns the present state.
    fn state(&self) -> ComputerState;

    /// Returns the next notice. Call until `None` when nothing is pending.
    fn take_notice(&mut self, now: Instant) -> Option<Notice>;

    /// Asks the computer to end the mission. Returns what the vehicle does now, in words, if it
    /// takes time.
    ///
    /// # Errors
    /// Returns an error if the computer does not answer.
    fn stop(&mut self, now: Instant) -> io::Result<Option<&'static str>>;

    /// Returns the reason why the mission was aborted; `None` if only the phase is known.
    fn aborted_because(&self) -> Option<String>;

    /// Returns the digest of the mission that the policy was trained for; `None` if the policy is a
    /// rule, and for a computer whose policy the caller has.
    fn scenario_digest(&self) -> Option<&str> {
        None
    }

    /// Returns the memory usage, if the computer can report it.
    ///
    /// # Errors
    /// Returns an error if the computer does not answer.
    fn footprint(&mut self) -> io::Result<Option<Footprint>> {
        Ok(None)
    }

    /// Returns the state of MAVLink signing for the next flight, or `None` if frames are not signed.
    ///
    /// # Errors
    /// Returns an error if the computer does not answer.
    fn signing_state(&mut self) -> io::Result<Option<SigningState>> {
        Ok(None)
    }

    /// Returns the profile that is used for planning, if it is not that of the flight's settings.
    fn profile(&self) -> Option<Profile> {
        None
    }

    /// Returns the time since the last heartbeat of the vehicle if its link counts as silent.
    fn silence(&self, now: Instant) -> Option<Duration> {
        let _ = now;
        None
    }

    /// Returns the number of MAVLink frames that were received and refused.
    fn refused_frames(&self) -> u32 {
        0
    }

    /// Returns whether the computer restores changed parameters of the vehicle.
    fn restores_parameters(&self) -> bool {
        false
    }

    /// Restores parameters now instead of after the landing, because the user is about to leave.
    fn restore_now(&mut self) {}

    /// Returns whether the user can leave now: parameters are restored, and the vehicle has been
    /// told to land.
    fn may_be_left(&self) -> bool {
        true
    }

    /// Gives up restoring parameters; a notice reports each of them.
    fn abandon_parameters(&mut self) {}

    /// Returns whether nothing is left to do after the flight; `stop_asked` is whether the user has
    /// asked for the end.
    fn is_finished(&mut self, now: Instant, stop_asked: bool) -> bool {
        let _ = (now, stop_asked);
        true
    }

    /// Returns what the user has to do after the flight, in words.
    fn left_over(&self) -> Option<String> {
        None
    }
}
