// SPDX-License-Identifier: MIT OR Apache-2.0
//! Received messages. Only those of the autopilot that was selected change anything; frames of
//! other systems and components are ignored.

use mavlink::dialects::common::{
    COMMAND_ACK_DATA, HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavLandedState, MavMessage,
    PARAM_VALUE_DATA,
};

use super::checks::Needs;
use super::client::Autopilot;
use super::command::CommandOutcome;
use super::event::Event;
use super::failsafe::Cause;
use super::frames::Geodetic;
use super::phase::Phase;
use super::profile::{Firmware, Mode, is_armed, mode_of};
use super::state::PhaseState;
use super::telemetry::News;
use super::wire::{Address, status_text};
use crate::scalar::{Position, Scalar};
use crate::time::Instant;

/// The component id of autopilots.
const AUTOPILOT_COMPONENT: u8 = 1;

impl<T: Scalar> Autopilot<T> {
    /// Processes a received message and the address of its sender. Messages that are not addressed
    /// to us, or do not fit the phase, change nothing.
    pub fn receive(&mut self, now: Instant, from: Address, message: &MavMessage) {
        if let MavMessage::HEARTBEAT(heartbeat) = message
            && self.phase() == Phase::Connecting
        {
            self.consider(now, from, heartbeat);
        }
        if self.vehicle.is_none_or(|(address, _)| address != from) {
            return;
        }
        self.telemetry.heard = now;
        match message {
            MavMessage::HEARTBEAT(heartbeat) => self.take_heartbeat(now, heartbeat),
            MavMessage::CURRENT_MODE(mode) => self.take_mode(now, Mode(mode.custom_mode)),
            MavMessage::COMMAND_ACK(ack) => self.take_ack(now, ack),
            MavMessage::LOCAL_POSITION_NED(position) => self.take_position(now, position),
            MavMessage::ESTIMATOR_STATUS(status) => self.telemetry.take_estimator(status),
            MavMessage::SYS_STATUS(status) => {
                let low = self.settings.watch.battery_percent;
                self.telemetry.take_status(now, status, low);
            }
            MavMessage::EXTENDED_SYS_STATE(state) => {
                self.telemetry.on_ground = match state.landed_state {
                    MavLandedState::MAV_LANDED_STATE_UNDEFINED => None,
                    MavLandedState::MAV_LANDED_STATE_ON_GROUND => Some(true),
                    _ => Some(false),
                };
            }
            MavMessage::GPS_GLOBAL_ORIGIN(origin) => {
                // In flight the origin of the frame is kept; a moved origin shows as a jump of the
                // position.
                if matches!(self.phase(), Phase::Checking | Phase::Standby) {
                    let moved = self.map.set_local_origin(Geodetic {
                        latitude_e7: origin.latitude,
                        longitude_e7: origin.longitude,
                    });
                    self.telemetry.shift(moved);
                    self.telemetry.origin_known = true;
                }
            }
            MavMessage::POSITION_TARGET_LOCAL_NED(echo) => {
                let map = self.map;
                self.take_echo(echo.time_boot_ms, |sent| {
                    map.to_local(sent) == (echo.x, echo.y)
                });
            }
            MavMessage::POSITION_TARGET_GLOBAL_INT(echo) => {
                let place = Geodetic {
                    latitude_e7: echo.lat_int,
                    longitude_e7: echo.lon_int,
                };
                let map = self.map;
                self.take_echo(echo.time_boot_ms, |sent| map.to_geodetic(sent) == place);
            }
            MavMessage::PARAM_VALUE(value) => self.take_parameter(value),
            MavMessage::STATUSTEXT(text) => self.events.push(Event::Text {
                severity: text.severity as u8,
                text: status_text(text),
            }),
            _ => {}
        }
        self.advance(now);
    }

    /// Selects the first autopilot that fits the settings.
    fn consider(&mut self, now: Instant, from: Address, heartbeat: &HEARTBEAT_DATA) {
        let wanted = self.settings.vehicle.is_none_or(|id| id == from.system);
        let Some(firmware) = Firmware::of(heartbeat) else {
            return;
        };
        if wanted && from.component == AUTOPILOT_COMPONENT && from.system != 0 {
            self.vehicle = Some((from, firmware));
            self.events.push(Event::Connected {
                system: from.system,
                firmware,
            });
            self.telemetry.heartbeat_came = Some(now);
            self.enter(now, PhaseState::Checking);
        }
    }

