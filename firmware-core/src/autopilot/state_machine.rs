//! The phases of a flight: the condition that each waits for, its commands, and the phase that
//! follows.
//!
//! ```text
//! Connecting ─ Checking ─ Standby ─ TakingControl ─ Arming ─ TakingOff ─ Transit ─ Trial ─ Ready ─┐
//!                                         │            │         │                 Leg ⇄ LegEnded
//!                                       Failed     Disarming  Landing <───────────────────┘
//!      from any phase in control: Released              └─ Landed or Failed
//! ```

use mavlink::MessageData;
use mavlink::dialects::common::{
    CURRENT_MODE_DATA, EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA,
    LOCAL_POSITION_NED_DATA, MavResult, SYS_STATUS_DATA,
};

use super::client::Autopilot;
use super::command::{CommandOutcome, Pending, Request};
use super::event::Event;
use super::failsafe::Cause;
use super::guidance::{Guide, Motion};
use super::phase::{Obstacle, Phase};
use super::profile::{Firmware, Mode};
use super::state::Stream;
use super::telemetry::Sample;
use crate::scalar::{Position, Scalar};
use crate::time::{Duration, Instant};

/// The time after which an accepted command without a visible effect is repeated.
const EFFECT_PATIENCE: Duration = Duration::from_secs(5);
/// The time on the ground with motors turning after which the client stops them itself.
const GROUND_PATIENCE: Duration = Duration::from_secs(5);
/// The interval between requests for the origin of the local frame.
const ORIGIN_INTERVAL: Duration = Duration::from_secs(1);
/// The time after which telemetry is requested again while something is missing.
const RESUBSCRIBE: Duration = Duration::from_secs(10);
/// The height above the start above which the vehicle counts as airborne, m.
const AIRBORNE_M: f64 = 1.0;

impl<T: Scalar> Autopilot<T> {
    /// Returns the request for telemetry of a step. The requests are sent one after the other.
    fn subscription(&self, step: u8, firmware: Firmware) -> Option<Request> {
        let every = |message, interval| Some(Request::MessageInterval { message, interval });
        let half_second = Duration::from_millis(500);
        let fifth = Duration::from_millis(200);
        match step {
            0 => every(
                LOCAL_POSITION_NED_DATA::ID,
                self.settings.telemetry_interval,
            ),
            1 => every(firmware.estimator_message(), half_second),
            2 => every(SYS_STATUS_DATA::ID, half_second),
            3 => every(EXTENDED_SYS_STATE_DATA::ID, half_second),
            // Reports a change of mode sooner, and tolerates a link that loses frames.
            4 if firmware.sends_heartbeats_on_request() => every(HEARTBEAT_DATA::ID, fifth),
            4 => every(CURRENT_MODE_DATA::ID, fifth),
            _ => None,
        }
    }

    pub(super) fn enter(&mut self, now: Instant, phase: Phase) {
        self.phase = phase;
        self.phase_since = now;
        self.asked = None;
        if matches!(phase, Phase::Released | Phase::Failed | Phase::Landed) {
            self.pending = None;
            self.stream = None;
            self.launch = false;
        }
        // One event per leg would hide the others.
        if !matches!(phase, Phase::Leg | Phase::LegEnded) {
            self.events.push(Event::Phase(phase));
        }
    }

    /// Sends a command once, and again if it has no effect.
    fn ask(&mut self, now: Instant, request: Request) {
        let overdue = self
            .asked
            .is_some_and(|(since, accepted)| accepted && now - since > EFFECT_PATIENCE);
        if self.pending.is_none() && (self.asked.is_none() || overdue) {
            self.pending = Some(Pending::new(now, request));
            self.asked = Some((now, false));
        }
    }

