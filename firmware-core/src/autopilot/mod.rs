//! The MAVLink client: flies the waypoints of the controller with a real autopilot.
//!
//! The client is a state machine without I/O. The caller passes received messages
//! ([`Autopilot::receive`]) and the time, asks for the messages to send ([`Autopilot::poll`], until
//! `None`), and sends them:
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
//! * **phase**: the part of a flight that the client is in ([`Phase`]), from the first heartbeat to
//!   the landing.
//! * **leg**: the flight of one slot, to a waypoint that is due at the slot's end.
//! * **reference**: where the vehicle should be *now*; streamed as setpoints ([`guidance`]).
//! * **sample**: a measured position ([`Sample`]) with the time at which it was taken.
//! * **vehicle time**: the clock of the autopilot, with which its samples are stamped ([`clock`]).
//!   Legs, and so slots, begin and end in it. Time-outs run on our own clock.
//! * **tick**: the end of a leg. The position at a tick is interpolated between the samples around
//!   it, or extrapolated from the last sample where the next one is late. No message, early, late
//!   or lost, moves a tick.
//! * **control**: the client has control while the autopilot is in the mode that follows setpoints
//!   and the client set that mode itself. Lost control is never taken back.
//!
//! # Modules
//!
//! [`wire`] bytes and messages · [`frames`] map and north-east-down · [`profile`] differences
//! between autopilots · [`guidance`] trajectories · `command` acknowledged commands · `telemetry`
//! the latest state of the vehicle · `state_machine` the phases · `rx` received messages · `tx`
//! messages to send · [`failsafe`] causes and reactions · `checks` parameters that are read and set
//! before a flight · [`mission`] upload of a whole mission · [`preflight`] reasons to refuse a
//! start · `trial` measurement of the airframe's speed

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

/// The phase of a flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Phase {
    /// No autopilot has been heard yet.
    Connecting,
    /// The client waits for a position estimate and the autopilot's own pre-arm checks.
    Checking,
    /// All checks passed; the client waits for [`Autopilot::launch`].
    Standby,
    /// The client requests the mode that follows setpoints.
    TakingControl,
    /// The client requests that the motors are armed.
    Arming,
    /// The vehicle climbs to the mission's altitude.
    TakingOff,
    /// The vehicle flies to the mission's start.
    Transit,
    /// The vehicle flies towards the destination and back, to measure what speed the airframe
    /// reaches.
    Trial,
    /// The vehicle holds at the start; the client accepts legs.
    Ready,
    /// The vehicle flies a leg.
    Leg,
    /// A leg has ended; the client accepts the next one.
    LegEnded,
    /// The vehicle lands.
    Landing,
    /// The motors are stopped after a start that was aborted on the ground.
    Disarming,
    /// The vehicle is on the ground with motors off: the end of a flight.
    Landed,
    /// The pilot or the autopilot itself has taken control. Nothing is sent any more that moves the
    /// vehicle.
    Released,
    /// The flight has failed; nothing more can be done.
    Failed,
}

impl Phase {
    /// Returns whether the vehicle is in the air and follows our setpoints.
    pub fn is_flying(self) -> bool {
        matches!(
            self,
            Self::Transit | Self::Trial | Self::Ready | Self::Leg | Self::LegEnded
        )
    }

    /// Returns whether the phase is final.
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

/// A condition that the checks wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Obstacle {
    /// No position sample yet.
    NoPosition,
    /// The estimator has no absolute position yet.
    NoEstimate,
    /// The autopilot has not reported the origin of its local frame.
    NoOrigin,
    /// The autopilot's pre-arm checks do not pass; its texts give the reason.
    PreArm,
    /// The vehicle is already armed, but not by this client.
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

/// The flight of one slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg<T: Scalar> {
    /// The place to be at by the end, m.
    pub waypoint: Position<T>,
    /// The slot's end, in vehicle time.
    pub end: Instant,
}

/// The end of a leg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegEnd<T: Scalar> {
    /// The state of the vehicle at the tick.
    pub sample: Sample<T>,
    /// The distance from there to the waypoint, m.
    pub missed_m: T,
    /// The time of the end, and how it was determined.
    pub tick: Tick,
}

