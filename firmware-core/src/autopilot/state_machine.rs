// SPDX-License-Identifier: MIT OR Apache-2.0
//! The phases of a flight: the condition that each waits for, its command, and the phase that
//! follows.
//!
//! ```text
//! Connecting ─ Checking ─ Standby ─ TakingControl ─ Arming ─ TakingOff ─ Transit ─ Trial ─ Ready ─┐
//!                                         │            │         │                 Leg ⇄ LegEnded
//!                                       Failed     Disarming  Landing <───────────────────┘
//!      from any phase in control: Released              └─ Landed or Failed
//! ```

use mavlink::dialects::common::MavResult;

use super::client::Autopilot;
use super::command::{CommandOutcome, Pending, Request};
use super::event::Event;
use super::failsafe::Cause;
use super::phase::Phase;
use super::profile::Firmware;
use super::state::{PhaseCommand, PhaseState};
use super::telemetry::Sample;
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

/// The time after which an accepted command without a visible effect is repeated.
const EFFECT_PATIENCE: Duration = Duration::from_secs(5);
/// The time on the ground with motors turning after which the client stops them itself.
const GROUND_PATIENCE: Duration = Duration::from_secs(5);
/// The height above the start above which the vehicle counts as airborne, m.
const AIRBORNE_M: f64 = 1.0;

impl<T: Scalar> Autopilot<T> {
    /// Enters a phase.
    pub(super) fn enter(&mut self, now: Instant, state: PhaseState<T>) {
        self.state = state;
        self.phase_since = now;
        let phase = state.phase();
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

    /// Sends the command of the present phase once, and again if it was accepted and has no effect.
    fn request(&mut self, now: Instant, request: Request) {
        let Some(command) = self.state.command_mut() else {
            return;
        };
        let is_due = match *command {
            PhaseCommand::NotRequested => true,
            PhaseCommand::Requested => false,
            PhaseCommand::Accepted { at } => now - at > EFFECT_PATIENCE,
        };
        if is_due && self.pending.is_none() {
            *command = PhaseCommand::Requested;
            self.pending = Some(Pending::new(now, request));
        }
    }

    /// Notes that the command of the present phase was accepted.
    pub(super) fn note_acceptance(&mut self, now: Instant) {
        if let Some(command) = self.state.command_mut() {
            *command = PhaseCommand::Accepted { at: now };
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
        match self.state {
            PhaseState::Checking | PhaseState::Standby => self.check(now, firmware),
            PhaseState::TakingControl(_) => {
                if firmware.stream_before_control() > Duration::ZERO && self.stream.is_none() {
                    self.hold_here(now, true);
                }
                if now - self.phase_since >= firmware.stream_before_control() {
                    self.request(now, Request::SetMode(firmware.control_mode()));
                }
            }
            PhaseState::Arming(_) => {
                if self.telemetry.armed {
                    self.pending = None;
                    self.note_ground();
                    self.enter(now, PhaseState::TakingOff(PhaseCommand::NotRequested));
                } else {
                    self.request(now, Request::Arm);
                }
            }
            PhaseState::TakingOff(command) => self.take_off(now, firmware, command),
            PhaseState::Transit => {
                if self.has_arrived_at(now, self.settings.start) {
                    self.prepare_slots(now);
                }
            }
            PhaseState::Trial(trial) => self.advance_trial(now, trial),
            PhaseState::Leg => {
                // No sample was received from after the tick: the last one is used.
                if let Some((leg, vehicle_now)) = self.leg.zip(self.vehicle_time(now))
                    && leg.final_sent
                    && vehicle_now >= leg.end + self.settings.sample_patience
                {
                    self.events.push(Event::SampleLate);
                    self.finish_leg(now);
                }
            }
            PhaseState::Landing { by, .. } => {
                if !self.telemetry.armed {
                    self.enter(now, PhaseState::Landed);
                } else if self.holds == Some(firmware.control_mode()) {
                    self.request(now, by);
                } else if self.telemetry.on_ground == Some(true)
                    && now - self.phase_since > GROUND_PATIENCE
                {
                    self.enter(now, PhaseState::Disarming(PhaseCommand::NotRequested));
                }
            }
            PhaseState::Disarming(command) => {
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
                } else if self.telemetry.armed || command == PhaseCommand::NotRequested {
                    self.request(now, Request::Disarm);
                } else if self.pending.is_none() {
                    let broken_off = self.fault.is_some() && !self.flown;
                    self.enter(
                        now,
                        if broken_off {
                            PhaseState::Failed
                        } else {
                            PhaseState::Landed
                        },
                    );
                }
            }
            PhaseState::Connecting
            | PhaseState::Ready
            | PhaseState::LegEnded
            | PhaseState::Landed
            | PhaseState::Released
            | PhaseState::Failed => {}
        }
    }

    /// Records the position of the vehicle on the ground, from which heights are measured.
    pub(super) fn note_ground(&mut self) {
        if let Some(sample) = self.telemetry.sample {
            self.site.altitude_m = sample.altitude_m;
            self.site.outside_fence_m = self.outside_fence_m();
        }
    }

    /// Returns the height of a sample above the place of take-off, m.
    pub(super) fn height_m(&self, sample: &Sample<T>) -> T {
        sample.altitude_m - self.site.altitude_m
    }

    fn take_off(&mut self, now: Instant, firmware: Firmware, command: PhaseCommand) {
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
            self.enter(now, PhaseState::Transit);
        } else if firmware.takes_off_by_command() {
            let altitude_m = target.to_f64() as f32;
            // A take-off that has begun is not requested again: that would restart it.
            if self.flown {
                self.pending = None;
            } else {
                self.request(now, Request::TakeOff { altitude_m });
            }
        } else if command == PhaseCommand::NotRequested {
            self.note_acceptance(now);
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
            CommandOutcome::Accepted => self.note_acceptance(now),
            // Motors that stand still need no answer.
            _ if request == Request::Disarm && !self.telemetry.armed => {}
            _ => self.fail(now, Cause::CommandFailed),
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
        let command = PhaseCommand::NotRequested;
        self.enter(now, PhaseState::Landing { by, command });
    }
}