    /// Advances the state machine to the present time and state of the vehicle. Called before
    /// everything else.
    pub(super) fn advance(&mut self, now: Instant) {
        let Some((_, firmware)) = self.vehicle else {
            return;
        };
        if let Some(cause) = self.watch(now) {
            self.fail(now, cause);
        }
        if self.silent {
            return;
        }
        match self.phase {
            Phase::Checking | Phase::Standby => self.check(now, firmware),
            Phase::TakingControl => {
                if firmware.stream_before_control() > Duration::ZERO && self.stream.is_none() {
                    self.hold_here(now, true);
                }
                if now - self.phase_since >= firmware.stream_before_control() {
                    self.ask(now, Request::SetMode(firmware.control_mode()));
                }
            }
            Phase::Arming => {
                if self.telemetry.armed {
                    self.pending = None;
                    self.note_ground();
                    self.enter(now, Phase::TakingOff);
                } else {
                    self.ask(now, Request::Arm);
                }
            }
            Phase::TakingOff => self.take_off(now, firmware),
            Phase::Transit => {
                if self.has_arrived_at(now, self.settings.start) {
                    self.prepare_slots(now);
                }
            }
            Phase::Trial => self.advance_trial(now),
            Phase::Leg => {
                // No sample was received from after the tick: the last one is used.
                if let Some((leg, vehicle_now)) = self.leg.zip(self.vehicle_time(now))
                    && leg.final_sent
                    && vehicle_now >= leg.end + self.settings.sample_patience
                {
                    self.events.push(Event::SampleLate);
                    self.finish_leg(now);
                }
            }
            Phase::Landing => {
                let request = self.landing_by.unwrap_or(Request::Land);
                if !self.telemetry.armed {
                    self.enter(now, Phase::Landed);
                } else if self.holds == Some(firmware.control_mode()) {
                    self.ask(now, request);
                } else if self.telemetry.on_ground == Some(true)
                    && now - self.phase_since > GROUND_PATIENCE
                {
                    self.enter(now, Phase::Disarming);
                }
            }
            Phase::Disarming => {
                if self.telemetry.armed && self.is_airborne() {
                    // The aborted take-off had already begun: the motors cannot be stopped in the
                    // air.
                    match self.telemetry.mode {
                        Some(mode) if self.holds != Some(mode) => {
                            self.fail(now, Cause::ControlTaken(mode));
                        }
                        _ => {
                            self.flown = true;
                            self.start_landing(now, Request::Land);
                        }
                    }
                } else if self.telemetry.armed || self.asked.is_none() {
                    self.ask(now, Request::Disarm);
                } else if self.pending.is_none() {
                    let broken_off = self.fault.is_some() && !self.flown;
                    self.enter(
                        now,
                        if broken_off {
                            Phase::Failed
                        } else {
                            Phase::Landed
                        },
                    );
                }
            }
            Phase::Connecting
            | Phase::Ready
            | Phase::LegEnded
            | Phase::Landed
            | Phase::Released
            | Phase::Failed => {}
        }
    }

    fn check(&mut self, now: Instant, firmware: Firmware) {
        let obstacle = self.look_for_obstacle(now);
        if self.pending.is_none() {
            while self.requests.refused & (1 << self.requests.step) != 0 {
                self.requests.step += 1;
            }
            let next = self.subscription(self.requests.step, firmware);
            if let Some(request) = next {
                self.pending = Some(Pending::new(now, request));
                self.requests.step += 1;
                self.requests.sent_at = now;
            } else if obstacle.is_some() && now - self.requests.sent_at > RESUBSCRIBE {
                self.requests.step = 0;
            } else if obstacle == Some(Obstacle::NoOrigin) && now >= self.requests.origin_due {
                // The answer is the message itself; an acknowledgement alone is not sufficient.
                self.requests.origin_due = now + ORIGIN_INTERVAL;
                self.pending = Some(Pending::new(
                    now,
                    Request::Message {
                        message: GPS_GLOBAL_ORIGIN_DATA::ID,
                    },
                ));
            }
        }
        if self.obstacle != obstacle {
            self.obstacle = obstacle;
            if let Some(obstacle) = obstacle {
                self.events.push(Event::Waiting(obstacle));
            }
        }
        let refusal = self.refusals(now).first().copied();
        if let Some(refusal) = refusal.filter(|_| self.launch) {
            self.refusal = Some(refusal);
            self.events.push(Event::Refused(refusal));
            self.enter(now, Phase::Failed);
            return;
        }
        match (self.phase, obstacle) {
            (Phase::Checking, None)
                if self.pending.is_none() && self.parameter_manager.is_done(firmware) =>
            {
                self.enter(now, Phase::Standby);
            }
            (Phase::Standby, Some(_)) => self.enter(now, Phase::Checking),
            (Phase::Standby, None) if self.launch => {
                self.note_ground();
                self.enter(now, Phase::TakingControl);
            }
            _ => {}
        }
    }

