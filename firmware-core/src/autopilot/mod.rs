//! The MAVLink client: flies the waypoints of the controller with a real autopilot.
//!
//! A state machine without I/O. The caller passes what came ([`Autopilot::receive`]) and the
//! time, asks for what is to be sent ([`Autopilot::poll`], until `None`), and sends it:
//!
//! ```text
//!            bytes                 messages              poll: messages          bytes
//!   link ───────────> wire::Decoder ───────> Autopilot ────────────> wire::Encoder ─────> link
//!                                              │   ▲
//!                       phase, position, ended │   │ launch, fly_leg, land, stop
//!                                              ▼   │
//!                                           slot cycle
//! ```
//!
//! # Terms
//!
//! * **phase**: where in a flight we are ([`Phase`]), from the first heartbeat to the landing.
//! * **leg**: the flight of one slot, to a waypoint that is due at the slot's end.
//! * **reference**: where the vehicle should be *now*; streamed as setpoints ([`guidance`]).
//! * **sample**: a measured position ([`Sample`]) with the time at which it was taken.
//! * **vehicle time**: the clock of the autopilot, which its samples are stamped with
//!   ([`clock`]). Legs, and so slots, begin and end in it. Time-outs run in ours.
//! * **tick**: the end of a leg. Where the vehicle was at a tick is interpolated between the
//!   samples around it; where the next sample is late, extrapolated from the last. No message,
//!   early, late or lost, moves a tick.
//! * **control**: we have it while the autopilot is in the mode that follows setpoints and we
//!   set that mode ourselves. Lost control is never taken back.
//!
//! # Rooms
//!
//! [`wire`] bytes and messages · [`frames`] map and north-east-down · [`profile`] differences
//! between autopilots · [`guidance`] trajectories · `command` acknowledged commands ·
//! `telemetry` what the vehicle last said · `state_machine` the phases · [`failsafe`] what can go
//! wrong · `checks` what is looked at before a flight · [`mission`] upload of a whole mission ·
//! [`preflight`] what refuses a start · `trial` what speed the airframe reaches.

mod checks;
pub mod clock;
mod command;
mod event;
pub mod failsafe;
pub mod frames;
pub mod guidance;
pub mod mission;
pub mod preflight;
pub mod profile;
mod rx;
mod settings;
mod state_machine;
mod telemetry;
mod trial;
mod tx;
pub mod wire;

use core::fmt;

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use checks::{Advice, ChangedParameter, Finding, advice};
pub use command::{CommandOutcome, Patience, Request};
pub use event::Event;
pub use settings::{AutopilotSettings, Coordinates, Geofence, OwnAddress, SettingsError};
pub use telemetry::Sample;

use crate::scalar::{Position, Scalar};
use crate::time::{Duration, Instant};
use checks::ParameterManager;
use command::Pending;
use event::Events;
use failsafe::Cause;
use frames::MapFrame;
use guidance::{Guide, Limits, Motion};
use preflight::PreflightRefusal;
use profile::{Firmware, Mode};
use telemetry::Telemetry;
use wire::Address;

/// Where in a flight the client is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// No autopilot has been heard yet.
    Connecting,
    /// Waits for a position estimate and the autopilot's own pre-arm checks.
    Checking,
    /// All checks passed; waits for [`Autopilot::launch`].
    Standby,
    /// Asks for the mode that follows setpoints.
    TakingControl,
    /// Asks for motors.
    Arming,
    /// Rises to the mission's altitude.
    TakingOff,
    /// Flies to the mission's start.
    Transit,
    /// Flies towards the destination and back, to show what speed the airframe reaches.
    Trial,
    /// Holds at the start; legs may come.
    Ready,
    /// Flies a leg.
    Leg,
    /// A leg has ended; the next may come.
    LegEnded,
    /// Lands.
    Landing,
    /// Stops the motors after a start that was broken off on the ground.
    Disarming,
    /// On the ground, motors off: the end of a flight.
    Landed,
    /// Somebody else flies. Nothing is sent any more that moves the vehicle.
    Released,
    /// Nothing more can be done.
    Failed,
}

