//! The built-in vehicles and their characteristics.

use std::str::FromStr;

use firmware_core::MotionLimits;
use firmware_core::autopilot::profile::Firmware;
use firmware_core::time::Duration;

use super::ability::Ability;
use super::timing::{Pauses, Sampling};
use mavlink::MessageData;
use mavlink::dialects::common::HEARTBEAT_DATA;

/// The type of the vehicle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// Follows the paper's kinematics exactly.
    #[default]
    Ideal,
    /// A point mass with limits and no other difficulties.
    Multirotor,
    /// Behaves like ArduCopter in the recorded flights.
    ArduCopter,
    /// Behaves like PX4 in the recorded flights.
    Px4,
}

/// The body that the autopilot flies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Airframe {
    /// A body that reaches 30 m/s and more.
    #[default]
    Strong,
    /// The default body of the autopilot's simulator: 15 m/s (ArduCopter), 10 m/s (PX4).
    Stock,
}

impl FromStr for Airframe {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "strong" => Ok(Self::Strong),
            "stock" => Ok(Self::Stock),
            _ => Err(format!(
                "{name:?} is not an airframe; it must be strong or stock"
            )),
        }
    }
}

impl Profile {
    /// All profiles, in the order of difficulty.
    pub const ALL: [Self; 4] = [Self::Ideal, Self::Multirotor, Self::ArduCopter, Self::Px4];