/// The end of a slot, on the vehicle's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tick {
    /// The time, on the vehicle's clock.
    pub time: Instant,
    /// How much later the position became known, in vehicle time.
    pub lateness: Duration,
    /// No sample was received in time: the position is extrapolated from the last one with its
    /// velocity.
    pub extrapolated: bool,
    /// The estimated rate of the vehicle's clock, in its seconds per second of ours.
    pub clock_rate: f32,
}

/// Error returned when a leg cannot be flown.
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
    /// The vehicle's clock is not known yet.
    #[error("the vehicle's clock is not known")]
    NoClock,
}

/// The present leg.
#[derive(Clone, Copy, Debug)]
struct ActiveLeg<T: Scalar> {
    waypoint: Position<T>,
    end: Instant,
    from: Position<T>,
    /// The state of the reference at its end; `None` where the leg came too late to be flown.
    reference_end: Option<Motion<T>>,
    /// The setpoint of the leg's end was sent.
    final_sent: bool,
    /// The time at which it was echoed, on the autopilot's clock as MAVLink counts it.
    confirmed: Option<u32>,
    ended: Option<LegEnd<T>>,
}

/// The largest fraction of the mission's speed that the reference of a leg has: a vehicle that is
/// behind catches up by getting closer to it, not by flying further in a slot than allowed.
const LEG_SPEED: f64 = 0.985;

/// The state of the setpoint stream: timing and the last setpoint sent.
#[derive(Clone, Copy, Debug)]
struct Stream<T: Scalar> {
    guide: Guide<T>,
    due: Instant,
    last: Motion<T>,
    /// Time and altitude at the start of a climb by setpoints.
    climb: Option<(Instant, T)>,
}

/// The MAVLink client. About 8 kB; see the module's documentation.
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
    /// The next step within [`Phase::Checking`]: the telemetry to request next.
    subscribed: u8,
    /// Telemetry that the autopilot refused for good: one bit for each step.
    refused_telemetry: u8,
    /// The time of the last such request.
    subscribed_at: Instant,
    obstacle: Option<Obstacle>,
    parameter_manager: ParameterManager,
    /// The limits of the vehicle: the settings' limits within those of the parameters.
    limits: Limits<T>,
    /// The speed that the airframe reaches, as configured or as measured by the trial leg, m/s.
    airframe_mps: Option<T>,
    trial: Option<trial::Trial<T>>,
    /// The limits that the vehicle's parameters impose.
    parameter_limits: Limits<T>,
    /// The time at which the origin of the local frame is requested next.
    origin_due: Instant,
    launch: bool,
    /// The command of the present phase: the time of the request, and whether it was accepted.
    asked: Option<(Instant, bool)>,
    /// The vehicle has been in the air.
    flown: bool,
    /// The height of the place of take-off above the origin of the autopilot's local frame, which
    /// may be elsewhere, for example where the estimator started.
    ground_m: T,
    /// The mode that we set and that a heartbeat has confirmed.
    holds: Option<Mode>,
    /// The command that started the landing.
    landing_by: Option<Request>,
    stream: Option<Stream<T>>,
    /// The time by which the vehicle follows the reference late, s; negative where it is early. It
    /// is estimated from tick to tick, and the reference is moved ahead by it.
    lag_s: T,
    /// The last leg neither gained nor lost speed.
    cruised: bool,
    leg: Option<ActiveLeg<T>>,
    ignored_legs: u8,
    ground_heard: Option<Instant>,
    fault: Option<Cause>,
    /// The reason why the start was refused.
    refusal: Option<PreflightRefusal>,
    /// The distance of the vehicle to the geofence before take-off where it stood outside, m.
    stood_outside_m: T,
    silent: bool,
    /// Parameters are restored even if the motors turn.
    restore_now: bool,
    events: Events,
}

impl<T: Scalar> Autopilot<T> {
    /// Creates a client that has received nothing.
    ///
    /// # Errors
    /// Returns an error if a setting is invalid.
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

    /// Returns the settings.
    pub fn settings(&self) -> &AutopilotSettings<T> {
        &self.settings
    }

    /// Returns the phase of the flight.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Returns the first failure of the flight, if there was one.
    pub fn fault(&self) -> Option<Cause> {
        self.fault
    }

    /// Returns why the start was refused, if it was: the phase is then [`Phase::Failed`].
    pub fn refusal(&self) -> Option<PreflightRefusal> {
        self.refusal
    }

    /// Returns the condition that the checks wait for.
    pub fn obstacle(&self) -> Option<Obstacle> {
        self.obstacle
    }

