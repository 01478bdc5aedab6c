// SPDX-License-Identifier: MIT OR Apache-2.0
//! Messages to send, and when.

use mavlink::dialects::common::{
    HEARTBEAT_DATA, MavAutopilot, MavFrame, MavMessage, MavModeFlag, MavState, MavType,
    PositionTargetTypemask, SET_POSITION_TARGET_GLOBAL_INT_DATA,
    SET_POSITION_TARGET_LOCAL_NED_DATA,
};

use super::client::Autopilot;
use super::command::Turn;
use super::event::Event;
use super::frames::vector_to_ned;
use super::guidance::Motion;
use super::phase::Phase;
use super::settings::Coordinates;
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

const HEARTBEAT_INTERVAL: Duration = Duration::from_secs(1);
/// The longest pause between two calls of [`Autopilot::poll`]. All time-outs are much longer.
const LONGEST_PAUSE: Duration = Duration::from_millis(50);

/// The largest number of telemetry intervals by which the reference may be ahead of the newest
/// sample: a vehicle that no longer sends samples may no longer move, for example if its simulator
/// has stalled.
const FURTHEST_AHEAD: u32 = 2;

impl<T: Scalar> Autopilot<T> {
    /// Returns the next message to send. Call until `None` whenever something was received, and at
    /// the latest at [`Autopilot::poll_at`].
    pub fn poll(&mut self, now: Instant) -> Option<MavMessage> {
        self.advance(now);
        if self.silent {
            return None;
        }
        if self.phase() == Phase::Failed {
            return self.restoration(now);
        }
        // The setpoint of a slot's end comes first: the slot is measured by its time.
        if let Some(setpoint) = self.setpoint(now) {
            return Some(setpoint);
        }
        if now >= self.heartbeat_due {
            self.heartbeat_due = now + HEARTBEAT_INTERVAL;
            return Some(self.heartbeat());
        }
        self.command(now)
            .or_else(|| self.parameter_request(now))
            .or_else(|| self.restoration(now))
    }

    /// Returns when [`Autopilot::poll`] must be called next if nothing is received before.
    pub fn poll_at(&self, now: Instant) -> Instant {
        let mut next = (now + LONGEST_PAUSE).min(self.heartbeat_due);
        if let Some(pending) = &self.pending {
            next = next.min(pending.due());
        }
        if let Some(stream) = &self.stream {
            next = next.min(stream.due);
        }
        if let Some(leg) = &self.leg
            && let Some(end) = self.telemetry.clock.our_time(leg.end)
            && !leg.final_sent
        {
            next = next.min(end);
        }
        next.max(now)
    }