    fn take_heartbeat(&mut self, now: Instant, heartbeat: &HEARTBEAT_DATA) {
        let Some((_, firmware)) = self.vehicle else {
            return;
        };
        // Heartbeats of another kind of component under the same address are ignored.
        if Firmware::of(heartbeat) != Some(firmware) {
            return;
        }
        let (mode, armed) = (mode_of(heartbeat), is_armed(heartbeat));
        self.telemetry.heartbeat_came = Some(now);
        self.note_mode(firmware, mode);
        if core::mem::replace(&mut self.telemetry.armed, armed) != armed {
            self.events.push(Event::Armed(armed));
        }
        self.judge_mode(now, firmware, mode);
    }

    /// Processes a CURRENT_MODE. PX4 reports its mode earlier this way than in its heartbeat, which
    /// it sends once a second.
    fn take_mode(&mut self, now: Instant, mode: Mode) {
        // Autopilots that do not support it yet send 0.
        let Some((_, firmware)) = self.vehicle.filter(|_| mode != Mode(0)) else {
            return;
        };
        // While the link counts as silent, only a heartbeat can end that.
        if !self.silent {
            self.note_mode(firmware, mode);
            self.judge_mode(now, firmware, mode);
        }
    }

    fn note_mode(&mut self, firmware: Firmware, mode: Mode) {
        if self.telemetry.mode.replace(mode) != Some(mode) {
            self.events.push(Event::Mode { firmware, mode });
        }
    }

    fn take_ack(&mut self, now: Instant, ack: &COMMAND_ACK_DATA) {
        let own = self.own();
        let ours = [0, own.system].contains(&ack.target_system)
            && [0, own.component].contains(&ack.target_component);
        if !ours {
            return;
        }
        if let Some(pending) = &mut self.pending
            && let Some(outcome) = pending.answer(now, ack, &self.settings.patience)
        {
            let request = pending.request;
            self.pending = None;
            if outcome != CommandOutcome::Accepted {
                self.events.push(Event::Failed { request, outcome });
            }
            self.command_over(now, request, outcome);
        }
    }

    fn take_parameter(&mut self, value: &PARAM_VALUE_DATA) {
        let Some((_, firmware)) = self.vehicle else {
            return;
        };
        let restoring =
            self.phase().is_final() || self.restore_now || self.parameter_manager.restores_first();
        let found = if restoring {
            self.parameter_manager.take_restored(firmware, value)
        } else {
            let needs = self.needs();
            let may_set = self.settings.set_parameters;
            let limits = &mut self.parameter_limits;
            let found = self
                .parameter_manager
                .take(firmware, value, &needs, limits, may_set);
            self.update_limits();
            found
        };
        if let Some(finding) = found {
            self.events.push(Event::Finding(finding));
        }
    }

    /// Returns what the mission requires of the vehicle's parameters.
    pub(super) fn needs(&self) -> Needs {
        Needs {
            speed_mps: self.settings.transit_speed_mps.to_f64() as f32,
        }
    }

    fn take_position(&mut self, now: Instant, message: &LOCAL_POSITION_NED_DATA) {
        // Before the start of the flight no steady mapping of the clocks is needed.
        let smooth = self.stream.is_some();
        let news = self
            .telemetry
            .take_position(now, message, &self.map, smooth);
        if let News::Jump(distance_m, after) = news {
            let speed = self
                .settings
                .limits
                .speed_mps
                .to_f64()
                .min(self.settings.transit_speed_mps.to_f64());
            let plausible = self.settings.watch.jump_m.to_f64() + 2.0 * speed * after.as_secs_f64();
            if distance_m > plausible && self.phase().is_flying() {
                self.fail(now, Cause::PositionJumped);
            }
        }
        if matches!(news, News::Fresh | News::Jump(..)) {
            self.judge_leg(now);
        }
    }

    /// Processes the vehicle's echo of a setpoint. Setpoints are compared in the form in which they
    /// were sent.
    fn take_echo(&mut self, boot_ms: u32, same: impl Fn(Position<T>) -> bool) {
        let sent = self.stream.as_ref().map(|stream| stream.last.position);
        if let Some((sent, leg)) = sent.zip(self.leg.as_mut())
            && leg.final_sent
            && leg.confirmed.is_none()
            && same(sent)
        {
            leg.confirmed = Some(boot_ms);
        }
    }
}