    pub(super) fn look_for_obstacle(&self, now: Instant) -> Option<Obstacle> {
        let telemetry = &self.telemetry;
        if telemetry.armed {
            Some(Obstacle::AlreadyArmed)
        } else if !self.knows_position(now) {
            Some(Obstacle::NoPosition)
        } else if !telemetry.has_absolute_position() {
            Some(Obstacle::NoEstimate)
        } else if !telemetry.origin_known {
            Some(Obstacle::NoOrigin)
        } else if telemetry.prearm != Some(true) {
            Some(Obstacle::PreArm)
        } else {
            None
        }
    }

    /// Records the position of the vehicle on the ground, from which heights are measured.
    fn note_ground(&mut self) {
        if let Some(sample) = self.telemetry.sample {
            self.site.altitude_m = sample.altitude_m;
            self.site.outside_fence_m = self.outside_fence_m();
        }
    }

    /// Returns the height of a sample above the place of take-off, m.
    pub(super) fn height_m(&self, sample: &Sample<T>) -> T {
        sample.altitude_m - self.site.altitude_m
    }

    /// Starts to stream a setpoint at the vehicle's present position.
    fn hold_here(&mut self, now: Instant, on_ground: bool) {
        let Some(sample) = self.telemetry.sample else {
            return;
        };
        let Some(vehicle_now) = self.vehicle_time(now) else {
            return;
        };
        let (place, height_m) = (sample.position, self.height_m(&sample));
        let grace = self.settings.coast;
        self.stream = Some(Stream {
            guide: Guide::new(vehicle_now, place, self.limits, grace),
            due: now,
            last: Motion::at_rest(place),
            // Until the climb begins, it has begun in the far future.
            climb: on_ground.then_some((Instant::from_micros(u64::MAX), height_m)),
        });
    }

    /// Starts a transit of the reference to a place, where it comes to rest. Returns false where no
    /// setpoints are streamed.
    pub(super) fn start_transit(&mut self, now: Instant, place: Position<T>) -> bool {
        let vehicle_now = self.vehicle_time(now);
        let Some((stream, vehicle_now)) = self.stream.as_mut().zip(vehicle_now) else {
            return false;
        };
        stream.guide.set_limits(self.limits);
        let speed_mps = self.settings.transit_speed_mps;
        stream.guide.transit(vehicle_now, place, speed_mps);
        stream.due = now;
        true
    }

    /// Returns whether the reference has come to rest and the vehicle is at the place.
    pub(super) fn has_arrived_at(&self, now: Instant, place: Position<T>) -> bool {
        let vehicle_now = self.vehicle_time(now);
        let over = |s: &Stream<T>| vehicle_now.is_some_and(|now| now >= s.guide.end());
        self.stream.as_ref().is_some_and(over)
            && self.telemetry.sample.is_some_and(|sample| {
                (sample.position - place).norm() <= self.settings.arrival_radius_m
            })
    }

    fn take_off(&mut self, now: Instant, firmware: Firmware) {
        let Some(sample) = self.telemetry.sample else {
            return;
        };
        let (target, height_m) = (self.settings.altitude_m, self.height_m(&sample));
        if height_m.to_f64() > AIRBORNE_M {
            self.flown = true;
        }
        if height_m >= target - self.settings.arrival_radius_m {
            self.pending = None;
            if self.stream.is_none() {
                self.hold_here(now, false);
            }
            self.start_transit(now, self.settings.start);
            self.enter(now, Phase::Transit);
        } else if firmware.takes_off_by_command() {
            let altitude_m = target.to_f64() as f32;
            // A take-off that has begun is not requested again: that would restart it.
            if self.flown {
                self.pending = None;
            } else {
                self.ask(now, Request::TakeOff { altitude_m });
            }
        } else if self.asked.is_none() {
            self.asked = Some((now, true));
            if let Some(stream) = &mut self.stream {
                stream.climb = Some((now, height_m));
            }
        }
    }

    /// Processes the outcome of a command.
    pub(super) fn command_over(&mut self, now: Instant, request: Request, outcome: CommandOutcome) {
        if !request.moves() {
            // Missing telemetry is reported by the checks. What was refused for good is not
            // requested again.
            if let CommandOutcome::Refused(answer) = outcome
                && answer != MavResult::MAV_RESULT_TEMPORARILY_REJECTED
                && matches!(request, Request::MessageInterval { .. })
            {
                self.requests.refused |= 1 << self.requests.step.saturating_sub(1);
            }
            return;
        }
        match outcome {
            CommandOutcome::Accepted => self.asked = Some((now, true)),
            // Motors that stand still need no answer.
            _ if request == Request::Disarm && !self.telemetry.armed => {}
            _ => self.fail(now, Cause::CommandFailed),
        }
    }