impl Phase {
    /// The vehicle is in the air and follows our setpoints.
    pub fn is_flying(self) -> bool {
        matches!(
            self,
            Self::Transit | Self::Trial | Self::Ready | Self::Leg | Self::LegEnded
        )
    }

    /// Nothing will change any more.
    pub fn is_final(self) -> bool {
        matches!(self, Self::Landed | Self::Released | Self::Failed)
    }
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Connecting => "connecting",
            Self::Checking => "checking",
            Self::Standby => "standing by",
            Self::TakingControl => "taking control",
            Self::Arming => "arming",
            Self::TakingOff => "taking off",
            Self::Transit => "flying to the start",
            Self::Trial => "trying what speed the airframe reaches",
            Self::Ready => "ready",
            Self::Leg => "flying a leg",
            Self::LegEnded => "leg ended",
            Self::Landing => "landing",
            Self::Disarming => "disarming",
            Self::Landed => "landed",
            Self::Released => "control released",
            Self::Failed => "failed",
        })
    }
}

/// What the checks wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// No position sample yet.
    NoPosition,
    /// The estimator has no absolute position yet.
    NoEstimate,
    /// The autopilot has not said where its local frame begins.
    NoOrigin,
    /// The autopilot's pre-arm checks do not pass; its texts say why.
    PreArm,
    /// The vehicle is already armed, by somebody else.
    AlreadyArmed,
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoPosition => "no position yet",
            Self::NoEstimate => "the estimator has no absolute position yet",
            Self::NoOrigin => "the origin of the autopilot's local frame is not known yet",
            Self::PreArm => "the autopilot's pre-arm checks do not pass",
            Self::AlreadyArmed => "the vehicle is already armed",
        })
    }
}

/// One slot's flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg<T: Scalar> {
    /// Where to be at the end, m.
    pub waypoint: Position<T>,
    /// The slot's end, in vehicle time.
    pub end: Instant,
}

/// How a leg ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegEnd<T: Scalar> {
    /// Where the vehicle was at the tick.
    pub sample: Sample<T>,
    /// From there to the waypoint, m.
    pub missed_m: T,
    /// When and how that became known.
    pub tick: Tick,
}

/// The end of a slot, as the vehicle's clock has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tick {
    /// When, on the vehicle's clock.
    pub time: Instant,
    /// How much later the position was known, in vehicle time.
    pub lateness: Duration,
    /// No sample came in time: the position is extrapolated from the last one with its velocity.
    pub extrapolated: bool,
    /// Seconds of the vehicle's clock per second of ours, as estimated.
    pub clock_rate: f32,
}

/// Why a leg is not flown.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum LegError {
    /// The vehicle is not ready for legs.
    #[error("no leg can start while {0}")]
    Phase(Phase),
    /// The waypoint has a coordinate that is not finite.
    #[error("the way-point is not finite")]
    NotFinite,
    /// The waypoint is outside the geofence.
    #[error("the way-point ({x}, {y}) m lies outside the geofence")]
    OutsideFence {
        /// East, m.
        x: f64,
        /// North, m.
        y: f64,
    },
    /// Nothing is known yet of the vehicle's clock.
    #[error("the vehicle's clock is not known")]
    NoClock,
}

/// The leg under way.
#[derive(Clone, Copy, Debug)]
struct ActiveLeg<T: Scalar> {
    waypoint: Position<T>,
    end: Instant,
    from: Position<T>,
    /// How the reference ends; `None` where the leg came too late to be flown.
    reference_end: Option<Motion<T>>,
    /// The setpoint of the leg's end has been sent.
    final_sent: bool,
    /// It was echoed; in the autopilot's time, as MAVLink counts it.
    confirmed: Option<u32>,
    ended: Option<LegEnd<T>>,
}

/// The fraction of the mission's speed that the reference of a leg has at most: a vehicle that is
/// behind catches up by getting nearer, not by flying further in a slot than it may.
const LEG_SPEED: f64 = 0.985;

