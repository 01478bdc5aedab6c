// SPDX-License-Identifier: MIT OR Apache-2.0
//! Supervision of a flight: detects the failures of the failsafe table and reacts to them.

use super::client::Autopilot;
use super::command::Request;
use super::event::Event;
use super::failsafe::{Cause, Reaction};
use super::phase::Phase;
use super::state::{PhaseCommand, PhaseState};
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

impl<T: Scalar> Autopilot<T> {
    /// Returns the cause of the failsafe table that has occurred, if any.
    pub(super) fn watch(&self, now: Instant) -> Option<Cause> {
        let (watch, telemetry) = (&self.settings.watch, &self.telemetry);
        let phase = self.phase();
        let in_phase = now - self.phase_since;
        let flying = phase.is_flying();
        let starting = matches!(
            phase,
            Phase::TakingControl | Phase::Arming | Phase::TakingOff | Phase::Transit | Phase::Trial
        );
        let armed_by_us = flying
            || matches!(
                phase,
                Phase::Arming | Phase::TakingOff | Phase::Landing | Phase::Disarming
            );
        if armed_by_us && !self.silent && self.is_link_silent(now) {
            return Some(Cause::HeartbeatLost);
        }
        let concerned = armed_by_us || starting || self.launch;
        if concerned && self.is_link_dead(now) {
            return Some(Cause::LinkDead);
        }
        if self.silent {
            return None;
        }
        // From the first setpoint on, which may be on the ground: without a position the stream
        // that PX4 needs stops, and so does the start.
        if (flying || starting) && !self.knows_position(now) {
            return Some(Cause::PositionLost);
        }
        let waited = matches!(phase, Phase::Checking) && self.launch;
        if (starting || waited || phase == Phase::Ready) && in_phase > watch.stage {
            return Some(Cause::StageTimedOut);
        }
        if !flying {
            return None;
        }
        // A vehicle that took off outside the fence may enter it from there.
        let mut margin_m = watch.fence_margin_m;
        if matches!(phase, Phase::Transit | Phase::Trial) {
            margin_m += self.site.outside_fence_m;
        }
        let outside =
            self.settings
                .geofence
                .zip(telemetry.sample)
                .is_some_and(|(fence, sample)| {
                    !fence.contains(&sample.position, -margin_m)
                        || self.height_m(&sample) > fence.ceiling_m + watch.fence_margin_m
                });
        let in_mission = matches!(phase, Phase::Leg | Phase::LegEnded);
        let ground = watch
            .ground
            .zip(self.ground_heard)
            .is_some_and(|(limit, heard)| in_mission && now - heard > limit);
        let battery = telemetry
            .battery_low_since
            .is_some_and(|since| now - since > watch.battery);
        if outside {
            Some(Cause::FenceBreached)
        } else if battery {
            Some(Cause::BatteryLow)
        } else if ground {
            Some(Cause::GroundSilent)
        } else if phase == Phase::LegEnded && in_phase > watch.overrun {
            Some(Cause::SlotOverrun)
        } else {
            None
        }
    }

    /// Carries out the reaction of the failsafe table.
    pub(super) fn fail(&mut self, now: Instant, cause: Cause) {
        let phase = self.phase();
        if phase.is_final() {
            return;
        }
        let reaction = cause.row().reaction;
        let ending = matches!(phase, Phase::Landing | Phase::Disarming);
        // While landing, only causes that change how the landing ends are processed.
        if ending && reaction == Reaction::Land && cause != Cause::CommandFailed {
            return;
        }
        self.fault.get_or_insert(cause);
        self.events.push(Event::Failsafe { cause, reaction });
        self.launch = false;
        match reaction {
            // Control that was never taken cannot be released.
            Reaction::Release
                if matches!(
                    phase,
                    Phase::Checking | Phase::Standby | Phase::TakingControl
                ) =>
            {
                self.enter(now, PhaseState::Failed);
            }
            Reaction::Release => self.enter(now, PhaseState::Released),
            Reaction::Silence => self.silent = true,
            Reaction::Land if ending => self.enter(now, PhaseState::Failed),
            Reaction::Land if phase.is_flying() || self.flown => {
                self.start_landing(now, Request::Land);
            }
            // On the ground, but the motors may turn or start to turn.
            Reaction::Land if matches!(phase, Phase::Arming | Phase::TakingOff) => {
                self.pending = None;
                self.enter(now, PhaseState::Disarming(PhaseCommand::NotRequested));
            }
            Reaction::Land => self.enter(now, PhaseState::Failed),
        }
    }

    pub(super) fn end_flight(&mut self, now: Instant, by: Request) {
        self.advance(now);
        if self.phase().is_flying() {
            self.start_landing(now, by);
        }
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

    /// Returns how long the autopilot's heartbeat may be missing: twice as long where it always
    /// comes once a second, because a bad link sometimes loses several in a row.
    fn heartbeat_patience(&self) -> Duration {
        let steady = self
            .vehicle
            .is_some_and(|(_, firmware)| !firmware.sends_heartbeats_on_request());
        self.settings.watch.heartbeat * if steady { 2 } else { 1 }
    }

    /// Returns whether the latest position sample is recent enough.
    pub(super) fn knows_position(&self, now: Instant) -> bool {
        self.telemetry.sample.is_some()
            && now - self.telemetry.sample_came <= self.settings.watch.position
    }
}
