//! The console: a board's third serial line, over which somebody tells it what to fly.
//!
//! An image holds no mission. Before a flight it takes a [`MissionOrder`]: the mission, the vehicle's
//! limits, who decides and whose clock counts. It answers [`BoardReport::Ready`], or refuses and says
//! why; then it flies. Frames are those of the [ground link](crate::link) under a version of their
//! own, always in single precision.
//!
//! # Whose clock
//!
//! In the air the board's own timer counts. On a bench ([`Clock::Console`]) time comes over the
//! console, so that board and world stay in step however fast either computes:
//!
//! ```text
//! bench                                             board
//!   ground bytes, MAVLink bytes  ------------------->  waits until it has as many as Tick says,
//!   Tick { now, ground_bytes, mavlink_bytes }  ----->  takes them, does one round at `now`,
//!   waits until it has as many as Tock says  <-------  ground bytes, MAVLink bytes
//!                                            <-------  Tock { ground_bytes, mavlink_bytes, .. }
//! ```
//!
//! The three lines are not ordered among one another; the counts make them so. A flight on a
//! bench is therefore the same, byte for byte, each time.

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
    mission::{MissionError, MissionParameters},
    onboard::{self, Onboard, Stage},
    policy::{Action, Observation, Policy, PolicyMismatch, StraightLine, mlp::Mlp},
    scalar::{Position, Scalar},
    time::{Duration, Instant},
};

/// The version of the console's messages. Any change of one is a new one.
pub const CONSOLE_VERSION: u8 = 129;

/// The longest frame: an order with as many users and sensors as there may be.
pub const CONSOLE_FRAME_MAX: usize = 832;

/// The longest line of text.
pub const TEXT_MAX: usize = 120;

/// A mission in the board's precision.
pub type BoardMission = Mission<f32, USERS_MAX, SENSORS_MAX>;

/// The onboard computer of a board whose policy lies in its flash.
pub type BoardComputer<B> = Onboard<f32, BoardPolicy<B>, USERS_MAX, SENSORS_MAX>;

/// Who decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PolicyKind {
    /// The trained policy in the board's flash.
    Trained,
    /// Straight to the destination, nearest user.
    StraightLine,
}

/// Whose clock counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Clock {
    /// The board's own timer.
    Board,
    /// Time comes in [`Tick`]s.
    Console,
}

/// All that a board is told before a flight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MissionOrder {
    /// What to fly, not yet checked.
    pub mission: MissionParameters<f32, USERS_MAX, SENSORS_MAX>,
    /// Where the map's origin lies on Earth.
    pub map_origin: Geodetic,
    /// What the vehicle can do.
    pub limits: Limits<f32>,
    /// Where it may be sent.
    pub geofence: Option<Geofence<f32>>,
    /// How long the ground may be silent before the vehicle is landed.
    pub ground_patience: Option<Duration>,
    /// Who decides.
    pub policy_kind: PolicyKind,
    /// Whose clock counts.
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

/// What a board did in a round.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tock {
    /// Bytes that it sent over the ground link so far, modulo 2^32.
    pub ground_bytes: u32,
    /// Bytes that it sent over MAVLink so far, modulo 2^32.
    pub mavlink_bytes: u32,
    /// Where in the mission it is.
    pub stage: Stage,
    /// Where in the flight its MAVLink client is.
    pub phase: Phase,
    /// Where it measured itself to be, and how high: metres.
    pub place: Option<(Position<f32>, f32)>,
    /// What this round cost.
    pub cost: Cost,
}

/// Time on the board's clock, nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cost {
    /// All of it.
    pub round_ns: u32,
    /// Of that, planning; 0 where no slot was planned.
    pub plan_ns: u32,
    /// Of that, allocating; 0 where no slot was allocated.
    pub allocate_ns: u32,
}

/// What lies in a board's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Footprint {
    /// The most stack that was ever in use, bytes.
    pub stack_bytes: u32,
    /// The onboard computer itself, bytes.
    pub computer_bytes: u32,
    /// Bytes that came in and had no room.
    pub lost_bytes: u32,
    /// Frames to send that had no room.
    pub unsent_frames: u32,
}

/// To the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // no allocator
pub enum Call {
    /// Fly this.
    Order(MissionOrder),
    /// On a bench: a moment of time.
    Tick(Tick),
    /// Land: a person asks for it.
    Stop,
    /// Say what lies in memory.
    Footprint,
}

/// From the board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum BoardReport {
    /// The order was taken.
    Ready,
    /// It was not, and why; another may follow.
    Refused(String<TEXT_MAX>),
    /// A round is done.
    Tock(Tock),
    /// Something happened, in words.
    Event(String<TEXT_MAX>),
    /// The mission was broken off, and why.
    BrokenOff(String<TEXT_MAX>),
    /// What was asked.
    Footprint(Footprint),
}

/// Writes a call as a frame.
///
/// # Errors
/// It does not fit; [`CONSOLE_FRAME_MAX`] bytes always suffice.
pub fn encode_call<'f>(call: &Call, frame: &'f mut [u8]) -> Result<&'f [u8], FrameTooLong> {
    link::seal::<CONSOLE_FRAME_MAX>(CONSOLE_VERSION, call, frame)
}

/// The longest frame of a [`BoardReport`].
pub const REPORT_FRAME_MAX: usize = 160;

