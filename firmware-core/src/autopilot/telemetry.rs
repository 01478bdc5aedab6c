//! What the autopilot last said about the vehicle.

use mavlink::dialects::common::{
    ESTIMATOR_STATUS_DATA, EstimatorStatusFlags, LOCAL_POSITION_NED_DATA, MavSysStatusSensor,
    SYS_STATUS_DATA,
};

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
    /// When it was taken, in our time: never later than it came, and earlier by what it took
    /// longer on the way than the fastest sample.
    pub taken: Instant,
    /// When it was taken, in the autopilot's time.
    pub boot_ms: u32,
}

/// The autopilot's clock in ours: the offset of the fastest message so far, which may only
/// grow slowly, so that two clocks that drift apart by less than 50 ppm stay matched.
#[derive(Clone, Copy, Debug, Default)]
struct Clock {
    offset_us: Option<i64>,
}

/// Growth per sample, us; at 20 samples a second 40 ppm.
const OFFSET_GROWTH_US: i64 = 2;

impl Clock {
    fn taken(&mut self, now: Instant, boot_ms: u32) -> Instant {
        let boot_us = i64::from(boot_ms) * 1_000;
        let offset = i64::try_from(now.micros()).unwrap_or(i64::MAX) - boot_us;
        let least = self
            .offset_us
            .map_or(offset, |known| offset.min(known + OFFSET_GROWTH_US));
        self.offset_us = Some(least);
        Instant::from_micros(u64::try_from(boot_us + least).unwrap_or(0))
    }
}

/// What a position message did to the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum News {
    /// A new sample.
    Fresh,
    /// Older than what is known (duplicated or reordered on the way): dropped.
    Stale,
    /// A number in it is not finite: dropped.
    Broken,
    /// A new sample, far from the last one: so many metres apart after so long.
    Jump(f64, Duration),
}

/// The latest of everything.
#[derive(Clone, Copy, Debug)]
pub(super) struct Telemetry<T: Scalar> {
    clock: Clock,
    pub(super) sample: Option<Sample<T>>,
    pub(super) sample_came: Instant,
    pub(super) heartbeat_came: Option<Instant>,
    pub(super) mode: Option<Mode>,
    pub(super) armed: bool,
    pub(super) estimator: Option<EstimatorStatusFlags>,
    /// Standard deviation of the horizontal position, m; 0 where the autopilot does not say.
    accuracy_m: f32,
    /// `None` while no SYS_STATUS came; true where the bit is set or does not exist.
    pub(super) prearm: Option<bool>,
    pub(super) battery_percent: Option<i8>,
    /// Since when the battery has been below the threshold of the watch.
    pub(super) battery_low_since: Option<Instant>,
    pub(super) on_ground: Option<bool>,
    /// The autopilot has said where its local frame begins.
    pub(super) origin_known: bool,
}

/// A position on the ground whose standard deviation is larger than this does not count, m.
const WORST_ACCURACY_M: f32 = 10.0;

/// An older sample than this before the latest means that the autopilot started anew.
const REBOOT_MS: u32 = 10_000;

impl<T: Scalar> Telemetry<T> {
    pub(super) fn new() -> Self {
        Self {
            clock: Clock::default(),
            sample: None,
            sample_came: Instant::ZERO,
            heartbeat_came: None,
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
    ) -> News {
        let m = message;
        if ![m.x, m.y, m.z, m.vx, m.vy, m.vz]
            .iter()
            .all(|v| v.is_finite())
        {
            return News::Broken;
        }
        if let Some(known) = &self.sample {
            let ahead = m.time_boot_ms.wrapping_sub(known.boot_ms);
            let behind = known.boot_ms.wrapping_sub(m.time_boot_ms);
            if behind > 0 && behind < ahead {
                if behind < REBOOT_MS {
                    return News::Stale;
                }
                self.clock = Clock::default();
            }
        }
        let sample = Sample {
            position: map.from_local(m.x, m.y),
            altitude_m: T::of(-f64::from(m.z)),
            velocity: vector_from_ned(m.vx, m.vy),
            climb_mps: T::of(-f64::from(m.vz)),
            taken: self.clock.taken(now, m.time_boot_ms),
            boot_ms: m.time_boot_ms,
        };
        let last = self.sample.replace(sample);
        self.sample_came = now;
        last.map_or(News::Fresh, |last| {
            let distance = (sample.position - last.position).norm().to_f64();
            News::Jump(distance, sample.taken - last.taken)
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

    /// The estimator stands behind an absolute horizontal position.
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
