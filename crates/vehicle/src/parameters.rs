//! The parameters, which limit the vehicle's speed and acceleration and can be read and set by
//! name.

use super::ability::Ability;
use super::profile::Profile;

/// A parameter's value and its type in messages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Value {
    Real(f32),
    Integer(i32),
}

impl Value {
    pub(super) fn number(self) -> f64 {
        match self {
            Self::Real(value) => f64::from(value),
            Self::Integer(value) => f64::from(value),
        }
    }
}

/// The name and value of every parameter, in the order of their indices.
#[derive(Clone, Debug)]
pub(super) struct Parameters {
    profile: Profile,
    all: Vec<(&'static str, Value)>,
}

impl Profile {
    /// Returns the names of the vehicle's parameters.
    pub fn parameter_names(self) -> Vec<&'static str> {
        let all = Parameters::of(self).all;
        all.into_iter().map(|(name, _)| name).collect()
    }

    /// Returns the default of a parameter, if the vehicle has one of that name.
    pub fn parameter(self, name: &str) -> Option<f64> {
        Parameters::of(self).number(name)
    }
}

/// The gravitational acceleration, m/s^2.
const GRAVITY: f64 = 9.806_65;

impl Parameters {
    /// Returns the defaults of a profile.
    pub(super) fn of(profile: Profile) -> Self {
        use Value::{Integer, Real};
        let all = match profile {
            Profile::Ideal | Profile::Multirotor => vec![("SYSID_THISMAV", Integer(1))],
            Profile::ArduCopter => vec![
                ("ANGLE_MAX", Integer(3000)),
                ("ARMING_CHECK", Integer(1)),
                ("BATT_FS_LOW_ACT", Integer(0)),
                ("FENCE_ACTION", Integer(1)),
                ("FENCE_ALT_MAX", Real(100.0)),
                ("FENCE_ENABLE", Integer(0)),
                ("FENCE_RADIUS", Real(300.0)),
                ("FENCE_TYPE", Integer(7)),
                ("FS_GCS_ENABLE", Integer(0)),
                ("FS_GCS_TIMEOUT", Real(5.0)),
                ("FS_THR_ENABLE", Integer(1)),
                ("GUID_TIMEOUT", Real(3.0)),
                ("LAND_SPEED", Integer(50)),
                ("PSC_ANGLE_MAX", Real(0.0)),
                ("PSC_JERK_XY", Real(5.0)),
                ("RTL_ALT", Integer(1500)),
                ("SYSID_MYGCS", Integer(255)),
                ("SYSID_THISMAV", Integer(1)),
                ("WPNAV_ACCEL", Real(250.0)),
                ("WPNAV_JERK", Real(1.0)),
                ("WPNAV_SPEED", Real(1000.0)),
                ("WPNAV_SPEED_UP", Real(250.0)),
            ],
            Profile::Px4 => vec![
                ("COM_DL_LOSS_T", Integer(10)),
                ("COM_OBL_RC_ACT", Integer(0)),
                ("COM_OF_LOSS_T", Real(1.0)),
                ("GF_ACTION", Integer(2)),
                ("GF_MAX_HOR_DIST", Real(0.0)),
                ("GF_MAX_VER_DIST", Real(0.0)),
                ("MAV_SYS_ID", Integer(1)),
                ("MPC_ACC_HOR", Real(3.0)),
                ("MPC_ACC_HOR_MAX", Real(5.0)),
                ("MPC_JERK_AUTO", Real(4.0)),
                ("MPC_TILTMAX_AIR", Real(45.0)),
                ("MPC_XY_CRUISE", Real(5.0)),
                ("MPC_XY_VEL_MAX", Real(12.0)),
                ("MPC_Z_VEL_MAX_UP", Real(3.0)),
                ("NAV_DLL_ACT", Integer(0)),
            ],
        };
        Self { profile, all }
    }

    pub(super) fn len(&self) -> usize {
        self.all.len()
    }

    pub(super) fn at(&self, index: usize) -> Option<(&'static str, Value)> {
        self.all.get(index).copied()
    }

    pub(super) fn index_of(&self, name: &str) -> Option<usize> {
        self.all.iter().position(|(known, _)| *known == name)
    }

    /// Returns the value of a parameter, if there is one of that name.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        self.index_of(name).map(|i| self.all[i].1.number())
    }

    /// Returns whether an integer parameter has this value.
    pub(super) fn is(&self, name: &str, value: i32) -> bool {
        self.number(name) == Some(f64::from(value))
    }

    /// Sets a known parameter to a finite value, in its own type. Returns false if that is not
    /// possible.
    pub(super) fn set(&mut self, name: &str, value: f32) -> bool {
        let Some(index) = self.index_of(name).filter(|_| value.is_finite()) else {
            return false;
        };
        let slot = &mut self.all[index].1;
        *slot = match slot {
            Value::Real(_) => Value::Real(value),
            Value::Integer(_) => Value::Integer(value.round() as i32),
        };
        true
    }

    /// Returns the airframe's ability, limited by these parameters.
    pub(super) fn clip(&self, ability: Ability) -> Ability {
        let number = |name| self.number(name).unwrap_or(f64::INFINITY);
        match self.profile {
            Profile::Ideal | Profile::Multirotor => ability,
            Profile::ArduCopter => {
                let lean = (number("ANGLE_MAX") / 100.0).to_radians().min(1.4).tan();
                Ability {
                    // A lean of 30 degrees sustains 30 m/s against the drag.
                    speed_mps: ability.speed_mps.min(number("WPNAV_SPEED") / 100.0),
                    airspeed_mps: ability
                        .airspeed_mps
                        .min(30.0 * (lean / 30f64.to_radians().tan()).sqrt()),
                    acceleration_mps2: ability
                        .acceleration_mps2
                        .min(number("WPNAV_ACCEL") / 100.0)
                        .min(GRAVITY * lean),
                    jerk_mps3: ability.jerk_mps3.min(number("PSC_JERK_XY")),
                    shaping_per_s: number("PSC_JERK_XY") / (number("WPNAV_ACCEL") / 100.0),
                    climb_mps: ability.climb_mps.min(number("WPNAV_SPEED_UP") / 100.0),
                    ..ability
                }
            }
            Profile::Px4 => Ability {
                speed_mps: ability
                    .speed_mps
                    .min(number("MPC_XY_VEL_MAX"))
                    .min(number("MPC_XY_CRUISE")),
                acceleration_mps2: ability
                    .acceleration_mps2
                    .min(number("MPC_ACC_HOR_MAX"))
                    .min(GRAVITY * number("MPC_TILTMAX_AIR").to_radians().min(1.4).tan()),
                climb_mps: ability.climb_mps.min(number("MPC_Z_VEL_MAX_UP")),
                ..ability
            },
        }
    }
}