/// Writes a report as a frame.
///
/// # Errors
/// It does not fit; [`REPORT_FRAME_MAX`] bytes always suffice.
pub fn encode_report<'f>(
    report: &BoardReport,
    frame: &'f mut [u8],
) -> Result<&'f [u8], FrameTooLong> {
    link::seal::<REPORT_FRAME_MAX>(CONSOLE_VERSION, report, frame)
}

/// The board's end: finds calls among bytes.
#[derive(Clone, Debug, Default)]
pub struct Calls(Decoder<CONSOLE_FRAME_MAX>);

impl Calls {
    /// Takes a byte. At the end of a frame: its call, or why it has none.
    pub fn push(&mut self, byte: u8) -> Option<Result<Call, FrameError>> {
        self.0.push_of(CONSOLE_VERSION, byte)
    }
}

/// The other end: finds reports among bytes.
#[derive(Clone, Debug, Default)]
pub struct Reports(Decoder<REPORT_FRAME_MAX>);

impl Reports {
    /// Takes a byte. At the end of a frame: its report, or why it has none.
    pub fn push(&mut self, byte: u8) -> Option<Result<BoardReport, FrameError>> {
        self.0.push_of(CONSOLE_VERSION, byte)
    }
}

/// Words, cut where they would not fit.
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
    // What does not fit is meant to be lost.
    let _ = core::fmt::Write::write_fmt(&mut cut, format_args!("{what}"));
    cut.0
}

/// The deciders of a board.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)] // no allocator
pub enum BoardPolicy<B> {
    /// In flash.
    Trained(Mlp<B>),
    /// The rule.
    StraightLine(StraightLine<f32, USERS_MAX>),
}

impl<B: AsRef<[u8]>> Policy<f32, USERS_MAX> for BoardPolicy<B> {
    fn decide(&mut self, observation: &Observation<'_, f32>) -> Action<f32, USERS_MAX> {
        match self {
            Self::Trained(policy) => policy.decide(observation),
            Self::StraightLine(policy) => policy.decide(observation),
        }
    }
}

/// Why an order is not flown.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum OrderError {
    /// The mission is none.
    #[error(transparent)]
    Mission(#[from] MissionError<f32>),
    /// The trained policy is for another one.
    #[error(transparent)]
    Policy(#[from] PolicyMismatch),
    /// There is none.
    #[error("there is no trained policy here")]
    NoPolicy,
    /// It cannot be flown so.
    #[error(transparent)]
    Flight(#[from] SettingsError),
    /// The board's watchdog cannot wait for one of its slots.
    #[error("slots of {slot_s} s: the board's watchdog can wait for slots of at most {most_s} s")]
    SlotTooLong {
        /// `delta`, seconds.
        slot_s: f32,
        /// The longest that can be flown, seconds.
        most_s: f64,
    },
}

/// What a slot may take beyond twice its duration before a watchdog stops the board: channel state
/// that is late, samples that are late, and a bench that is slow.
const SLOT_MARGIN: Duration = Duration::from_secs(20);

/// How long a board's watchdog waits for a slot of so many seconds.
pub fn slot_patience(slot_duration_s: f32) -> Duration {
    Duration::from_secs_f64(2.0 * f64::from(slot_duration_s)) + SLOT_MARGIN
}

impl MissionOrder {
    /// Whether a watchdog that can be told to wait `longest` can wait for a slot.
    ///
    /// # Errors
    /// It cannot: it would stop the board in a slot that is flown as it should be.
    pub fn check_watchdog(&self, longest: Duration) -> Result<(), OrderError> {
        let slot_s = self.mission.slot_duration_s;
        if slot_patience(slot_s) <= longest {
            return Ok(());
        }
        let most_s = longest.saturating_sub(SLOT_MARGIN).as_secs_f64() / 2.0;
        Err(OrderError::SlotTooLong { slot_s, most_s })
    }

    /// The onboard computer that flies this order; `trained` is the policy at hand.
    ///
    /// # Errors
    /// A mission that is none, a policy that is for another one, settings that cannot be flown.
    pub fn build<B: AsRef<[u8]> + Clone>(
        &self,
        trained: Option<&Mlp<B>>,
    ) -> Result<BoardComputer<B>, OrderError> {
        let mission = BoardMission::new(self.mission.clone())?;
        let policy = match self.policy_kind {
            PolicyKind::Trained => {
                let trained = trained.ok_or(OrderError::NoPolicy)?;
                trained.provenance().check(&mission)?;
                BoardPolicy::Trained(trained.clone())
            }
            PolicyKind::StraightLine => BoardPolicy::StraightLine(StraightLine::new(&mission)),
        };
        let p = &self.mission;
        let flight = AutopilotSettings {
            limits: self.limits,
            geofence: self.geofence,
            watch: Watch {
                ground: self.ground_patience,
                ..Watch::default()
            },
            preflight: Preflight::of(p),
            ..AutopilotSettings::new(self.map_origin, p.start, p.altitude_m, p.max_speed_mps)
        };
        let autopilot = Autopilot::new(flight)?;
        let controller = Controller::new(mission, policy);
        Ok(Onboard::new(
            onboard::OnboardSettings::default(),
            controller,
            autopilot,
        ))
    }
}

/// A mission's parameters in single precision, as a [`MissionOrder`] carries them: places to 0.06 mm in
/// a kilometre.
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
        assert_eq!(frame[..8], [0, 11, 129, 1, 172, 2, 1, 2]);
    }
}
