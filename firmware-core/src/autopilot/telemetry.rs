// SPDX-License-Identifier: MIT OR Apache-2.0
//! The latest state that the autopilot reported about the vehicle.

use heapless::Deque;
use mavlink::dialects::common::{
    ESTIMATOR_STATUS_DATA, EstimatorStatusFlags, LOCAL_POSITION_NED_DATA, MavSysStatusSensor,
    SYS_STATUS_DATA,
};

use super::clock::VehicleClock;
use super::frames::{MapFrame, vector_from_ned};
use super::profile::Mode;
use crate::scalar::{Displacement, Position, Scalar};
use crate::time::{Duration, Instant};

/// A measured position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T: Scalar> {
    /// Place on the map, m.
    pub position: Position<T>,
    /// Height above the origin of the autopilot's local frame, m.
    pub altitude_m: T,
    /// Velocity over ground, m/s.
    pub velocity: Displacement<T>,
    /// Rate of climb, m/s.
    pub climb_mps: T,
    /// The time at which it was taken, on the vehicle's clock.
    pub time: Instant,
}

impl<T: Scalar> Sample<T> {
    /// Returns the state of the vehicle at `time`, before or after this sample, if its velocity
    /// stays the same.
    pub fn extrapolated(&self, time: Instant) -> Self {
        let seconds = T::of((time - self.time).as_secs_f64() - (self.time - time).as_secs_f64());
        Self {
            position: self.position + self.velocity * seconds,
            altitude_m: self.altitude_m + self.climb_mps * seconds,
            time,
            ..*self
        }
    }

    /// Returns the state of the vehicle at `time`, between this sample and a later one: the cubic
    /// through both positions with both velocities (Hermite's), exact for a constant acceleration.
    fn interpolated(&self, later: &Self, time: Instant) -> Self {
        let span = (later.time - self.time).as_secs_f64();
        if span <= 0.0 {
            return Self { time, ..*later };
        }
        let fraction = (time - self.time).as_secs_f64() / span;
        let (s, h) = (T::of(fraction), T::of(span));
        let (one, two, three) = (T::one(), T::of(2.0), T::of(3.0));
        let (s2, s3) = (s * s, s * s * s);
        let (to, from) = (three * s2 - two * s3, (s3 - two * s2 + s) * h);
        let end = (s3 - s2) * h;
        let way = later.position - self.position;
        Self {
            position: self.position + way * to + self.velocity * from + later.velocity * end,
            altitude_m: self.altitude_m
                + (later.altitude_m - self.altitude_m) * to
                + self.climb_mps * from
                + later.climb_mps * end,
            velocity: self.velocity * (one - s) + later.velocity * s,
            climb_mps: self.climb_mps * (one - s) + later.climb_mps * s,
            time,
        }
    }
}

/// The state of the vehicle at a moment of its own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fix<T: Scalar> {
    pub(super) sample: Sample<T>,
    /// There was no sample on one of the two sides.
    pub(super) extrapolated: bool,
}

/// The number of samples that are kept: 3 s at 20 Hz, 1.2 s at 50 Hz.
const HISTORY: usize = 64;

/// The effect of a position message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum News {
    /// A first sample.
    Fresh,
    /// Older than the latest sample (duplicated or reordered on the way): dropped.
    Stale,
    /// A number in it is not finite: dropped.
    Broken,
    /// A new sample, with the distance in metres and the time since the last one.
    Jump(f64, Duration),
}