    /// Processes the mode of the autopilot, which tells who has control.
    pub(super) fn heartbeat_judged(&mut self, now: Instant, firmware: Firmware, mode: Mode) {
        let ours = firmware.control_mode();
        let landing = [firmware.land_mode(), firmware.return_mode()];
        if core::mem::take(&mut self.silent) && mode == ours {
            // The autopilot is heard again and still in our mode: end the flight, never continue
            // it.
            if matches!(self.phase, Phase::Arming | Phase::TakingOff) && !self.flown {
                self.pending = None;
                self.enter(now, Phase::Disarming);
            } else if self.phase.is_flying() || self.phase == Phase::TakingOff {
                self.start_landing(now, Request::Land);
            }
        }
        match self.phase {
            Phase::TakingControl => {
                // The mode decides; an acknowledgement can be lost.
                let sent = self.pending.as_ref().is_none_or(Pending::was_sent);
                if self.asked.is_some() && sent && mode == ours {
                    self.pending = None;
                    self.holds = Some(ours);
                    self.enter(now, Phase::Arming);
                }
            }
            Phase::Arming
            | Phase::TakingOff
            | Phase::Transit
            | Phase::Trial
            | Phase::Ready
            | Phase::Leg
            | Phase::LegEnded => {
                if mode != ours {
                    self.fail(now, Cause::ControlTaken(mode));
                } else if !self.telemetry.armed && self.phase != Phase::Arming {
                    self.fail(now, Cause::Disarmed);
                }
            }
            Phase::Landing => {
                let asked = self.asked.is_some();
                if asked && landing.contains(&mode) {
                    self.pending = None;
                    self.asked = Some((now, true));
                    self.holds = Some(mode);
                } else if self.holds != Some(mode) {
                    self.fail(now, Cause::ControlTaken(mode));
                }
            }
            _ => {}
        }
    }

    /// Returns whether the vehicle has left the ground according to its own report, or else its
    /// height.
    fn is_airborne(&self) -> bool {
        match self.telemetry.on_ground {
            Some(on_ground) => !on_ground,
            None => self
                .telemetry
                .sample
                .is_some_and(|sample| self.height_m(&sample).to_f64() > AIRBORNE_M),
        }
    }

    pub(super) fn start_landing(&mut self, now: Instant, by: Request) {
        let vehicle_now = self.vehicle_time(now);
        if let Some((stream, vehicle_now)) = self.stream.as_mut().zip(vehicle_now) {
            stream.guide.stop(vehicle_now);
        }
        self.pending = None;
        self.landing_by = Some(by);
        self.enter(now, Phase::Landing);
    }

    /// Returns whether a setpoint may be sent now: never while the position of the vehicle is
    /// unknown.
    pub(super) fn may_stream(&self, now: Instant) -> bool {
        let Some((_, firmware)) = self.vehicle else {
            return false;
        };
        if !self.knows_position(now) {
            return false;
        }
        let ours = Some(firmware.control_mode());
        let in_control = self.holds == ours && self.telemetry.mode == ours;
        match self.phase {
            // The stream that must be sent before control is given, and the climb flown with it.
            Phase::TakingControl => firmware.stream_before_control() > Duration::ZERO,
            Phase::Arming | Phase::TakingOff => {
                in_control && firmware.stream_before_control() > Duration::ZERO
            }
            phase if phase.is_flying() => in_control,
            // Until the landing is accepted the reference comes to rest, but not after an
            // implausible position.
            Phase::Landing => {
                in_control
                    && self.asked.is_some_and(|(_, accepted)| !accepted)
                    && !matches!(
                        self.fault,
                        Some(Cause::PositionLost | Cause::PositionJumped)
                    )
            }
            _ => false,
        }
    }

    /// Returns whether the latest position sample is recent enough.
    pub(super) fn knows_position(&self, now: Instant) -> bool {
        self.telemetry.sample.is_some()
            && now - self.telemetry.sample_came <= self.settings.watch.position
    }
}
