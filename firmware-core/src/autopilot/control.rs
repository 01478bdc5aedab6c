// SPDX-License-Identifier: MIT OR Apache-2.0
//! Control of the vehicle: whether the client has it, and what the client may send with it.

use super::client::Autopilot;
use super::command::{Pending, Request};
use super::failsafe::Cause;
use super::phase::Phase;
use super::profile::{Firmware, Mode};
use super::state::{PhaseCommand, PhaseState};
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

impl<T: Scalar> Autopilot<T> {
    /// Processes the mode of the autopilot, which tells who has control.
    pub(super) fn judge_mode(&mut self, now: Instant, firmware: Firmware, mode: Mode) {
        let ours = firmware.control_mode();
        let landing = [firmware.land_mode(), firmware.return_mode()];
        if core::mem::take(&mut self.silent) && mode == ours {
            // The autopilot is heard again and still in our mode: end the flight, never continue
            // it.
            if matches!(self.phase(), Phase::Arming | Phase::TakingOff) && !self.flown {
                self.pending = None;
                self.enter(now, PhaseState::Disarming(PhaseCommand::NotRequested));
            } else if self.phase().is_flying() || self.phase() == Phase::TakingOff {
                self.start_landing(now, Request::Land);
            }
        }
        match self.state {
            PhaseState::TakingControl(command) => {
                // The mode decides; an acknowledgement can be lost.
                let sent = self.pending.as_ref().is_none_or(Pending::was_sent);
                if command != PhaseCommand::NotRequested && sent && mode == ours {
                    self.pending = None;
                    self.holds = Some(ours);
                    self.enter(now, PhaseState::Arming(PhaseCommand::NotRequested));
                }
            }
            PhaseState::Arming(_)
            | PhaseState::TakingOff(_)
            | PhaseState::Transit
            | PhaseState::Trial(_)
            | PhaseState::Ready
            | PhaseState::Leg
            | PhaseState::LegEnded => {
                if mode != ours {
                    self.fail(now, Cause::ControlTaken(mode));
                } else if !self.telemetry.armed && self.phase() != Phase::Arming {
                    self.fail(now, Cause::Disarmed);
                }
            }
            PhaseState::Landing { command, .. } => {
                if command != PhaseCommand::NotRequested && landing.contains(&mode) {
                    self.pending = None;
                    self.note_acceptance(now);
                    self.holds = Some(mode);
                } else if self.holds != Some(mode) {
                    self.fail(now, Cause::ControlTaken(mode));
                }
            }
            _ => {}
        }
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
        match self.state {
            // The stream that must be sent before control is given, and the climb flown with it.
            PhaseState::TakingControl(_) => firmware.stream_before_control() > Duration::ZERO,
            PhaseState::Arming(_) | PhaseState::TakingOff(_) => {
                in_control && firmware.stream_before_control() > Duration::ZERO
            }
            // Until the landing is accepted the reference comes to rest, but not after an
            // implausible position.
            PhaseState::Landing { command, .. } => {
                in_control
                    && command == PhaseCommand::Requested
                    && !matches!(
                        self.fault,
                        Some(Cause::PositionLost | Cause::PositionJumped)
                    )
            }
            _ => in_control && self.phase().is_flying(),
        }
    }

    /// Returns whether a landing was requested and the autopilot has not started it yet. A caller
    /// that exits before then would leave the vehicle without a command.
    pub fn awaits_landing(&self) -> bool {
        let ours = self.vehicle.map(|(_, firmware)| firmware.control_mode());
        self.phase() == Phase::Landing && self.telemetry.armed && self.holds == ours
    }
}