/// The latest values of everything that is received.
#[derive(Clone, Debug)]
pub(super) struct Telemetry<T: Scalar> {
    pub(super) clock: VehicleClock,
    /// The latest samples, oldest first.
    history: Deque<Sample<T>, HISTORY>,
    pub(super) sample: Option<Sample<T>>,
    /// MAVLink's time of the latest sample, which wraps after 49 days.
    pub(super) boot_ms: u32,
    pub(super) sample_came: Instant,
    pub(super) heartbeat_came: Option<Instant>,
    /// The time at which the autopilot last sent anything that the client takes.
    pub(super) heard: Instant,
    pub(super) mode: Option<Mode>,
    pub(super) armed: bool,
    pub(super) estimator: Option<EstimatorStatusFlags>,
    /// The standard deviation of the horizontal position, m; 0 where the autopilot does not report
    /// it.
    accuracy_m: f32,
    /// `None` before the first SYS_STATUS; true where the bit is set or does not exist.
    pub(super) prearm: Option<bool>,
    pub(super) battery_percent: Option<i8>,
    /// The time since which the battery has been below the threshold of the watch.
    pub(super) battery_low_since: Option<Instant>,
    pub(super) on_ground: Option<bool>,
    /// The autopilot has reported the origin of its local frame.
    pub(super) origin_known: bool,
}

/// The largest standard deviation of a usable position on the ground, m.
const WORST_ACCURACY_M: f32 = 10.0;

/// A sample that is older than the latest by more than this shows that the autopilot has restarted.
const REBOOT_MS: u32 = 10_000;

impl<T: Scalar> Telemetry<T> {
    pub(super) fn new() -> Self {
        Self {
            clock: VehicleClock::default(),
            history: Deque::new(),
            sample: None,
            boot_ms: 0,
            sample_came: Instant::ZERO,
            heartbeat_came: None,
            heard: Instant::ZERO,
            mode: None,
            armed: false,
            estimator: None,
            accuracy_m: 0.0,
            prearm: None,
            battery_percent: None,
            battery_low_since: None,
            on_ground: None,
            origin_known: false,
        }
    }

    pub(super) fn take_position(
        &mut self,
        now: Instant,
        message: &LOCAL_POSITION_NED_DATA,
        map: &MapFrame<T>,
        smooth: bool,
    ) -> News {
        let m = message;
        if ![m.x, m.y, m.z, m.vx, m.vy, m.vz]
            .iter()
            .all(|v| v.is_finite())
        {
            return News::Broken;
        }
        let mut time = Instant::ZERO + Duration::from_millis(m.time_boot_ms.into());
        if let Some(known) = &self.sample {
            let ahead = m.time_boot_ms.wrapping_sub(self.boot_ms);
            let behind = self.boot_ms.wrapping_sub(m.time_boot_ms);
            if behind > 0 && behind < ahead {
                if behind < REBOOT_MS {
                    return News::Stale;
                }
                self.clock = VehicleClock::default();
                self.history.clear();
            } else {
                time = known.time + Duration::from_millis(ahead.into());
            }
        }
        self.boot_ms = m.time_boot_ms;
        self.clock.observe(now, time, smooth);
        let sample = Sample {
            position: map.from_local(m.x, m.y),
            altitude_m: T::of(-f64::from(m.z)),
            velocity: vector_from_ned(m.vx, m.vy),
            climb_mps: T::of(-f64::from(m.vz)),
            time,
        };
        if self.history.is_full() {
            self.history.pop_front();
        }
        // Cannot be full: one was just taken out if it was.
        let _ = self.history.push_back(sample);
        let last = self.sample.replace(sample);
        self.sample_came = now;
        last.map_or(News::Fresh, |last| {
            let distance = (sample.position - last.position).norm().to_f64();
            News::Jump(distance, sample.time - last.time)
        })
    }

    /// Moves everything that was placed on the map, because its origin has moved.
    pub(super) fn shift(&mut self, moved: Displacement<T>) {
        for sample in self.history.iter_mut().chain(&mut self.sample) {
            sample.position += moved;
        }
    }

