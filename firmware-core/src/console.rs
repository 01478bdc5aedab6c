//! The console: a board's third serial line, which carries the orders for a flight.
//!
//! A board's image contains no mission. Before a flight the board receives a [`MissionOrder`] with
//! the mission, the vehicle's limits, the policy and the clock to use. It answers
//! [`BoardReport::Ready`] and flies, or refuses and gives the reason. Frames are those of the
//! [ground link](crate::link) under a version of their own, always in single precision.
//!
//! # The clock
//!
//! In the air the board's own timer is used. On a test bench ([`Clock::Console`]) the time is sent
//! over the console, so that board and simulated world stay in step however fast either computes:
//!
//! ```text
//! bench                                             board
//!   ground bytes, MAVLink bytes  ------------------->  waits until it has as many as Tick says,
//!   Tick { now, ground_bytes, mavlink_bytes }  ----->  takes them, does one round at `now`,
//!   waits until it has as many as Tock says  <-------  ground bytes, MAVLink bytes
//!                                            <-------  Tock { ground_bytes, mavlink_bytes, .. }
//! ```
//!
//! The three lines are not ordered relative to one another; the byte counts order them. A flight on
//! a bench is therefore the same, byte for byte, each time.

use heapless::String;
use serde::{Deserialize, Serialize};

use crate::{
    Mission, SENSORS_MAX, USERS_MAX,
    autopilot::{
        Autopilot, AutopilotSettings, Geofence, Phase, SettingsError, failsafe::Watch,
        frames::Geodetic, guidance::Limits, preflight::Preflight,
    },
    controller::Controller,
    link::{self, Decoder, FrameError, FrameTooLong},
    mission::{MissionChange, MissionError, MissionParameters},
    onboard::{Onboard, OnboardSettings, Stage},
    planner::{Capacity, Memory, OperationsInFlight, Planner, PlannerError},
    policy::{Action, Observation, PlanQuality, Policy, PolicyMismatch, StraightLine, mlp::Mlp},
    scalar::{Position, Scalar},
    time::{Duration, Instant},
};

/// The version of the console's messages. Any change of a message needs a new version.
pub const CONSOLE_VERSION: u8 = 130;

/// The length of the longest frame: an order with the largest number of users and sensors.
pub const CONSOLE_FRAME_MAX: usize = 832;

/// The length of the longest text.
pub const TEXT_MAX: usize = 120;

/// A mission in the board's precision.
pub type BoardMission = Mission<f32, USERS_MAX, SENSORS_MAX>;

/// The onboard computer of a board with its policy in flash, `B`, and its planner, `P`.
pub type BoardComputer<B, P> = Onboard<f32, BoardPolicy<B, P>, USERS_MAX, SENSORS_MAX>;

/// The planner of a board, with the memory `S`.
pub type BoardPlanner<S> = Planner<f32, S, USERS_MAX, SENSORS_MAX>;

/// The capacity of a board's planner: missions of up to 150 slots, and any number of users.
pub const PLANNER_CAPACITY: Capacity = Capacity {
    slots: 150,
    users: USERS_MAX,
    ..Capacity::new(24, USERS_MAX)
};

/// The numbers that a board's planner needs as its memory.
pub type PlannerNumbers = [f32; PLANNER_CAPACITY.values()];

/// The bytes that a board's planner needs beside [`PlannerNumbers`].
pub type PlannerBytes = [u8; PLANNER_CAPACITY.indices()];

/// The operations that a board's planner may spend in one [`poll`](Onboard::poll): less than 2 x
/// 10^6 instructions of a Cortex-M7 together with the last step, which may exceed it.
pub const PLANNER_OPERATIONS_PER_POLL: u64 = 100_000;

/// The operations that a board's planner spends in all: on the first plan before take-off, on a new
/// plan after a change, and in each slot on correcting the plan for the vehicle's position.
const PLANNER_OPERATIONS: OperationsInFlight = OperationsInFlight {
    first_plan: 120_000_000,
    per_change: 25_000_000,
    per_correction: 10_000_000,
};

/// Creates the planner of a board, in `place`. It has the straight line as its plan, and improves it
/// in the [polls](Onboard::poll) before take-off.
///
/// # Errors
/// Returns an error if the mission exceeds [`PLANNER_CAPACITY`], or if the memory is too small.
pub fn board_planner<'p, S: Memory<f32>>(
    place: &'p mut Option<BoardPlanner<S>>,
    mission: &BoardMission,
    memory: S,
) -> Result<&'p mut BoardPlanner<S>, PlannerError> {
    let planner = Planner::new_in(place, mission, PLANNER_CAPACITY, memory)?;
    planner.set_operations_in_flight(&PLANNER_OPERATIONS);
    Ok(planner)
}