/// Setpoint timing and the last one sent.
#[derive(Clone, Copy, Debug)]
struct Stream<T: Scalar> {
    guide: Guide<T>,
    due: Instant,
    last: Motion<T>,
    /// Where a climb by setpoints began: time and altitude.
    climb: Option<(Instant, T)>,
}

/// The client. About 8 kB; see the module's documentation.
#[derive(Clone, Debug)]
pub struct Autopilot<T: Scalar> {
    settings: AutopilotSettings<T>,
    map: MapFrame<T>,
    phase: Phase,
    phase_since: Instant,
    vehicle: Option<(Address, Firmware)>,
    telemetry: Telemetry<T>,
    heartbeat_due: Instant,
    pending: Option<Pending>,
    /// Next step within [`Phase::Checking`]: telemetry that is still to be asked for.
    subscribed: u8,
    /// Telemetry that the autopilot refused for good: one bit for each step.
    refused_telemetry: u8,
    /// When the last of it was asked for.
    subscribed_at: Instant,
    obstacle: Option<Obstacle>,
    parameter_manager: ParameterManager,
    /// What the vehicle can do: the settings' limits within the parameters'.
    limits: Limits<T>,
    /// What the airframe reaches, as it is known or as the trial leg has shown, m/s.
    airframe_mps: Option<T>,
    trial: Option<trial::Trial<T>>,
    /// What the vehicle's parameters leave.
    parameter_limits: Limits<T>,
    /// When the origin of the local frame is asked for next.
    origin_due: Instant,
    launch: bool,
    /// The present phase's command: since when, and whether it was accepted.
    asked: Option<(Instant, bool)>,
    /// The vehicle has been in the air.
    flown: bool,
    /// Height of the place of take-off over the origin of the autopilot's local frame, which may
    /// lie elsewhere: where the estimator started, for one.
    ground_m: T,
    /// The mode we set and that a heartbeat has shown.
    holds: Option<Mode>,
    /// Modes that are ours while landing.
    landing_by: Option<Request>,
    stream: Option<Stream<T>>,
    /// By how much the vehicle follows the reference late, s; negative where it is early. Learned
    /// from tick to tick, and flown ahead by.
    lag_s: T,
    /// The last leg neither gathered nor lost speed.
    cruised: bool,
    leg: Option<ActiveLeg<T>>,
    ignored_legs: u8,
    ground_heard: Option<Instant>,
    fault: Option<Cause>,
    /// Why the start was refused.
    refusal: Option<PreflightRefusal>,
    /// How far outside the geofence the vehicle stood before take-off, m.
    stood_outside_m: T,
    silent: bool,
    /// Parameters are put back whatever the motors do.
    restore_now: bool,
    events: Events,
}

impl<T: Scalar> Autopilot<T> {
    /// A client that has heard nothing yet.
    pub fn new(settings: AutopilotSettings<T>) -> Result<Self, SettingsError> {
        settings.check()?;
        let mut client = Self {
            map: MapFrame::new(settings.map_origin),
            limits: settings.limits,
            parameter_limits: Limits::ideal(),
            airframe_mps: settings.airframe_speed_mps,
            trial: None,
            settings,
            phase: Phase::Connecting,
            phase_since: Instant::ZERO,
            vehicle: None,
            telemetry: Telemetry::new(),
            heartbeat_due: Instant::ZERO,
            pending: None,
            subscribed: 0,
            refused_telemetry: 0,
            subscribed_at: Instant::ZERO,
            obstacle: None,
            parameter_manager: ParameterManager::default(),
            origin_due: Instant::ZERO,
            launch: false,
            asked: None,
            flown: false,
            ground_m: T::zero(),
            holds: None,
            landing_by: None,
            stream: None,
            lag_s: T::zero(),
            cruised: false,
            leg: None,
            ignored_legs: 0,
            ground_heard: None,
            fault: None,
            refusal: None,
            stood_outside_m: T::zero(),
            silent: false,
            restore_now: false,
            events: Events::default(),
        };
        client.update_limits();
        Ok(client)
    }