    /// Returns the state of the vehicle at `time` on its clock: interpolated between the samples
    /// around it, extrapolated where there is none on one side. Returns `None` without any sample.
    pub(super) fn fix(&self, time: Instant) -> Option<Fix<T>> {
        let (mut before, mut after): (Option<&Sample<T>>, Option<&Sample<T>>) = (None, None);
        for sample in &self.history {
            if sample.time <= time {
                before = Some(sample);
            } else if after.is_none() {
                after = Some(sample);
            }
        }
        let (sample, extrapolated) = match (before, after) {
            (Some(before), _) if before.time == time => (*before, false),
            (Some(before), Some(after)) => (before.interpolated(after, time), false),
            (Some(only), None) | (None, Some(only)) => (only.extrapolated(time), true),
            (None, None) => return None,
        };
        Some(Fix {
            sample,
            extrapolated,
        })
    }

    pub(super) fn take_estimator(&mut self, message: &ESTIMATOR_STATUS_DATA) {
        self.estimator = Some(message.flags);
        self.accuracy_m = message.pos_horiz_accuracy;
    }

    pub(super) fn take_status(&mut self, now: Instant, message: &SYS_STATUS_DATA, low: i8) {
        let bit = MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK;
        let known = message.onboard_control_sensors_present.contains(bit);
        let passed = message.onboard_control_sensors_health.contains(bit);
        self.prearm = Some(!known || passed);
        // -1: the autopilot does not estimate it.
        self.battery_percent =
            (message.battery_remaining >= 0).then_some(message.battery_remaining);
        self.battery_low_since = match self.battery_percent {
            Some(percent) if percent < low => self.battery_low_since.or(Some(now)),
            _ => None,
        };
    }

    /// Returns whether the estimator has an absolute horizontal position.
    ///
    /// PX4 sets ESTIMATOR_CONST_POS_MODE for as long as the vehicle stands still (it fuses "at
    /// rest"), so the flag means a missing position only in flight. On the ground the absolute
    /// position, its accuracy and the glitch flag (ArduPilot: not initialized) decide.
    pub(super) fn has_absolute_position(&self) -> bool {
        use EstimatorStatusFlags as F;
        let stands = !self.armed && self.on_ground != Some(false);
        let inaccurate = self.accuracy_m > WORST_ACCURACY_M;
        self.estimator.is_some_and(|flags| {
            flags.contains(F::ESTIMATOR_POS_HORIZ_ABS)
                && !flags.contains(F::ESTIMATOR_GPS_GLITCH)
                && !inaccurate
                && (stands || !flags.contains(F::ESTIMATOR_CONST_POS_MODE))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flags as recorded from PX4 and ArduCopter, on the ground and in flight.
    #[test]
    fn the_flag_for_a_constant_position_counts_in_flight_only() {
        let telemetry = |bits, accuracy_m, armed, on_ground| {
            let mut telemetry = Telemetry::<f64>::new();
            telemetry.take_estimator(&ESTIMATOR_STATUS_DATA {
                flags: EstimatorStatusFlags::from_bits_retain(bits),
                pos_horiz_accuracy: accuracy_m,
                ..ESTIMATOR_STATUS_DATA::DEFAULT
            });
            (telemetry.armed, telemetry.on_ground) = (armed, on_ground);
            telemetry.has_absolute_position()
        };
        let ground = Some(true);
        // PX4 before its first position, at rest, and with a position too inaccurate to fly by.
        assert!(!telemetry(229, 0.02, false, ground));
        assert!(telemetry(1023, 0.3, false, ground));
        assert!(!telemetry(1023, 30.0, false, ground));
        // In flight the same flags mean that it does not know where it is.
        assert!(!telemetry(1023, 0.3, true, Some(false)));
        assert!(!telemetry(1023, 0.3, false, Some(false)));
        assert!(telemetry(895, 0.3, true, Some(false)));
        // ArduCopter before and after it uses GPS; it does not send an accuracy.
        assert!(!telemetry(1024, 0.0, false, ground));
        assert!(!telemetry(167, 0.0, false, ground));
        assert!(telemetry(831, 0.0, false, ground));
    }
}