/// The policy that a board uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PolicyKind {
    /// The trained policy in the board's flash.
    Trained,
    /// Straight to the destination, serving the nearest user.
    StraightLine,
    /// The plan that the board makes before take-off, and revises after changes.
    Plan,
}

/// The clock that a board uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Clock {
    /// The board's own timer.
    Board,
    /// The time sent in [`Tick`]s.
    Console,
}

/// Everything that a board needs to know for a flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MissionOrder {
    /// The mission, not yet checked.
    pub mission: MissionParameters<f32, USERS_MAX, SENSORS_MAX>,
    /// The position of the map's origin on Earth.
    pub map_origin: Geodetic,
    /// The limits of the vehicle.
    pub limits: Limits<f32>,
    /// The geofence that the vehicle must stay in.
    pub geofence: Option<Geofence<f32>>,
    /// The longest silence of the ground; the vehicle is landed after it.
    pub ground_patience: Option<Duration>,
    /// The policy to use.
    pub policy_kind: PolicyKind,
    /// The clock to use.
    pub clock: Clock,
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
}

/// A message from the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum BoardReport {
    /// The order was accepted.
    Ready,
    /// The order was refused for this reason; another may follow.
    Refused(String<TEXT_MAX>),
    /// A round is done.
    Tock(Tock),
    /// A description of an event.
    Event(String<TEXT_MAX>),
    /// The mission was aborted for this reason.
    BrokenOff(String<TEXT_MAX>),
    /// The use of memory.
    Footprint(Footprint),
}

/// Writes a call as a frame.
///
/// # Errors
/// Returns an error if the frame does not fit; [`CONSOLE_FRAME_MAX`] bytes always suffice.
pub fn encode_call<'f>(call: &Call, frame: &'f mut [u8]) -> Result<&'f [u8], FrameTooLong> {
    link::seal::<CONSOLE_FRAME_MAX>(CONSOLE_VERSION, call, frame)
}

/// The length of the longest frame of a [`BoardReport`].
pub const REPORT_FRAME_MAX: usize = 160;

/// Writes a report as a frame.
///
/// # Errors
/// Returns an error if the frame does not fit; [`REPORT_FRAME_MAX`] bytes always suffice.
pub fn encode_report<'f>(
    report: &BoardReport,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    link::seal::<REPORT_FRAME_MAX>(CONSOLE_VERSION, report, frame)
}

/// The board's decoder: finds calls in a stream of bytes.
#[derive(Clone, Debug, Default)]
pub struct Calls(Decoder<CONSOLE_FRAME_MAX>);

