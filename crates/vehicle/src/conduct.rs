//! The vehicle's behaviour: maps its mode, setpoint and mission to a demand on the body, and
//! implements the autopilot's own failsafes.

use firmware_core::autopilot::profile::Firmware;
use firmware_core::time::Duration;
use mavlink::dialects::common::MavSeverity;

use super::ability::Ability;
use super::body::Demand;
use super::simulated::{FlightMode, Setpoint, Vehicle};

/// On the ground in a landing mode, the motors stop after this time.
const DISARM_AFTER: Duration = Duration::from_secs(1);
/// ArduCopter returns after this time without a ground station's heartbeat, if its parameters say
/// so.
const GROUND_TIMEOUT: Duration = Duration::from_secs(5);
/// ArduCopter stops the motors after this time armed on the ground.
const IDLE_DISARM: Duration = Duration::from_secs(10);
/// PX4's time between the loss of setpoints and the failsafe.
const OFFBOARD_GRACE: Duration = Duration::from_secs(5);

impl Vehicle {
    /// Applies the autopilot's own failsafes.
    pub(super) fn own_failsafes(&mut self) {
        let setpoint_age = self.setpoint.map(|setpoint| self.time - setpoint.came);
        match self.firmware {
            Firmware::Generic => {}
            Firmware::ArduCopter => {
                let silent = self
                    .ground_heard
                    .is_some_and(|heard| self.time - heard > GROUND_TIMEOUT);
                let enabled = self.parameters.is("FS_GCS_ENABLE", 1);
                let flies = self.armed && !self.body.is_on_ground();
                if enabled && silent && flies && self.mode == FlightMode::Guided {
                    self.say(MavSeverity::MAV_SEVERITY_WARNING, "GCS Failsafe");
                    self.set_mode(FlightMode::Return);
                }
                self.watch_battery_and_fence(flies);
                let waits = self.armed && self.body.is_on_ground() && self.take_off_to.is_none();
                if waits && self.time - self.armed_at > IDLE_DISARM {
                    self.armed = false;
                    self.say(MavSeverity::MAV_SEVERITY_INFO, "Disarming motors");
                }
            }
            Firmware::Px4 => {
                let lost = self.mode == FlightMode::Guided
                    && self.armed
                    && setpoint_age
                        .is_some_and(|age| age > self.setpoint_timeout() + OFFBOARD_GRACE);
                if lost {
                    let text = "Offboard control lost";
                    self.say(MavSeverity::MAV_SEVERITY_CRITICAL, text);
                    self.set_mode(FlightMode::Manual);
                    self.sinks = true;
                }
            }
        }
    }

    /// Implements ArduCopter's own return when the battery is low or the fence is left, if its
    /// parameters say so. The status texts are those that were recorded.
    fn watch_battery_and_fence(&mut self, flies: bool) {
        if !flies || matches!(self.mode, FlightMode::Return | FlightMode::Land) {
            return;
        }
        let from_home = (self.body.position - self.home).norm();
        let radius = self.parameters.number("FENCE_RADIUS");
        let outside = radius.is_some_and(|radius| from_home > radius);
        let texts = if self.faults.battery_low && self.parameters.is("BATT_FS_LOW_ACT", 2) {
            ["Battery 1 is low 10.60V used 522 mAh", "Battery Failsafe"]
        } else if outside
            && self.parameters.is("FENCE_ENABLE", 1)
            && self.parameters.is("FENCE_ACTION", 1)
        {
            ["Circle fence breached", "Manual recovery started"]
        } else {
            return;
        };
        self.set_mode(FlightMode::Return);
        for text in texts {
            self.say(MavSeverity::MAV_SEVERITY_WARNING, text);
        }
    }