    /// Returns the address and software of the autopilot that is flown.
    pub fn vehicle(&self) -> Option<(Address, Firmware)> {
        self.vehicle
    }

    /// Returns the address that our frames carry. Its system id is that of the autopilot that is
    /// flown, or 1 while none has been heard, unless the settings contain another.
    pub fn own(&self) -> Address {
        let vehicle = self.vehicle.map(|(address, _)| address.system);
        self.settings.own.resolve(vehicle)
    }

    /// Returns the latest measured position.
    pub fn position(&self) -> Option<Sample<T>> {
        self.telemetry.sample
    }

    /// Returns the vehicle's clock at `now`, or `None` before the first sample. The times of legs
    /// are on this clock.
    pub fn vehicle_time(&self, now: Instant) -> Option<Instant> {
        self.telemetry.clock.vehicle_time(now)
    }

    /// Returns the estimated rate of the vehicle's clock, in its seconds per second of ours.
    pub fn clock_rate(&self) -> f64 {
        self.telemetry.clock.rate()
    }

    /// Returns the limits of the vehicle: the settings' limits within those of the vehicle's
    /// parameters.
    pub fn limits(&self) -> &Limits<T> {
        &self.limits
    }

    /// Replaces the settings' limits, for a host that learns from the heartbeat which vehicle it is
    /// connected to. The limits of the vehicle's parameters still apply. Has no effect once the
    /// client has taken control.
    ///
    /// # Errors
    /// Returns an error if a limit is not above zero.
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

    /// Updates the vehicle's limits after the settings' or the parameters' limits have changed.
    fn update_limits(&mut self) {
        let (settings, parameters) = (&self.settings.limits, &self.parameter_limits);
        let speed_mps = settings.speed_mps.min(parameters.speed_mps);
        let jerk_mps3 = settings.jerk_mps3.min(parameters.jerk_mps3);
        // An acceleration that takes longer than a second to change to its opposite comes too late
        // to be used; a reference that changes it much faster is overshot.
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

    /// Returns the value of a parameter that the checks have read, in its own unit.
    pub fn parameter(&self, name: &str) -> Option<f32> {
        self.parameter_manager.value(name)
    }

    /// Returns all parameters that the checks have read, in their own units.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static str, f32)> + '_ {
        self.parameter_manager.values()
    }

    /// Returns whether every parameter was read (and set, where that was requested) or given up.
    pub fn parameters_are_read(&self) -> bool {
        self.vehicle
            .is_some_and(|(_, firmware)| self.parameter_manager.is_done(firmware))
    }

    /// Returns the charge of the battery, percent, where the autopilot estimates it.
    pub fn battery_percent(&self) -> Option<i8> {
        self.telemetry.battery_percent
    }

    /// Returns whether the motors may turn.
    pub fn is_armed(&self) -> bool {
        self.telemetry.armed
    }

    /// Removes and returns the oldest event.
    pub fn take_next_event(&mut self) -> Option<Event> {
        self.events.take()
    }

    /// Returns the number of events that were lost because the queue was full.
    pub fn lost_events(&self) -> u32 {
        self.events.lost()
    }

    /// Starts the flight as soon as all checks pass: takes control, arms, climbs, and flies to the
    /// start.
    pub fn launch(&mut self, now: Instant) {
        self.launch = true;
        self.advance(now);
    }

