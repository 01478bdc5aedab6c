// SPDX-License-Identifier: MIT OR Apache-2.0
//! The client and its interface.

use super::checks::{ChangedParameter, ParameterManager};
use super::command::{Pending, Request};
use super::event::{Event, Events};
use super::failsafe::Cause;
use super::frames::MapFrame;
use super::leg::LegEnd;
use super::phase::{Obstacle, Phase};
use super::preflight::PreflightRefusal;
use super::profile::{Firmware, Mode};
use super::settings::{AutopilotSettings, SettingsError};
use super::state::{ActiveLeg, LagEstimate, PhaseState, Stream, TakeoffSite, TelemetryRequests};
use super::telemetry::{Sample, Telemetry};
use super::wire::Address;
use crate::limits::MotionLimits;
use crate::scalar::Scalar;
use crate::time::Instant;

/// The MAVLink client; see the module's documentation. Its size on a 64-bit host, which does not depend
/// on the capacities for users and sensors:
///
/// ```
/// # use firmware_core::autopilot::Autopilot;
/// # let about = |bytes: usize, size: usize| assert!(size.abs_diff(bytes) <= bytes / 20, "{size}");
/// about(6_400, size_of::<Autopilot<f32>>());
/// about(8_400, size_of::<Autopilot<f64>>());
/// ```
///
/// What exists in one phase only is in `state`. The other fields are needed in several phases, or
/// outlive a phase that can end at any time.
#[derive(Clone, Debug)]
pub struct Autopilot<T: Scalar> {
    pub(super) settings: AutopilotSettings<T>,
    pub(super) map: MapFrame<T>,
    pub(super) state: PhaseState<T>,
    pub(super) phase_since: Instant,
    pub(super) vehicle: Option<(Address, Firmware)>,
    pub(super) telemetry: Telemetry<T>,
    pub(super) heartbeat_due: Instant,
    /// The command that is being sent, from [`Phase::Checking`] to the end of the flight.
    pub(super) pending: Option<Pending>,
    /// The requests for telemetry, continued when the checks fall back from [`Phase::Standby`] to
    /// [`Phase::Checking`].
    pub(super) requests: TelemetryRequests,
    /// The condition that the checks waited for last. It is kept for the report of a start that
    /// fails.
    pub(super) obstacle: Option<Obstacle>,
    pub(super) parameter_manager: ParameterManager,
    /// The limits of the vehicle: the settings' limits within those of the parameters.
    pub(super) limits: MotionLimits<T>,
    /// The speed that the airframe reaches, as configured or as measured by the trial leg, m/s.
    pub(super) airframe_mps: Option<T>,
    /// The limits that the vehicle's parameters impose.
    pub(super) parameter_limits: MotionLimits<T>,
    /// The caller wants to start. It may say so before the first heartbeat, and the checks may
    /// fall back to an earlier phase.
    pub(super) launch: bool,
    /// The vehicle has been in the air.
    pub(super) flown: bool,
    /// The mode that we set and that a heartbeat has confirmed. Control lasts from
    /// [`Phase::Arming`] to the landing, which has a mode of its own.
    pub(super) holds: Option<Mode>,
    /// The place of take-off, from which heights are measured until the landing.
    pub(super) site: TakeoffSite<T>,
    /// The setpoints. They are sent from [`Phase::TakingControl`] until the landing is accepted.
    pub(super) stream: Option<Stream<T>>,
    /// The estimate improves from leg to leg.
    pub(super) lag: LagEstimate<T>,
    /// The last leg. Its end is asked for after [`Phase::Leg`].
    pub(super) leg: Option<ActiveLeg<T>>,
    /// The number of the latest legs, without interruption, in which the vehicle did not move.
    pub(super) ignored_legs: u8,
    /// The time at which the ground was last heard, over all legs.
    pub(super) ground_heard: Option<Instant>,
    /// The first failure, kept for the report.
    pub(super) fault: Option<Cause>,
    /// The reason why the start was refused.
    pub(super) refusal: Option<PreflightRefusal>,
    /// The autopilot is not heard. Any phase with the motors armed can be interrupted by this, and
    /// the phase decides what happens when the autopilot is heard again.
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
        let mut client = Self::with_checked(settings);
        client.update_limits();
        Ok(client)
    }

    /// Creates a client with valid settings. [`update_limits`](Self::update_limits) must follow.
    #[inline(always)] // so that it is built where it stays: see `Onboard::new_in`
    pub(crate) fn with_checked(settings: AutopilotSettings<T>) -> Self {
        Self {
            map: MapFrame::new(settings.map_origin),
            limits: settings.limits,
            parameter_limits: MotionLimits::ideal(),
            airframe_mps: settings.airframe_speed_mps,
            settings,
            state: PhaseState::Connecting,
            phase_since: Instant::ZERO,
            vehicle: None,
            telemetry: Telemetry::new(),
            heartbeat_due: Instant::ZERO,
            pending: None,
            requests: TelemetryRequests::default(),
            obstacle: None,
            parameter_manager: ParameterManager::default(),
            launch: false,
            flown: false,
            holds: None,
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
        }
    }

    /// Returns the settings.
    pub fn settings(&self) -> &AutopilotSettings<T> {
        &self.settings
    }

    /// Returns the phase of the flight.
    pub fn phase(&self) -> Phase {
        self.state.phase()
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
    pub fn limits(&self) -> &MotionLimits<T> {
        &self.limits
    }

    /// Replaces the settings' limits, for a host that learns from the heartbeat which vehicle it is
    /// connected to. The limits of the vehicle's parameters still apply. Has no effect once the
    /// client has taken control.
    ///
    /// # Errors
    /// Returns an error if a limit is not above zero.
    pub fn set_limits(&mut self, limits: MotionLimits<T>) -> Result<(), SettingsError> {
        if !limits.is_valid() {
            return Err(SettingsError::Limits);
        }
        if matches!(
            self.phase(),
            Phase::Connecting | Phase::Checking | Phase::Standby
        ) {
            self.settings.limits = limits;
            self.update_limits();
        }
        Ok(())
    }

    /// Updates the vehicle's limits after the settings' or the parameters' limits have changed.
    pub(crate) fn update_limits(&mut self) {
        let (settings, parameters) = (&self.settings.limits, &self.parameter_limits);
        let speed_mps = settings.speed_mps.min(parameters.speed_mps);
        let jerk_mps3 = settings.jerk_mps3.min(parameters.jerk_mps3);
        // An acceleration that takes longer than a second to change to its opposite comes too late
        // to be used; a reference that changes it much faster is overshot.
        let acceleration_mps2 = settings
            .acceleration_mps2
            .min(parameters.acceleration_mps2)
            .min(jerk_mps3 / T::of(2.0));
        self.limits = MotionLimits {
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

    /// Gives up restoring parameters. An event for each parameter states its original value.
    pub fn abandon_parameters(&mut self) {
        let Some((_, firmware)) = self.vehicle else {
            return;
        };
        while let Some(finding) = self.parameter_manager.give_up(firmware) {
            self.events.push(Event::Finding(finding));
        }
    }

    /// Records that a channel state of the ground was taken (see [`super::failsafe::Watch::ground`]).
    pub fn note_ground_link(&mut self, now: Instant) {
        self.ground_heard = Some(now);
    }
}
