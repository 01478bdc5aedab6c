//! The client and its interface.

use super::checks::{ChangedParameter, ParameterManager};
use super::command::{Pending, Request};
use super::event::{Event, Events};
use super::failsafe::Cause;
use super::frames::MapFrame;
use super::guidance::{Limits, Motion};
use super::leg::{Leg, LegEnd, LegError};
use super::phase::{Obstacle, Phase};
use super::preflight::PreflightRefusal;
use super::profile::{Firmware, Mode};
use super::settings::{AutopilotSettings, SettingsError};
use super::state::{ActiveLeg, LagEstimate, Stream, TakeoffSite, TelemetryRequests, Trial};
use super::telemetry::{Sample, Telemetry};
use super::wire::Address;
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

/// The largest fraction of the mission's speed that the reference of a leg has: a vehicle that is
/// behind catches up by getting closer to it, not by flying further in a slot than allowed.
const LEG_SPEED: f64 = 0.985;

/// The MAVLink client. About 8 kB; see the module's documentation.
#[derive(Clone, Debug)]
pub struct Autopilot<T: Scalar> {
    pub(super) settings: AutopilotSettings<T>,
    pub(super) map: MapFrame<T>,
    pub(super) phase: Phase,
    pub(super) phase_since: Instant,
    pub(super) vehicle: Option<(Address, Firmware)>,
    pub(super) telemetry: Telemetry<T>,
    pub(super) heartbeat_due: Instant,
    pub(super) pending: Option<Pending>,
    /// The requests for telemetry of [`Phase::Checking`].
    pub(super) requests: TelemetryRequests,
    pub(super) obstacle: Option<Obstacle>,
    pub(super) parameter_manager: ParameterManager,
    /// The limits of the vehicle: the settings' limits within those of the parameters.
    pub(super) limits: Limits<T>,
    /// The speed that the airframe reaches, as configured or as measured by the trial leg, m/s.
    pub(super) airframe_mps: Option<T>,
    pub(super) trial: Option<Trial<T>>,
    /// The limits that the vehicle's parameters impose.
    pub(super) parameter_limits: Limits<T>,
    pub(super) launch: bool,
    /// The command of the present phase: the time of the request, and whether it was accepted.
    pub(super) asked: Option<(Instant, bool)>,
    /// The vehicle has been in the air.
    pub(super) flown: bool,
    /// The mode that we set and that a heartbeat has confirmed.
    pub(super) holds: Option<Mode>,
    /// The command that started the landing.
    pub(super) landing_by: Option<Request>,
    pub(super) site: TakeoffSite<T>,
    pub(super) stream: Option<Stream<T>>,
    pub(super) lag: LagEstimate<T>,
    pub(super) leg: Option<ActiveLeg<T>>,
    pub(super) ignored_legs: u8,
    pub(super) ground_heard: Option<Instant>,
    pub(super) fault: Option<Cause>,
    /// The reason why the start was refused.
    pub(super) refusal: Option<PreflightRefusal>,
    pub(super) silent: bool,
    /// Parameters are restored even if the motors turn.
    pub(super) restore_now: bool,
    pub(super) events: Events,
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
            requests: TelemetryRequests::default(),
            obstacle: None,
            parameter_manager: ParameterManager::default(),
            launch: false,
            asked: None,
            flown: false,
            holds: None,
            landing_by: None,
            site: TakeoffSite::new(),
            stream: None,
            lag: LagEstimate::new(),
            leg: None,
            ignored_legs: 0,
            ground_heard: None,
            fault: None,
            refusal: None,
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
    pub(super) fn update_limits(&mut self) {
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
            let aim = leg.waypoint + way * (self.lag.time_s / slot_s.max(self.lag.time_s.abs()));
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

    /// Returns whether the autopilot has not been heard for [`super::failsafe::Watch::heartbeat`]: the
    /// link, or the autopilot, does not work at present.
    pub fn is_link_silent(&self, now: Instant) -> bool {
        self.was_silent_for(now, Duration::ZERO)
    }

    /// Returns whether the silence has lasted for [`super::failsafe::Watch::link_dead`] longer than that.
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

    /// Records that the ground was heard (see [`super::failsafe::Watch::ground`]).
    pub fn note_ground_link(&mut self, now: Instant) {
        self.ground_heard = Some(now);
    }
}