    /// Returns the name of the profile on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ideal => "ideal",
            Self::Multirotor => "multirotor",
            Self::ArduCopter => "arducopter",
            Self::Px4 => "px4",
        }
    }

    /// Returns whether the vehicle follows the paper's kinematics.
    pub const fn is_ideal(self) -> bool {
        match self {
            Self::Ideal => true,
            Self::Multirotor | Self::ArduCopter | Self::Px4 => false,
        }
    }

    /// Returns whether the vehicle sends telemetry without being asked.
    pub(super) const fn sends_telemetry_unrequested(self) -> bool {
        match self {
            Self::Ideal | Self::Multirotor | Self::Px4 => true,
            Self::ArduCopter => false,
        }
    }

    /// Returns the firmware that the vehicle's heartbeat states.
    pub const fn firmware(self) -> Firmware {
        match self {
            Self::Ideal | Self::Multirotor => Firmware::Generic,
            Self::ArduCopter => Firmware::ArduCopter,
            Self::Px4 => Firmware::Px4,
        }
    }

    /// Returns the ability of the profile's strong airframe, before parameters limit it.
    pub const fn ability(self) -> Ability {
        match self {
            Self::Ideal => Ability {
                speed_mps: 30.0,
                airspeed_mps: 30.0,
                acceleration_mps2: 20.0,
                drag_per_s: 0.0,
                jerk_mps3: 200.0,
                shaping_per_s: 1.0,
                climb_mps: 20.0,
                descent_mps: 20.0,
            },
            Self::Multirotor => Ability {
                speed_mps: 36.0,
                airspeed_mps: 36.0,
                acceleration_mps2: 10.0,
                drag_per_s: 0.0,
                jerk_mps3: 60.0,
                shaping_per_s: 1.0,
                climb_mps: 5.0,
                descent_mps: 4.0,
            },
            Self::ArduCopter => Self::Px4.ability(),
            Self::Px4 => Ability {
                speed_mps: 40.0,
                airspeed_mps: 40.0,
                acceleration_mps2: 12.0,
                drag_per_s: 0.0,
                jerk_mps3: 60.0,
                shaping_per_s: 1.0,
                climb_mps: 5.0,
                descent_mps: 3.0,
            },
        }
    }

    /// Returns the ability of an airframe, before parameters limit it. Only autopilots whose
    /// simulator was flown have a stock airframe of their own.
    pub const fn ability_with(self, airframe: Airframe) -> Ability {
        let ability = self.ability();
        match (self, airframe) {
            (Self::ArduCopter, Airframe::Stock) => Ability {
                speed_mps: 15.2,
                airspeed_mps: 15.2,
                acceleration_mps2: 5.0,
                ..ability
            },
            (Self::Px4, Airframe::Stock) => Ability {
                // The airframe leans as far as it may at 10 m/s. If it is commanded to fly more
                // slowly, it lags behind, as at 7 m/s in the recorded flight.
                acceleration_mps2: 8.77,
                drag_per_s: 0.877,
                ..ability
            },
            (Self::Ideal | Self::Multirotor, Airframe::Stock) | (_, Airframe::Strong) => ability,
        }
    }

    /// Returns the rate of the vehicle's clock, in seconds per second, as recorded.
    pub(super) const fn clock_rate(self) -> f64 {
        match self {
            Self::Ideal | Self::Multirotor => 1.0,
            Self::ArduCopter => 0.9997,
            Self::Px4 => 0.99,
        }
    }

    /// Returns how regularly samples are received from the vehicle, as recorded.
    pub(super) const fn sampling(self) -> Sampling {
        let (jitter_ms, rare_ms, grid_ms) = match self {
            Self::Ideal | Self::Multirotor => (0, 0, 0),
            Self::ArduCopter => (8, 30, 0),
            Self::Px4 => (3, 25, 8),
        };
        Sampling {
            jitter: Duration::from_millis(jitter_ms),
            rare_jitter: Duration::from_millis(rare_ms),
            grid: Duration::from_millis(grid_ms),
        }
    }

    /// Returns the ids of messages whose interval cannot be changed: PX4's heartbeat.
    pub(super) fn refused_intervals(self) -> Vec<u32> {
        match self {
            Self::Px4 => vec![HEARTBEAT_DATA::ID],
            Self::Ideal | Self::Multirotor | Self::ArduCopter => Vec::new(),
        }
    }

    /// Returns how often the vehicle sends nothing for a moment: about twice in a flight.
    pub(super) const fn hiccups(self) -> Pauses {
        let (length_ms, interval_s) = match self {
            Self::Ideal | Self::Multirotor => (0, 0),
            Self::ArduCopter | Self::Px4 => (130, 60),
        };
        Pauses {
            length: Duration::from_millis(length_ms),
            interval: Duration::from_secs(interval_s),
        }
    }

    /// Returns the time from the vehicle's start to its first heartbeat, as recorded.
    pub(super) const fn first_heartbeat_after(self) -> Duration {
        match self {
            Self::Ideal | Self::Multirotor => Duration::ZERO,
            Self::ArduCopter => Duration::from_millis(950),
            Self::Px4 => Duration::from_millis(600),
        }
    }

    /// Returns the limits that a client should plan with. They are below the ability, so that the
    /// vehicle can catch up.
    pub fn client_limits(self) -> MotionLimits<f64> {
        match self {
            Self::Ideal => MotionLimits::ideal(),
            Self::Multirotor | Self::ArduCopter | Self::Px4 => {
                let ability = self.ability();
                MotionLimits {
                    speed_mps: ability.speed_mps * 0.95,
                    acceleration_mps2: ability.acceleration_mps2 * 0.8,
                    jerk_mps3: ability.jerk_mps3 * 0.8,
                }
            }
        }
    }

    /// Returns the time until the vehicle's estimator has an absolute position.
    pub(super) const fn ready_after(self) -> Duration {
        match self {
            Self::Ideal => Duration::from_millis(200),
            Self::Multirotor => Duration::from_secs(2),
            Self::ArduCopter => Duration::from_secs(40),
            Self::Px4 => Duration::from_secs(12),
        }
    }
}

impl std::fmt::Display for Profile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Profile {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|profile| profile.name() == name)
            .ok_or_else(|| {
                let names = Self::ALL.map(Self::name).join(", ");
                format!("{name:?} is not a vehicle profile; it must be one of {names}")
            })
    }
}
