//! Supervision of a flight: detects the failures of the failsafe table and reacts to them.

use super::client::Autopilot;
use super::command::Request;
use super::event::Event;
use super::failsafe::{Cause, Reaction};
use super::phase::Phase;
use crate::scalar::Scalar;
use crate::time::Instant;

impl<T: Scalar> Autopilot<T> {
    /// Returns the cause of the failsafe table that has occurred, if any.
    pub(super) fn watch(&self, now: Instant) -> Option<Cause> {
        let (watch, telemetry) = (&self.settings.watch, &self.telemetry);
        let in_phase = now - self.phase_since;
        let flying = self.phase.is_flying();
        let starting = matches!(
            self.phase,
            Phase::TakingControl | Phase::Arming | Phase::TakingOff | Phase::Transit | Phase::Trial
        );
        let armed_by_us = flying
            || matches!(
                self.phase,
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
        let waited = matches!(self.phase, Phase::Checking) && self.launch;
        if (starting || waited || self.phase == Phase::Ready) && in_phase > watch.stage {
            return Some(Cause::StageTimedOut);
        }
        if !flying {
            return None;
        }
        // A vehicle that took off outside the fence may enter it from there.
        let mut margin_m = watch.fence_margin_m;
        if matches!(self.phase, Phase::Transit | Phase::Trial) {
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
        let in_mission = matches!(self.phase, Phase::Leg | Phase::LegEnded);
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
        } else if self.phase == Phase::LegEnded && in_phase > watch.overrun {
            Some(Cause::SlotOverrun)
        } else {
            None
        }
    }

    /// Carries out the reaction of the failsafe table.
    pub(super) fn fail(&mut self, now: Instant, cause: Cause) {
        if self.phase.is_final() {
            return;
        }
        let reaction = cause.row().reaction;
        let ending = matches!(self.phase, Phase::Landing | Phase::Disarming);
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
                    self.phase,
                    Phase::Checking | Phase::Standby | Phase::TakingControl
                ) =>
            {
                self.enter(now, Phase::Failed);
            }
            Reaction::Release => self.enter(now, Phase::Released),
            Reaction::Silence => self.silent = true,
            Reaction::Land if ending => self.enter(now, Phase::Failed),
            Reaction::Land if self.phase.is_flying() || self.flown => {
                self.start_landing(now, Request::Land);
            }
            // On the ground, but the motors may turn or start to turn.
            Reaction::Land if matches!(self.phase, Phase::Arming | Phase::TakingOff) => {
                self.pending = None;
                self.enter(now, Phase::Disarming);
            }
            Reaction::Land => self.enter(now, Phase::Failed),
        }
    }

    pub(super) fn end_flight(&mut self, now: Instant, by: Request) {
        self.advance(now);
        if self.phase.is_flying() {
            self.start_landing(now, by);
        }
    }
}
