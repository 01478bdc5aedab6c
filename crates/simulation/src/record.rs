//! The record of a flight: one record per slot, the flown path, the events and the counters of the
//! link. [`Summary`] is what follows from it. The files are written by `report`.

mod knowledge;
mod summary;

use firmware_core::{
    Position,
    controller::ChannelSource,
    inner::LimitedBy,
    link::{LinkCounters, SecurityCounters, VehicleStatus},
    shield::Intervention,
    time::Tick,
};
use serde::Serialize;

use scenario::{Events, Scenario};

pub use knowledge::KnowledgeSummary;
pub use summary::{Summary, Timing, UserSummary};

/// A flown mission.
#[derive(Clone, Debug)]
pub struct FlightRecord {
    /// The scenario that was flown.
    pub scenario: Scenario,
    /// The policy: `straight-line`, `fixed`, `search` or the name of a file.
    pub policy: String,
    /// The solver that allocated the powers.
    pub inner: String,
    /// The name of the vehicle's profile.
    pub profile: String,
    /// The seed of the drawn signals.
    pub seed: u64,
    /// The slots in order.
    pub slots: Vec<SlotRecord>,
    /// The true positions of the vehicle in order of time, from the start of slot 1.
    pub path: Vec<PathSample>,
    /// The changes of the mission that happened in flight.
    pub changes: Events,
    /// The vehicle was not told how good the estimates of channels are.
    pub ignores_errors: bool,
    /// The events of the autopilot and its client, in order.
    pub events: Vec<FlightEvent>,
    /// When all of this happened.
    pub times: FlightTimes,
    /// The frames that were received and lost on the ground link.
    pub link: LinkRecord,
    /// Whether the mission was flown to its end and the vehicle landed.
    pub completed: bool,
    /// How the flight ended, in words: "landed", or the true cause.
    pub ended: String,
    /// What the report says beyond the flight itself.
    pub notes: FlightNotes,
}

/// What the program that flew a mission knows beyond the flight itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlightNotes {
    /// The warning about a policy that was trained for another mission.
    pub policy_warning: Option<String>,
    /// The sum of the rates of the ideal flight, bit/s/Hz: the same policy and allocation with the
    /// ideal vehicle and perfect links. `None` if it was not flown, as when this flight is the
    /// ideal one.
    pub ideal_sum_rate: Option<f64>,
    /// The certified bound of the mission, if it was asked for.
    pub certified_bound: Option<CertifiedBound>,
}

/// A certified bound on the sum of the rates of any mission, and where it is from.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CertifiedBound {
    /// No admissible mission has a larger sum of rates, bit/s/Hz.
    pub upper: f64,
    /// The file that it was read from, or `None` if it was computed for this flight.
    pub file: Option<String>,
}

/// The times of a flight, which put its slots, its path and its events on one clock.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlightTimes {
    /// The date when the client started, microseconds since 1970; that of `mavlink.tlog`.
    pub epoch_us: u64,
    /// The start of slot 1, seconds since the client started.
    pub first_slot_s: f64,
    /// When the ground had received each slot, seconds since the client started.
    pub slots_s: Vec<f64>,
}

/// An event, in words.
#[derive(Clone, Debug, PartialEq)]
pub struct FlightEvent {
    /// The time since the client started, seconds.
    pub time_s: f64,
    /// The description.
    pub text: String,
    /// Whether the event is displayed when it happens.
    pub notable: bool,
}

/// The frames of the ground link, counted at both ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LinkRecord {
    /// The last counters that the vehicle sent to the ground.
    pub vehicle: VehicleStatus,
    /// The frames that the ground received.
    pub ground: LinkCounters,
    /// The slots of which the ground received only the arrival or only the command: users and
    /// sensors did not transmit.
    pub slots_missed: u32,
    /// The arrivals and commands that were received more than once.
    pub repeated: u32,
    /// The arrivals and commands for a slot or a user that the mission does not have.
    pub nonsense: u32,
    /// What the authentication of both ends has taken and refused; absent if the link is open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub security: Option<SecurityRecord>,
}

/// What the authentication of the ground link has taken and refused, counted at both ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SecurityRecord {
    /// The last counters that the vehicle sent to the ground.
    pub vehicle: SecurityCounters,
    /// The counters of the ground.
    pub ground: SecurityCounters,
}

/// The true position of the vehicle at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathSample {
    /// The time since the start of slot 1, seconds.
    pub time_s: f64,
    /// The position, metres.
    pub position: Position<f64>,
    /// The height above the ground, metres.
    pub altitude_m: f64,
}

/// One slot: as planned, flown, allocated and received.
#[derive(Clone, Debug, PartialEq)]
pub struct SlotRecord {
    /// The slot `n`, 1 to `N`.
    pub slot: u32,
    /// The waypoint, metres.
    pub planned: Position<f64>,
    /// The true position of the vehicle at the end of the slot, metres.
    pub flown: Position<f64>,
    /// The end of the slot on the vehicle's clock, and how its position was determined.
    pub tick: Tick,
    /// The served user, from 0; `None` if no user was received.
    pub served_user: Option<usize>,
    /// `p`, watts.
    pub user_power_w: f64,
    /// `eta`, one over square root of watts.
    pub normalizing_factor: f64,
    /// The average of `|b_j|^2` over the sensors, watts.
    pub sensor_power_mean_w: f64,
    /// `R_n`, bit/s/Hz.
    pub rate: f64,
    /// The rate of the same user if the vehicle were at the waypoint, bit/s/Hz.
    pub planned_rate: f64,
    /// `MSE_n`, analytic, with the true channels.
    pub mse: f64,
    /// The rate of the same user at the same place if all channels were known exactly, bit/s/Hz;
    /// `None` in a world in which they are.
    pub perfect_rate: Option<f64>,
    /// The constraint that limits the rate.
    pub limited_by: LimitedBy,
    /// Whether `Gamma` could be met.
    pub feasible: bool,
    /// Whether it could not because of the errors of the estimates alone, whatever the powers.
    pub at_error_floor: bool,
    /// The changes that the shield made.
    pub intervention: Intervention,
    /// The source of the gains that the controller used.
    pub channel_source: ChannelSource,
    /// The age of these gains in slots; 0 if they are those of this slot.
    pub age_slots: u32,
    /// The signals that were drawn and received.
    pub signals: SignalRecord,
    /// The duration of `plan`, microseconds.
    pub plan_us: f64,
    /// The duration of `allocate`, microseconds.
    pub allocate_us: f64,
}

impl SlotRecord {
    /// Returns the served user as reports name it.
    pub fn user_name(&self) -> String {
        self.served_user
            .map_or_else(|| "nobody".into(), |user| format!("u{user}"))
    }
}

/// The signals of a slot as the receiver processed them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalRecord {
    /// The mean of `|F-hat - F|^2` over the drawn symbols.
    pub empirical_mse: f64,
    /// The standard error of this mean, from the drawn symbols.
    pub standard_error: f64,
    /// The number of symbols in this mean.
    pub symbols: u32,
    /// The true value of the nomographic function of the measurements, in the scenario's unit.
    pub true_value: f64,
    /// The estimate of this value over the air.
    pub estimate: f64,
}

impl SignalRecord {
    /// Returns `estimate - true_value`, in the scenario's unit.
    pub fn error(&self) -> f64 {
        self.estimate - self.true_value
    }
}