impl Calls {
    /// Takes a byte. At the end of a frame it returns the call, or the error if there is none.
    pub fn push(&mut self, byte: u8) -> Option<Result<Call, FrameError>> {
        self.0.push_of(CONSOLE_VERSION, byte)
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

/// The policies of a board.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // no allocator
pub enum BoardPolicy<B, P> {
    /// A trained policy in flash.
    Trained(Mlp<B>),
    /// The rule-based policy.
    StraightLine(StraightLine<f32, USERS_MAX>),
    /// The planner, or a reference to it: see [`board_planner`].
    Plan(P),
}

impl<B: AsRef<[u8]>, P: Policy<f32, USERS_MAX>> BoardPolicy<B, P> {
    fn chosen(&self) -> &dyn Policy<f32, USERS_MAX> {
        match self {
            Self::Trained(policy) => policy,
            Self::StraightLine(policy) => policy,
            Self::Plan(planner) => planner,
        }
    }

    fn chosen_mut(&mut self) -> &mut dyn Policy<f32, USERS_MAX> {
        match self {
            Self::Trained(policy) => policy,
            Self::StraightLine(policy) => policy,
            Self::Plan(planner) => planner,
        }
    }
}

impl<B: AsRef<[u8]>, P: Policy<f32, USERS_MAX>> Policy<f32, USERS_MAX> for BoardPolicy<B, P> {
    fn decide(&mut self, observation: &Observation<'_, f32>) -> Action<f32, USERS_MAX> {
        self.chosen_mut().decide(observation)
    }

    fn revise(&mut self, change: &MissionChange<f32>, slots_begun: u32) {
        self.chosen_mut().revise(change, slots_begun);
    }

    fn improve(&mut self, operations: u64) {
        self.chosen_mut().improve(operations);
    }

    fn quality(&self) -> Option<PlanQuality> {
        self.chosen().quality()
    }
}

/// Error returned when an order cannot be flown.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum OrderError {
    /// The mission is invalid.
    #[error(transparent)]
    Mission(#[from] MissionError<f32>),
    /// The trained policy is for another mission.
    #[error(transparent)]
    Policy(#[from] PolicyMismatch),
    /// The board's planner cannot plan the mission.
    #[error("planner: {0}")]
    Planner(#[from] PlannerError),
    /// The board has no planner.
    #[error("the board has no planner")]
    NoPlanner,
    /// The board has no trained policy.
    #[error("the board has no trained policy")]
    NoPolicy,
    /// The autopilot settings are invalid.
    #[error(transparent)]
    Flight(#[from] SettingsError),
    /// The board's watchdog cannot wait for one of the mission's slots.
    #[error("slots of {slot_s} s: the board's watchdog can wait for slots of at most {most_s} s")]
    SlotTooLong {
        /// `delta`, seconds.
        slot_s: f32,
        /// The longest slot that can be flown, seconds.
        most_s: f64,
    },
}

/// The time that a slot may take beyond twice its duration before a watchdog stops the board. It
/// covers late channel state, late samples and a slow bench.
const SLOT_MARGIN: Duration = Duration::from_secs(20);

/// Returns how long a board's watchdog waits for a slot of this duration.
pub fn slot_patience(slot_duration_s: f32) -> Duration {
    Duration::from_secs_f64(2.0 * f64::from(slot_duration_s)) + SLOT_MARGIN
}

impl MissionOrder {
    /// Checks whether a watchdog with the longest time-out `longest` can wait for a slot.
    ///
    /// # Errors
    /// Returns an error if it cannot: it would stop the board in a normal slot.
    pub fn check_watchdog(&self, longest: Duration) -> Result<(), OrderError> {
        let slot_s = self.mission.slot_duration_s;
        if slot_patience(slot_s) <= longest {
            return Ok(());
        }
        let most_s = longest.saturating_sub(SLOT_MARGIN).as_secs_f64() / 2.0;
        Err(OrderError::SlotTooLong { slot_s, most_s })
    }

    /// Returns the settings of the autopilot client.
    fn flight(&self) -> AutopilotSettings<f32> {
        let p = &self.mission;
        AutopilotSettings {
            limits: self.limits,
            geofence: self.geofence,
            watch: Watch {
                ground: self.ground_patience,
                ..Watch::default()
            },
            preflight: Preflight::of(p),
            ..AutopilotSettings::new(self.map_origin, p.start, p.altitude_m, p.max_speed_mps)
        }
    }

    /// Checks mission and autopilot settings, all that may be refused beside the policy, and returns
    /// the mission, for which a [`board_planner`] can then be created.
    ///
    /// # Errors
    /// Returns an error if the mission or the autopilot settings are invalid.
    pub fn check(&self) -> Result<BoardMission, OrderError> {
        self.flight().check()?;
        Ok(BoardMission::new(self.mission.clone())?)
    }

    /// Creates the onboard computer that flies this order. `trained` is the policy of the board, if
    /// it has one, and `planner` its planner for the mission, which is used where the order asks for
    /// [`PolicyKind::Plan`].
    ///
    /// # Errors
    /// Returns an error if the mission is invalid, if there is no such policy, if the policy is for
    /// another mission, or if the autopilot settings are invalid.
    pub fn build<B: AsRef<[u8]> + Clone, P: Policy<f32, USERS_MAX>>(
        &self,
        trained: Option<&Mlp<B>>,
        planner: Option<P>,
    ) -> Result<BoardComputer<B, P>, OrderError> {
        let mission = BoardMission::new(self.mission.clone())?;
        let policy = match self.policy_kind {
            PolicyKind::Trained => {
                let trained = trained.ok_or(OrderError::NoPolicy)?;
                trained.provenance().check(&mission)?;
                BoardPolicy::Trained(trained.clone())
            }
            PolicyKind::StraightLine => BoardPolicy::StraightLine(StraightLine::new(&mission)),
            PolicyKind::Plan => BoardPolicy::Plan(planner.ok_or(OrderError::NoPlanner)?),
        };
        let autopilot = Autopilot::new(self.flight())?;
        let controller = Controller::new(mission, policy);
        let settings = OnboardSettings {
            planning_operations: PLANNER_OPERATIONS_PER_POLL,
            ..OnboardSettings::default()
        };
        Ok(Onboard::new(settings, controller, autopilot))
    }
}

/// Converts a mission's parameters to single precision, as a [`MissionOrder`] carries them.
/// Positions are exact to 0.06 mm at a kilometre.
pub fn in_single_precision<T: Scalar, const M: usize, const J: usize>(
    p: &MissionParameters<T, M, J>,
) -> MissionParameters<f32, M, J> {
    use crate::mission::{Area, Environment, ExcessLoss};
    let number = |x: T| x.to_f64() as f32;
    let place = |place: &Position<T>| place.map(number);
    MissionParameters {
        slots: p.slots,
        slot_duration_s: number(p.slot_duration_s),
        start: place(&p.start),
        destination: place(&p.destination),
        area: Area {
            east_m: number(p.area.east_m),
            north_m: number(p.area.north_m),
        },
        altitude_m: number(p.altitude_m),
        max_speed_mps: number(p.max_speed_mps),
        carrier_hz: number(p.carrier_hz),
        environment: Environment {
            a: number(p.environment.a),
            b: number(p.environment.b),
        },
        excess_loss_db: ExcessLoss {
            los: number(p.excess_loss_db.los),
            nlos: number(p.excess_loss_db.nlos),
        },
        noise_power: crate::Watt(number(p.noise_power.0)),
        mse_threshold: number(p.mse_threshold),
        user_power_max: crate::Watt(number(p.user_power_max.0)),
        sensor_power_max: crate::Watt(number(p.sensor_power_max.0)),
        users: p.users.iter().map(place).collect(),
        sensors: p.sensors.iter().map(place).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_missions::table_one;

    fn order() -> MissionOrder {
        let mission = table_one::<f64>();
        MissionOrder {
            mission: in_single_precision(mission.parameters()),
            map_origin: Geodetic {
                latitude_e7: -353_632_621,
                longitude_e7: 1_491_652_374,
            },
            limits: Limits::ideal(),
            geofence: Some(Geofence {
                low: Position::new(-50.0, -50.0),
                high: Position::new(1050.0, 1050.0),
                ceiling_m: 150.0,
            }),
            ground_patience: Some(Duration::from_secs(1_000_000)),
            policy_kind: PolicyKind::StraightLine,
            clock: Clock::Console,
        }
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
        let mut buffer = [0; CONSOLE_FRAME_MAX];
        let frame = encode_call(&Call::Order(order.clone()), &mut buffer).expect("fits");
        let mut calls = Calls::default();
        let got: std::vec::Vec<_> = frame.iter().filter_map(|&b| calls.push(b)).collect();
        assert_eq!(got, [Ok(Call::Order(order))]);
    }

    /// A slot that a watchdog cannot wait for is refused, not flown until the watchdog bites.
    #[test]
    fn a_watchdog_waits_for_every_slot_that_is_flown() {
        let longest = Duration::from_secs(171);
        let mut order = order();
        for (slot_s, flown) in [(1.0, true), (75.5, true), (75.6, false), (200.0, false)] {
            order.mission.slot_duration_s = slot_s;
            let outcome = order.check_watchdog(longest);
            assert_eq!(outcome.is_ok(), flown, "{slot_s}: {outcome:?}");
            if let Err(why) = outcome {
                assert!(words(&why).contains("at most 75.5 s"), "{why}");
            } else {
                assert!(slot_patience(slot_s) >= Duration::from_secs_f64(2.0 * f64::from(slot_s)));
            }
        }
    }

    #[test]
    fn the_longest_report_fits_and_survives() {
        let text = words(&"x".repeat(200));
        assert_eq!(text.len(), TEXT_MAX);
        let report = BoardReport::BrokenOff(text);
        let mut buffer = [0; REPORT_FRAME_MAX];
        let frame = encode_report(&report, &mut buffer).expect("fits");
        let mut reports = Reports::default();
        let got: std::vec::Vec<_> = frame.iter().filter_map(|&b| reports.push(b)).collect();
        assert_eq!(got, [Ok(report)]);
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
        assert_eq!(frame[..8], [0, 11, 130, 1, 172, 2, 1, 2]);
    }
}