    /// What it was told.
    pub fn settings(&self) -> &AutopilotSettings<T> {
        &self.settings
    }

    /// Where in the flight we are.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// What went wrong, if anything did: the first cause.
    pub fn fault(&self) -> Option<Cause> {
        self.fault
    }

    /// Why the start was refused, if it was: the phase is then [`Phase::Failed`].
    pub fn refusal(&self) -> Option<PreflightRefusal> {
        self.refusal
    }

    /// What the checks wait for.
    pub fn obstacle(&self) -> Option<Obstacle> {
        self.obstacle
    }

    /// The autopilot that is flown: its address and software.
    pub fn vehicle(&self) -> Option<(Address, Firmware)> {
        self.vehicle
    }

    /// The address that our frames carry: under the system id of the autopilot that is flown, or 1
    /// while none has been heard, unless the settings name another.
    pub fn own(&self) -> Address {
        let vehicle = self.vehicle.map(|(address, _)| address.system);
        self.settings.own.resolve(vehicle)
    }

    /// The latest measured position.
    pub fn position(&self) -> Option<Sample<T>> {
        self.telemetry.sample
    }

    /// The vehicle's clock at `now`; `None` before the first sample. Legs are given in it.
    pub fn vehicle_time(&self, now: Instant) -> Option<Instant> {
        self.telemetry.clock.vehicle_time(now)
    }

    /// Seconds of the vehicle's clock per second of ours, as estimated.
    pub fn clock_rate(&self) -> f64 {
        self.telemetry.clock.rate()
    }

    /// What the vehicle can do: the settings' limits, as its parameters clip them.
    pub fn limits(&self) -> &Limits<T> {
        &self.limits
    }

    /// Replaces the settings' limits, for a host that learns from the heartbeat which vehicle
    /// answers. What the vehicle's parameters leave is obeyed as before. Has no effect once the
    /// vehicle has been taken control of.
    ///
    /// # Errors
    /// A limit is not above zero.
    pub fn set_limits(&mut self, limits: Limits<T>) -> Result<(), SettingsError> {
        if !limits.is_valid() {
            return Err(SettingsError::Limits);
        }
        if matches!(
            self.phase,
            Phase::Connecting | Phase::Checking | Phase::Standby
        ) {
            self.settings.limits = limits;
            self.update_limits();
        }
        Ok(())
    }

    /// The vehicle's limits, after the settings' or the parameters' have changed.
    fn update_limits(&mut self) {
        let (settings, parameters) = (&self.settings.limits, &self.parameter_limits);
        let speed_mps = settings.speed_mps.min(parameters.speed_mps);
        let jerk_mps3 = settings.jerk_mps3.min(parameters.jerk_mps3);
        // An acceleration that takes longer than a second to turn into its opposite comes too late
        // to be counted on; a reference that changes it much faster is flown past.
        let acceleration_mps2 = settings
            .acceleration_mps2
            .min(parameters.acceleration_mps2)
            .min(jerk_mps3 / T::of(2.0));
        self.limits = Limits {
            speed_mps: self
                .airframe_mps
                .map_or(speed_mps, |mps| speed_mps.min(mps)),
            acceleration_mps2,
            jerk_mps3: jerk_mps3.min(acceleration_mps2 * T::of(3.0)),
        };
    }

    /// A parameter that the checks have read, in its own unit.
    pub fn parameter(&self, name: &str) -> Option<f32> {
        self.parameter_manager.value(name)
    }

