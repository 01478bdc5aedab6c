// SPDX-License-Identifier: MIT OR Apache-2.0
//! The checks before a flight: the telemetry that is requested, and the conditions that the client
//! waits for.

use mavlink::MessageData;
use mavlink::dialects::common::{
    CURRENT_MODE_DATA, EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA,
    LOCAL_POSITION_NED_DATA, SYS_STATUS_DATA,
};

use super::client::Autopilot;
use super::command::{Pending, Request};
use super::event::Event;
use super::phase::{Obstacle, Phase};
use super::profile::Firmware;
use super::state::{PhaseCommand, PhaseState};
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

/// The interval between requests for the origin of the local frame.
const ORIGIN_INTERVAL: Duration = Duration::from_secs(1);
/// The time after which telemetry is requested again while something is missing.
const RESUBSCRIBE: Duration = Duration::from_secs(10);

impl<T: Scalar> Autopilot<T> {
    /// Returns the request for telemetry of a step, or `None` after the last one. The requests are
    /// sent one after the other.
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

    /// Requests telemetry and waits until the vehicle is ready to be flown.
    pub(super) fn check(&mut self, now: Instant, firmware: Firmware) {
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
            self.enter(now, PhaseState::Failed);
            return;
        }
        match (self.phase(), obstacle) {
            (Phase::Checking, None)
                if self.pending.is_none() && self.parameter_manager.is_done(firmware) =>
            {
                self.enter(now, PhaseState::Standby);
            }
            (Phase::Standby, Some(_)) => self.enter(now, PhaseState::Checking),
            (Phase::Standby, None) if self.launch => {
                self.note_ground();
                self.enter(now, PhaseState::TakingControl(PhaseCommand::NotRequested));
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
}
