// SPDX-License-Identifier: MIT OR Apache-2.0
//! The comparison of the vehicle with the mission before take-off.

use heapless::Vec;

use super::client::Autopilot;
use super::phase::{Obstacle, Phase};
use super::preflight::{PreflightRefusal, REFUSALS, own_fence};
use crate::collect::collect_first;
use crate::scalar::Scalar;
use crate::time::Instant;

impl<T: Scalar> Autopilot<T> {
    /// Returns the reasons known so far that prevent a start and do not go away by waiting. Empty
    /// once the flight has begun.
    pub fn refusals(&self, now: Instant) -> Vec<PreflightRefusal, REFUSALS> {
        if !matches!(self.phase(), Phase::Checking | Phase::Standby) {
            return Vec::new();
        }
        let obstacle = self.look_for_obstacle(now);
        let all = [
            self.refuse_distance(obstacle),
            self.refuse_speed(),
            self.refuse_battery(obstacle),
        ];
        let fence = self.refuse_own_fence(obstacle);
        // The capacity is the number of refusals.
        collect_first(all.into_iter().chain(fence).flatten())
    }

    /// Returns whether the vehicle reports its position on Earth.
    fn is_placed(obstacle: Option<Obstacle>) -> bool {
        matches!(obstacle, None | Some(Obstacle::PreArm))
    }

    fn refuse_distance(&self, obstacle: Option<Obstacle>) -> Option<PreflightRefusal> {
        let sample = self
            .telemetry
            .sample
            .filter(|_| Self::is_placed(obstacle))?;
        let preflight = &self.settings.preflight;
        let distance_m = preflight.outside_m(&sample.position, &self.settings.start);
        (distance_m > preflight.distance_m).then(|| PreflightRefusal::TooFar {
            distance_m: distance_m.to_f64() as f32,
            limit_m: preflight.distance_m.to_f64() as f32,
        })
    }

    fn refuse_speed(&self) -> Option<PreflightRefusal> {
        let needed_mps = self.settings.preflight.needed_speed_mps?;
        let slow = self.parameters_are_read() && self.limits.speed_mps < needed_mps;
        slow.then(|| PreflightRefusal::TooSlow {
            needed_mps: needed_mps.to_f64() as f32,
            possible_mps: self.limits.speed_mps.to_f64() as f32,
            parameter: self
                .parameter_manager
                .slowest()
                .filter(|_| self.parameter_limits.speed_mps < needed_mps),
        })
    }

    /// The battery is checked only where nothing else is waited for: an autopilot that starts up
    /// may report an empty battery.
    fn refuse_battery(&self, obstacle: Option<Obstacle>) -> Option<PreflightRefusal> {
        let threshold = self.settings.watch.battery_percent;
        let percent = self.telemetry.battery_percent?;
        let low = percent <= threshold && obstacle.is_none() && self.parameters_are_read();
        low.then_some(PreflightRefusal::BatteryLow { percent, threshold })
    }

    fn refuse_own_fence(&self, obstacle: Option<Obstacle>) -> [Option<PreflightRefusal>; 2] {
        let (Some((_, firmware)), Some(sample)) = (self.vehicle, self.telemetry.sample) else {
            return [None, None];
        };
        let preflight = &self.settings.preflight;
        let Some(farthest_m) = preflight.farthest_m(&sample.position) else {
            return [None, None];
        };
        if !(self.parameters_are_read() && Self::is_placed(obstacle)) {
            return [None, None];
        }
        let (farthest_m, altitude_m) = (
            farthest_m.to_f64() as f32,
            self.settings.altitude_m.to_f64() as f32,
        );
        let [radius, ceiling] = own_fence(firmware, |name| self.parameter(name));
        [
            radius
                .filter(|&(_, limit_m)| farthest_m >= limit_m)
                .map(
                    |(parameter, limit_m)| PreflightRefusal::OutsideAutopilotFence {
                        parameter,
                        limit_m,
                        needed_m: farthest_m,
                    },
                ),
            ceiling
                .filter(|&(_, limit_m)| altitude_m >= limit_m)
                .map(
                    |(parameter, limit_m)| PreflightRefusal::AboveAutopilotFence {
                        parameter,
                        limit_m,
                        needed_m: altitude_m,
                    },
                ),
        ]
    }

    /// Returns how far outside the geofence the vehicle stands, m.
    pub(super) fn outside_fence_m(&self) -> T {
        match (&self.settings.geofence, &self.telemetry.sample) {
            (Some(fence), Some(sample)) => (fence.clamp(sample.position) - sample.position).norm(),
            _ => T::zero(),
        }
    }
}