    fn heartbeat(&self) -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    }

    fn command(&mut self, now: Instant) -> Option<MavMessage> {
        let (address, firmware) = self.vehicle?;
        let patience = self.settings.patience;
        let pending = self.pending.as_mut()?;
        let request = pending.request;
        match pending.turn(now, &patience) {
            Turn::Wait => None,
            Turn::Send(confirmation) => {
                let message = pending.message(firmware, address);
                if confirmation > 0 {
                    self.events.push(Event::Repeated {
                        request,
                        attempts: confirmation,
                        answer: pending.last_refusal(),
                    });
                }
                pending.sent(now, &patience);
                Some(MavMessage::COMMAND_LONG(message))
            }
            Turn::Over(outcome) => {
                self.pending = None;
                self.events.push(Event::Failed { request, outcome });
                self.command_over(now, request, outcome);
                None
            }
        }
    }

    /// Returns the next request for a parameter. Parameters are read and set while nothing else is
    /// requested.
    fn parameter_request(&mut self, now: Instant) -> Option<MavMessage> {
        let vehicle = self.vehicle?;
        if self.phase() != Phase::Checking || self.pending.is_some() || self.restore_now {
            return None;
        }
        if self.parameter_manager.restores_first() {
            if self.telemetry.armed {
                return None;
            }
            let events = &mut self.events;
            let report = |finding| events.push(Event::Finding(finding));
            return self.parameter_manager.restore(now, vehicle, report);
        }
        let needs = self.needs();
        let events = &mut self.events;
        let report = |finding| events.push(Event::Finding(finding));
        let limits = &mut self.parameter_limits;
        let request = self
            .parameter_manager
            .request(now, vehicle, &needs, limits, report);
        self.update_limits();
        request
    }

    /// Returns the next request that restores a parameter. Parameters are restored after the
    /// flight, with motors off. While the link is silent no attempt is used.
    fn restoration(&mut self, now: Instant) -> Option<MavMessage> {
        let vehicle = self.vehicle?;
        let may = self.phase().is_final() && !self.telemetry.armed && !self.is_link_silent(now);
        if !(may || self.restore_now) || self.parameter_manager.is_restored() {
            return None;
        }
        let events = &mut self.events;
        let report = |finding| events.push(Event::Finding(finding));
        self.parameter_manager.restore(now, vehicle, report)
    }

    /// Returns the setpoint that is due, if there is one and it may be sent. Heights in this
    /// function are above the place of take-off.
    fn setpoint(&mut self, now: Instant) -> Option<MavMessage> {
        if !self.may_stream(now) {
            return None;
        }
        let (interval, target) = (self.settings.setpoint_interval, self.settings.altitude_m);
        let climb_mps = self.settings.climb_speed_mps;
        let vehicle_now = self.vehicle_time(now)?;
        let at_setpoints = self.limits.is_ideal();
        let stream = self.stream.as_mut()?;
        let ends = self
            .leg
            .as_mut()
            .filter(|leg| !leg.final_sent && vehicle_now >= leg.end);
        if now < stream.due && ends.is_none() {
            return None;
        }
        if let Some(leg) = ends {
            leg.final_sent = true;
        }
        let leg_over = self.leg.as_ref().is_some_and(|leg| leg.final_sent);
        let motion = if at_setpoints && leg_over {
            // Exactly the waypoint, until the next leg is known.
            stream.guide.target()
        } else if let Some(sample) = self.telemetry.sample
            && !at_setpoints
        {
            let latest = sample.time + self.settings.telemetry_interval * FURTHEST_AHEAD;
            stream.guide.at(vehicle_now.min(latest))
        } else {
            stream.guide.at(vehicle_now)
        };
        // Until a leg's end is confirmed its setpoint is repeated sooner: any message may be lost.
        let unconfirmed = self.leg.as_ref().is_some_and(|leg| leg.ended.is_none());
        let waits = at_setpoints && leg_over && unconfirmed;
        stream.due = now + if waits { interval / 4 } else { interval };
        let (altitude, climb) = match stream.climb {
            Some((since, from)) => {
                let risen = from + climb_mps * T::of((now - since).as_secs_f64());
                if risen < target {
                    (risen, climb_mps)
                } else {
                    (target, T::zero())
                }
            }
            None => (target, T::zero()),
        };
        if !(motion.is_finite() && altitude.finite()) {
            return None;
        }
        let motion = Motion {
            position: self
                .settings
                .geofence
                .map_or(motion.position, |fence| fence.clamp(motion.position)),
            ..motion
        };
        stream.last = motion;
        self.setpoint_message(vehicle_now, &motion, altitude, climb)
    }

    // PX4 compares with the name that MAVLink has since deprecated.
    #[allow(deprecated)]
    fn setpoint_message(
        &self,
        vehicle_now: Instant,
        motion: &Motion<T>,
        altitude: T,
        climb: T,
    ) -> Option<MavMessage> {
        let (to, _) = self.vehicle?;
        let (vx, vy) = vector_to_ned(motion.velocity);
        let (afx, afy) = vector_to_ned(motion.acceleration);
        // Position, velocity and acceleration are used; the autopilot chooses the heading.
        let type_mask = PositionTargetTypemask::POSITION_TARGET_TYPEMASK_YAW_IGNORE
            | PositionTargetTypemask::POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE;
        // Above the place of take-off, as the autopilot's home is, and above the local origin.
        let height = altitude.to_f64() as f32;
        let altitude = (altitude + self.site.altitude_m).to_f64() as f32;
        let climb = climb.to_f64() as f32;
        // The vehicle's clock, so that a log shows setpoint and motion on the same time axis.
        let time_boot_ms = vehicle_now.millis_wrapping();
        Some(match self.settings.coordinates {
            Coordinates::Local => {
                let (x, y) = self.map.to_local(motion.position);
                MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
                    time_boot_ms,
                    x,
                    y,
                    z: -altitude,
                    vx,
                    vy,
                    vz: -climb,
                    afx,
                    afy,
                    afz: 0.0,
                    yaw: 0.0,
                    yaw_rate: 0.0,
                    type_mask,
                    target_system: to.system,
                    target_component: to.component,
                    coordinate_frame: MavFrame::MAV_FRAME_LOCAL_NED,
                })
            }
            Coordinates::Global => {
                let place = self.map.to_geodetic(motion.position);
                MavMessage::SET_POSITION_TARGET_GLOBAL_INT(SET_POSITION_TARGET_GLOBAL_INT_DATA {
                    time_boot_ms,
                    lat_int: place.latitude_e7,
                    lon_int: place.longitude_e7,
                    alt: height,
                    vx,
                    vy,
                    vz: -climb,
                    afx,
                    afy,
                    afz: 0.0,
                    yaw: 0.0,
                    yaw_rate: 0.0,
                    type_mask,
                    target_system: to.system,
                    target_component: to.component,
                    coordinate_frame: MavFrame::MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
                })
            }
        })
    }
}
