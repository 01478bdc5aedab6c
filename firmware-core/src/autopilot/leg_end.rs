// SPDX-License-Identifier: MIT OR Apache-2.0
//! The end of a leg: the vehicle's position at the tick, and the lag that it shows.

use super::client::Autopilot;
use super::failsafe::Cause;
use super::leg::LegEnd;
use super::phase::Phase;
use super::profile::Firmware;
use super::state::PhaseState;
use super::telemetry::{Fix, Sample};
use crate::scalar::Scalar;
use crate::time::Tick;
use crate::time::{Duration, Instant};

/// The fraction of an observed lag that changes the estimate.
const LAG_GAIN: f64 = 0.2;
/// The same where the vehicle is ahead of the reference, and so flies too far.
const LEAD_GAIN: f64 = 0.5;
/// The fraction of the largest acceleration up to which a leg counts as ending at constant speed.
const CRUISING: f64 = 0.1;
/// The largest lag that is compensated, s.
const LAG_MOST_S: f64 = 0.15;

impl<T: Scalar> Autopilot<T> {
    /// Ends the leg if a new sample shows where the vehicle was at the tick.
    pub(super) fn judge_leg(&mut self, now: Instant) {
        let Some(((leg, sample), (_, firmware))) =
            self.leg.zip(self.telemetry.sample).zip(self.vehicle)
        else {
            return;
        };
        if self.phase() != Phase::Leg {
            return;
        }
        let known = if self.is_at_setpoints(firmware) {
            // Not before the echo; the autopilot's clock may wrap.
            let boot_ms = self.telemetry.boot_ms;
            leg.final_sent
                && leg
                    .confirmed
                    .is_some_and(|echo| boot_ms.wrapping_sub(echo) < u32::MAX / 2)
        } else {
            // A sample from after the tick is used even if the setpoint of the tick is sent later.
            sample.time >= leg.end
        };
        if known {
            self.finish_leg(now);
        }
    }

    /// Returns whether the vehicle has the paper's kinematics: it is always at its last setpoint,
    /// and confirms it.
    pub(super) fn is_at_setpoints(&self, firmware: Firmware) -> bool {
        firmware.confirms_setpoints() && self.limits.is_ideal()
    }

    pub(super) fn finish_leg(&mut self, now: Instant) {
        let at_setpoint = self
            .vehicle
            .is_some_and(|(_, firmware)| self.is_at_setpoints(firmware));
        let Some((leg, latest)) = self.leg.as_mut().zip(self.telemetry.sample) else {
            return;
        };
        let fix = if at_setpoint {
            // Such a vehicle does not move between setpoints: there is nothing to interpolate.
            let sample = Sample {
                time: leg.end,
                ..latest
            };
            Some(Fix {
                sample,
                extrapolated: leg.confirmed.is_none(),
            })
        } else {
            self.telemetry.fix(leg.end)
        };
        let Some(Fix {
            sample,
            extrapolated,
        }) = fix
        else {
            return;
        };
        let length = (leg.waypoint - leg.from).norm();
        let flown = (sample.position - leg.from).norm();
        let clock = &self.telemetry.clock;
        leg.ended = Some(LegEnd {
            sample,
            missed_m: (sample.position - leg.waypoint).norm(),
            tick: Tick {
                time: leg.end,
                lateness: clock
                    .vehicle_time(now)
                    .map_or(Duration::ZERO, |t| t - leg.end),
                extrapolated,
                clock_rate: clock.rate() as f32,
            },
        });
        // Extrapolated positions contain no new information, and an ideal vehicle has no lag.
        if let Some(end) = leg.reference_end.filter(|_| !extrapolated && !at_setpoint) {
            let speed_mps = end.velocity.norm();
            // While the vehicle gains speed or turns, or flies slowly, or its simulator stalls, the
            // lag is not what determines its position.
            let stalled = self.telemetry.clock.last_stall() >= self.phase_since;
            let cruises = end.acceleration.norm()
                <= self.limits.acceleration_mps2 * T::of(CRUISING)
                && speed_mps >= self.settings.transit_speed_mps * T::of(0.3)
                && !stalled;
            if core::mem::replace(&mut self.lag.cruised, cruises) && cruises {
                let behind = (end.position - sample.position).dot(&end.velocity);
                let observed_s = behind / (speed_mps * speed_mps);
                let most = T::of(LAG_MOST_S);
                let error_s = observed_s - self.lag.time_s;
                let gain = if error_s < T::zero() {
                    LEAD_GAIN
                } else {
                    LAG_GAIN
                };
                let step = error_s * T::of(gain);
                self.lag.time_s = (self.lag.time_s + step).min(most).max(-most);
            }
        }
        let stuck = length > T::one() && flown < length * T::of(0.1);
        self.ignored_legs = if stuck {
            self.ignored_legs.saturating_add(1)
        } else {
            0
        };
        self.enter(now, PhaseState::LegEnded);
        if self.ignored_legs >= self.settings.watch.ignored_legs {
            self.fail(now, Cause::SetpointsIgnored);
        }
    }
}