    /// Flies to `leg.waypoint`, to arrive there at `leg.end`.
    ///
    /// # Errors
    /// Returns an error if the vehicle is not ready for a leg, if the waypoint is not finite or
    /// outside the geofence, or if the vehicle's clock is not known.
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
        // continues its motion, and the slot still ends at its tick. An ideal vehicle reaches its
        // waypoint at once, so it is never too late.
        let mut reference_end = None;
        let flyable = leg.end > vehicle_now + self.settings.setpoint_interval / 2;
        if flyable || self.limits.is_ideal() {
            // A sample is some time old: the vehicle has flown on since.
            let measured = sample.extrapolated(vehicle_now);
            let measured = Motion {
                velocity: sample.velocity,
                ..Motion::at_rest(measured.position)
            };
            let tolerance = self.settings.lag_tolerance_m;
            // A vehicle that follows late reaches the waypoint in time if the reference is ahead.
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
        // The ground link is supervised from the first leg on.
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

    /// Returns how the last leg ended, once it has.
    pub fn leg_ended(&mut self, now: Instant) -> Option<LegEnd<T>> {
        self.advance(now);
        self.leg.as_ref().and_then(|leg| leg.ended)
    }

    /// Lands where the vehicle is. This ends the mission.
    pub fn land(&mut self, now: Instant) {
        self.end_flight(now, Request::Land);
    }

    /// Returns to the place of take-off and lands there. This ends the mission.
    pub fn return_and_land(&mut self, now: Instant) {
        self.end_flight(now, Request::Return);
    }

    /// Stops because a person asked for it: lands from flight, stops the motors on the ground, and
    /// does nothing if the flight has not begun or someone else has control.
    pub fn stop(&mut self, now: Instant) {
        self.fail(now, Cause::StopAsked);
    }

    /// Returns how long the autopilot's heartbeat may be missing: twice as long where it always
    /// comes once a second, because a bad link sometimes loses several in a row.
    fn heartbeat_patience(&self) -> Duration {
        let steady = self
            .vehicle
            .is_some_and(|(_, firmware)| !firmware.sends_heartbeats_on_request());
        self.settings.watch.heartbeat * if steady { 2 } else { 1 }
    }

    /// Returns whether all parameters that were set for the flight have been restored, or none was
    /// set. They are restored in a final phase with motors off; keep polling until this is true.
    pub fn is_restored(&self) -> bool {
        self.parameter_manager.is_restored()
    }

    /// Returns the parameters that differ from their original values, oldest first. A parameter
    /// appears here before [`Autopilot::poll`] returns the message that changes it: a caller that
    /// saves the list after every [`Autopilot::receive`] can restore everything, even after a
    /// crash.
    pub fn changed_parameters(&self) -> &[ChangedParameter] {
        self.parameter_manager.changed()
    }

    /// Sets the parameters that an earlier run changed and did not restore. They are restored as
    /// soon as the motors stand still, before anything is read. Must be called before the first
    /// [`Autopilot::poll`] after the first heartbeat.
    pub fn restore_first(&mut self, changes: &[ChangedParameter]) {
        self.parameter_manager.restore_first(changes);
    }

    /// Restores parameters from now on, even while the motors turn, because the caller is about to
    /// exit.
    pub fn restore_now(&mut self) {
        self.restore_now = true;
    }

    /// Returns whether a landing was requested and the autopilot has not started it yet. A caller
    /// that exits before then would leave the vehicle without a command.
    pub fn awaits_landing(&self) -> bool {
        let ours = self.vehicle.map(|(_, firmware)| firmware.control_mode());
        self.phase == Phase::Landing && self.telemetry.armed && self.holds == ours
    }

    /// Returns the time since the last heartbeat of the autopilot, or `None` before the first one.
    pub fn heartbeat_age(&self, now: Instant) -> Option<Duration> {
        Some(now - self.telemetry.heartbeat_came?)
    }

    /// Returns whether the autopilot has not been heard for [`failsafe::Watch::heartbeat`]: the
    /// link, or the autopilot, does not work at present.
    pub fn is_link_silent(&self, now: Instant) -> bool {
        self.was_silent_for(now, Duration::ZERO)
    }

    /// Returns whether the silence has lasted for [`failsafe::Watch::link_dead`] longer than that.
    pub fn is_link_dead(&self, now: Instant) -> bool {
        self.was_silent_for(now, self.settings.watch.link_dead)
    }

    /// Returns whether the link has counted as silent for `duration`: no heartbeat was received,
    /// or, once positions are received, nothing at all.
    fn was_silent_for(&self, now: Instant, duration: Duration) -> bool {
        let Some(age) = self.heartbeat_age(now) else {
            return false;
        };
        let nothing = self.telemetry.sample.is_some()
            && now - self.telemetry.heard > self.settings.watch.heartbeat + duration;
        nothing || age > self.heartbeat_patience() + duration
    }

    /// Gives up restoring parameters. An event for each parameter states its original value.
    pub fn abandon_parameters(&mut self) {
        let Some((_, firmware)) = self.vehicle else {
            return;
        };
        while let Some(finding) = self.parameter_manager.give_up(firmware) {
            self.events.push(Event::Finding(finding));
        }
    }

    /// Records that the ground was heard (see [`failsafe::Watch::ground`]).
    pub fn note_ground_link(&mut self, now: Instant) {
        self.ground_heard = Some(now);
    }
}