    pub(super) fn demand(&self) -> Demand {
        if self.crashed {
            return Demand::Descend { rate_mps: 30.0 };
        }
        if !self.armed {
            return Demand::Rest;
        }
        let hold = Demand::Hold {
            altitude_m: self.hold_altitude_m,
        };
        let rises =
            self.take_off_to.is_some() || self.rises_by_setpoint() || self.mode == FlightMode::Auto;
        if self.body.is_on_ground() && !rises {
            return Demand::Rest;
        }
        match self.mode {
            FlightMode::Manual if self.sinks => Demand::Descend { rate_mps: 0.5 },
            FlightMode::Manual | FlightMode::Loiter => hold,
            FlightMode::Auto => self.mission_demand().unwrap_or(hold),
            FlightMode::Land => Demand::Descend {
                rate_mps: self.settings.ability.descent_mps,
            },
            FlightMode::Return => {
                if (self.home - self.body.position).norm() < 0.5 {
                    Demand::Descend {
                        rate_mps: self.settings.ability.descent_mps,
                    }
                } else {
                    Demand::Go {
                        position: self.home,
                        altitude_m: self.hold_altitude_m,
                        speed_mps: self.return_speed_mps(),
                    }
                }
            }
            FlightMode::Guided => match (self.take_off_to, self.setpoint) {
                (Some(altitude_m), _) => Demand::Hold { altitude_m },
                (None, Some(_)) if self.faults.ignore_setpoints => hold,
                (None, Some(setpoint)) => self.follow(&setpoint),
                (None, None) => hold,
            },
        }
    }

    /// Returns the speed of ArduCopter's return, which its parameters limit.
    fn return_speed_mps(&self) -> f64 {
        match self.firmware {
            Firmware::ArduCopter => f64::INFINITY,
            Firmware::Generic | Firmware::Px4 => 10.0,
        }
    }

    /// Returns whether setpoints start a take-off. They do with PX4; other autopilots ignore them
    /// on the ground.
    fn rises_by_setpoint(&self) -> bool {
        !self.firmware.takes_off_by_command()
            && self.mode == FlightMode::Guided
            && self.setpoint.is_some_and(|s| s.target.altitude_m > 0.1)
    }

    fn follow(&self, setpoint: &Setpoint) -> Demand {
        let age = self.time - setpoint.came;
        let mut target = setpoint.target;
        if age > self.setpoint_timeout() && target.velocity.is_some() {
            // The stream stopped while the vehicle was moving: it stops there or, with PX4, at the
            // last target.
            if !self.behavior().flies_to_last_setpoint {
                return Demand::Hold {
                    altitude_m: target.altitude_m,
                };
            }
            target.velocity = None;
        }
        target.age_s = age.as_secs_f64();
        if age < self.body.setpoint_delay()
            && let Some(previous) = self.previous
            && target.velocity.is_some()
        {
            target = previous.target;
            target.age_s = (self.time - previous.came).as_secs_f64();
        }
        Demand::Track(target)
    }

    /// Returns how long the last moving setpoint is followed without a new one.
    fn setpoint_timeout(&self) -> Duration {
        let parameter = |name, default: f64| {
            Duration::from_secs_f64(self.parameters.number(name).unwrap_or(default))
        };
        match self.firmware {
            Firmware::Generic | Firmware::ArduCopter => parameter("GUID_TIMEOUT", 3.0),
            Firmware::Px4 => parameter("COM_OF_LOSS_T", 1.0),
        }
    }

    /// Returns the airframe's ability, limited by its parameters.
    pub(super) fn ability(&self) -> Ability {
        self.parameters.clip(self.settings.ability)
    }

    pub(super) fn stop_motors_on_ground(&mut self) {
        let landing = matches!(self.mode, FlightMode::Land | FlightMode::Return);
        if !(self.armed && landing && self.body.is_on_ground()) {
            self.landed_since = None;
            return;
        }
        let since = *self.landed_since.get_or_insert(self.time);
        if self.time - since >= DISARM_AFTER {
            self.armed = false;
            self.landed_since = None;
            self.say(MavSeverity::MAV_SEVERITY_INFO, "Disarming motors");
        }
    }
}
