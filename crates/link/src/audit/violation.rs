//! The ways in which a vehicle can break the rules of the ground link.

use firmware_core::{
    Scalar,
    controller::{ChannelSource, CommandError},
    link::{FrameError, LinkCounters, SecurityCounters, VehicleStatus},
};

/// Error returned when the vehicle breaks a rule of the ground link.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Violation<T: Scalar> {
    /// A frame of the vehicle cannot be decoded.
    #[error("the vehicle's own frame: {0}")]
    Frame(FrameError),
    /// The vehicle sent a message that only the ground sends.
    #[error("a channel state of slot {slot} from the vehicle")]
    ChannelState {
        /// The slot of the state.
        slot: u32,
    },
    /// The vehicle sent a message that only the ground sends.
    #[error("change {number} of the mission from the vehicle")]
    Change {
        /// The number of the change.
        number: u32,
    },
    /// The vehicle sent a message that only the ground sends.
    #[error("a quality of slot {slot} from the vehicle")]
    Quality {
        /// The slot of the quality.
        slot: u32,
    },
    /// An arrival is not about the next slot.
    #[error("an arrival of slot {got}, but slot {next} is next")]
    Arrival {
        /// The slot of the arrival.
        got: u32,
        /// The next slot.
        next: u32,
    },
    /// A second arrival differs from the first one, whose command is missing.
    #[error("another arrival, of slot {got}, before the command of slot {slot}")]
    OtherArrival {
        /// The slot whose command is missing.
        slot: u32,
        /// The slot of the arrival.
        got: u32,
    },
    /// A command does not follow the arrival of its slot.
    #[error("a command of slot {slot} without its arrival")]
    CommandOutOfTurn {
        /// The slot of the command.
        slot: u32,
    },
    /// A command breaks a rule of the mission.
    #[error("slot {slot}: {error}")]
    Command {
        /// The slot.
        slot: u32,
        /// The rule.
        error: CommandError<T>,
    },
    /// A command names the wrong source of its gains.
    #[error(
        "slot {slot}: a command from a {named:?} state of age {age_slots}, but a state was {}",
        if *received { "received" } else { "not received" }
    )]
    Source {
        /// The slot.
        slot: u32,
        /// The source according to the command.
        named: ChannelSource,
        /// The age according to the command.
        age_slots: u32,
        /// Whether a state was received in time.
        received: bool,
    },
    /// A command states a wrong number of rejected gains or unheard sensors.
    #[error("slot {slot}: {got} {name}, but the state has {expected}")]
    Gains {
        /// The slot.
        slot: u32,
        /// What is counted.
        name: &'static str,
        /// The number according to the command.
        got: u16,
        /// The number according to the state.
        expected: usize,
    },
    /// A sensor that is not heard has to transmit.
    #[error("slot {slot}: sensor {sensor} is not heard, but transmits")]
    UnheardSensor {
        /// The slot.
        slot: u32,
        /// The index of the sensor.
        sensor: usize,
    },
    /// The served user is not heard, or nobody is served although a user is heard.
    #[error("slot {slot}: user {user:?} is served, but another one is heard")]
    ServedUser {
        /// The slot.
        slot: u32,
        /// The served user.
        user: Option<usize>,
    },
    /// The MSE at the gains of the state, or its expectation where these are not exact, is above the MSE
    /// of the command.
    #[error("slot {slot}: the MSE is {mse}, but {promised} was promised")]
    Mse {
        /// The slot.
        slot: u32,
        /// The MSE.
        mse: f64,
        /// The MSE of the command.
        promised: f64,
    },
    /// The counters of the vehicle's decoder are wrong.
    #[error("{counters:?} of the link, but {expected:?} and {pieces} pieces were sent")]
    Link {
        /// The counters.
        counters: LinkCounters,
        /// The counters that follow from the bytes.
        expected: LinkCounters,
        /// The number of pieces between delimiters.
        pieces: u32,
    },
    /// The counters of the vehicle's authentication are wrong.
    #[error("the vehicle's authentication counts {counters:?}, but the link was sent {expected:?}")]
    Security {
        /// The counters.
        counters: SecurityCounters,
        /// The counters that follow from the bytes; `None` if the link is not authenticated.
        expected: Option<SecurityCounters>,
    },
    /// Other counters of the vehicle are wrong.
    #[error("the vehicle counts {:?}, but the link was sent {:?}", .0.0, .0.1)]
    Counters(Box<(VehicleStatus, VehicleStatus)>),
    /// The counters do not add up.
    #[error("{messages} messages, of which {used} are counted as used")]
    Uncounted {
        /// The number of good messages.
        messages: u32,
        /// The number of messages that were used or counted as unusable.
        used: u32,
    },
}