    /// Every parameter that the checks have read, in its own unit.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static str, f32)> + '_ {
        self.parameter_manager.values()
    }

    /// Whether every parameter was read (and set, where that was asked for) or given up.
    pub fn parameters_are_read(&self) -> bool {
        self.vehicle
            .is_some_and(|(_, firmware)| self.parameter_manager.is_done(firmware))
    }

    /// The battery, percent, where the autopilot estimates it.
    pub fn battery_percent(&self) -> Option<i8> {
        self.telemetry.battery_percent
    }

    /// Whether the motors may turn.
    pub fn is_armed(&self) -> bool {
        self.telemetry.armed
    }

    /// The next thing that happened, oldest first.
    pub fn take_next_event(&mut self) -> Option<Event> {
        self.events.take()
    }

    /// Events that nobody took in time.
    pub fn lost_events(&self) -> u32 {
        self.events.lost()
    }

    /// Start the flight as soon as all checks pass: control, motors, climb, to the start.
    pub fn launch(&mut self, now: Instant) {
        self.launch = true;
        self.advance(now);
    }

    /// Flies to `leg.waypoint`, to be there at `leg.end`.
    pub fn fly_leg(&mut self, now: Instant, leg: Leg<T>) -> Result<(), LegError> {
        self.advance(now);
        if !matches!(self.phase, Phase::Ready | Phase::LegEnded) {
            return Err(LegError::Phase(self.phase));
        }
        let Some((sample, stream)) = self.telemetry.sample.zip(self.stream.as_mut()) else {
            return Err(LegError::Phase(self.phase));
        };
        if !(leg.waypoint.x.finite() && leg.waypoint.y.finite()) {
            return Err(LegError::NotFinite);
        }
        let (x, y) = (leg.waypoint.x.to_f64(), leg.waypoint.y.to_f64());
        if let Some(fence) = &self.settings.geofence
            && !fence.contains(&leg.waypoint, T::zero())
        {
            return Err(LegError::OutsideFence { x, y });
        }
        let Some(vehicle_now) = self.telemetry.clock.vehicle_time(now) else {
            return Err(LegError::NoClock);
        };
        // A leg that is over, or nearly, when it is decided cannot be flown any more: the vehicle
        // flies on as it does, and the slot ends on its tick nevertheless. Where a place is reached
        // the moment it is asked for, it is not too late.
        let mut reference_end = None;
        let flyable = leg.end > vehicle_now + self.settings.setpoint_interval / 2;
        if flyable || self.limits.is_ideal() {
            // A sample is some time old: the vehicle has flown on.
            let measured = sample.extrapolated(vehicle_now);
            let measured = Motion {
                velocity: sample.velocity,
                ..Motion::at_rest(measured.position)
            };
            let tolerance = self.settings.lag_tolerance_m;
            // A vehicle that follows late is at the waypoint in time if the reference is ahead.
            let way = leg.waypoint - sample.position;
            let slot_s = T::of((leg.end - sample.time).as_secs_f64());
            let aim = leg.waypoint + way * (self.lag_s / slot_s.max(self.lag_s.abs()));
            if !self.limits.is_ideal() {
                let speed_mps = self.settings.transit_speed_mps * T::of(LEG_SPEED);
                stream.guide.set_limits(Limits {
                    speed_mps: self.limits.speed_mps.min(speed_mps),
                    ..self.limits
                });
            }
            stream
                .guide
                .fly_leg(vehicle_now, leg.end, aim, measured, tolerance);
            stream.due = now;
            reference_end = Some(stream.guide.target());
        }
        // The ground has something to say from the first leg on.
        self.ground_heard.get_or_insert(now);
        self.leg = Some(ActiveLeg {
            waypoint: leg.waypoint,
            end: leg.end,
            from: sample.position,
            reference_end,
            final_sent: !flyable && !self.limits.is_ideal(),
            confirmed: None,
            ended: None,
        });
        self.enter(now, Phase::Leg);
        Ok(())
    }

    /// How the last leg ended, once it has.
    pub fn leg_ended(&mut self, now: Instant) -> Option<LegEnd<T>> {
        self.advance(now);
        self.leg.as_ref().and_then(|leg| leg.ended)
    }

    /// Lands where the vehicle is; the end of a mission.
    pub fn land(&mut self, now: Instant) {
        self.end_flight(now, Request::Land);
    }

    /// Returns to the place of take-off and lands there; the end of a mission.
    pub fn return_and_land(&mut self, now: Instant) {
        self.end_flight(now, Request::Return);
    }

    /// A person asked us to stop: lands from flight, stops the motors on the ground, does
    /// nothing if the flight has not begun or somebody else flies.
    pub fn stop(&mut self, now: Instant) {
        self.fail(now, Cause::StopAsked);
    }

    /// How long the autopilot's heartbeat may be missing: twice as long where it comes once a
    /// second whatever is asked for, and five in a row are lost on a bad link now and then.
    fn heartbeat_patience(&self) -> Duration {
        let steady = self
            .vehicle
            .is_some_and(|(_, firmware)| !firmware.sends_heartbeats_on_request());
        self.settings.watch.heartbeat * if steady { 2 } else { 1 }
    }

    /// Whether parameters that were set for the flight are as they were, or there were none. In a
    /// final phase with motors off they are put back; keep polling until this is true.
    pub fn is_restored(&self) -> bool {
        self.parameter_manager.is_restored()
    }

    /// Parameters that are not as they were found, oldest first. One appears here before the
    /// message that changes it is given out by [`Autopilot::poll`]: a caller that writes the list
    /// down after every [`Autopilot::receive`] can put everything back, even after a crash.
    pub fn changed_parameters(&self) -> &[ChangedParameter] {
        self.parameter_manager.changed()
    }

    /// Parameters that an earlier run changed and did not put back: that is done as soon as the
    /// motors stand still, before anything is read. To be called before the first heartbeat has
    /// been answered, which is before the next [`Autopilot::poll`] after it.
    pub fn restore_first(&mut self, changes: &[ChangedParameter]) {
        self.parameter_manager.restore_first(changes);
    }

    /// Puts parameters back from now on, even while the motors turn: the caller is about to leave.
    pub fn restore_now(&mut self) {
        self.restore_now = true;
    }

    /// Whether a landing has been asked for and the autopilot has not begun it yet: until it has,
    /// leaving would leave the vehicle without an order.
    pub fn awaits_landing(&self) -> bool {
        let ours = self.vehicle.map(|(_, firmware)| firmware.control_mode());
        self.phase == Phase::Landing && self.telemetry.armed && self.holds == ours
    }

    /// For how long the latched autopilot has not been heard; `None` before its first heartbeat.
    pub fn heartbeat_age(&self, now: Instant) -> Option<Duration> {
        Some(now - self.telemetry.heartbeat_came?)
    }

    /// Whether the autopilot has not been heard for [`failsafe::Watch::heartbeat`]: the link, or
    /// what is at its other end, is dead for now.
    pub fn is_link_silent(&self, now: Instant) -> bool {
        self.was_silent_for(now, Duration::ZERO)
    }

    /// Whether the silence has lasted for [`failsafe::Watch::link_dead`] longer than that.
    pub fn is_link_dead(&self, now: Instant) -> bool {
        self.was_silent_for(now, self.settings.watch.link_dead)
    }

    /// Whether the link has counted as silent for `since`: no heartbeat came, or, once positions
    /// flow, nothing at all.
    fn was_silent_for(&self, now: Instant, since: Duration) -> bool {
        let Some(age) = self.heartbeat_age(now) else {
            return false;
        };
        let nothing = self.telemetry.sample.is_some()
            && now - self.telemetry.heard > self.settings.watch.heartbeat + since;
        nothing || age > self.heartbeat_patience() + since
    }

    /// Gives up putting parameters back: an event for each says what it was.
    pub fn abandon_parameters(&mut self) {
        let Some((_, firmware)) = self.vehicle else {
            return;
        };
        while let Some(finding) = self.parameter_manager.give_up(firmware) {
            self.events.push(Event::Finding(finding));
        }
    }

    /// The ground was heard (see [`failsafe::Watch::ground`]).
    pub fn note_ground_link(&mut self, now: Instant) {
        self.ground_heard = Some(now);
    }
}
