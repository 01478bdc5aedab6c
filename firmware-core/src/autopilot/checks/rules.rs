// SPDX-License-Identifier: MIT OR Apache-2.0
//! The parameters of each autopilot that are read, and what a mission needs of them.

use super::finding::Finding;
use crate::scalar::Scalar;
use crate::{autopilot::profile::Firmware, limits::MotionLimits};

/// The effect of a parameter.
#[derive(Clone, Copy, Debug)]
pub(super) enum Effect {
    /// MotionLimits the horizontal speed; the parameter's unit times this is one m/s.
    Speed(f32),
    /// MotionLimits the horizontal acceleration; the parameter's unit times this is one m/s^2.
    Acceleration(f32),
    /// MotionLimits the change of the horizontal acceleration; the parameter's unit times this is one
    /// m/s^3.
    Jerk(f32),
    /// MotionLimits the lean angle; the parameter's unit times this is one degree.
    Lean(f32),
    /// MotionLimits the lean angle of the position controller alone, degrees; 0 where it has no limit of
    /// its own.
    OwnLean,
    /// No effect by itself: the value is kept for the checks before take-off and for display.
    Kept,
    /// A note for the operator when the value meets a condition.
    Note {
        when: fn(f32) -> bool,
        words: &'static str,
    },
}

/// A parameter that is read, and its effect.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rule {
    pub(super) name: &'static str,
    /// Requested only where this parameter does not exist (renamed between versions).
    pub(super) instead_of: Option<&'static str>,
    pub(super) effect: Effect,
}

const fn rule(name: &'static str, effect: Effect) -> Rule {
    Rule {
        name,
        instead_of: None,
        effect,
    }
}

pub(super) static ARDUCOPTER: [Rule; 18] = [
    rule("WPNAV_SPEED", Effect::Speed(100.0)),
    Rule {
        name: "WP_SPD",
        instead_of: Some("WPNAV_SPEED"),
        effect: Effect::Speed(1.0),
    },
    rule("WPNAV_ACCEL", Effect::Acceleration(100.0)),
    Rule {
        name: "WP_ACC",
        instead_of: Some("WPNAV_ACCEL"),
        effect: Effect::Acceleration(1.0),
    },
    rule("ANGLE_MAX", Effect::Lean(100.0)),
    Rule {
        name: "ATC_ANGLE_MAX",
        instead_of: Some("ANGLE_MAX"),
        effect: Effect::Lean(1.0),
    },
    rule("PSC_ANGLE_MAX", Effect::OwnLean),
    rule("PSC_JERK_XY", Effect::Jerk(1.0)),
    Rule {
        name: "PSC_JERK_NE",
        instead_of: Some("PSC_JERK_XY"),
        effect: Effect::Jerk(1.0),
    },
    rule("FS_GCS_ENABLE", Effect::Kept),
    rule("FS_GCS_TIMEOUT", Effect::Kept),
    rule("SYSID_MYGCS", Effect::Kept),
    Rule {
        name: "MAV_GCS_SYSID",
        instead_of: Some("SYSID_MYGCS"),
        effect: Effect::Kept,
    },
    rule(
        "GUID_TIMEOUT",
        Effect::Note {
            when: |value| value > 5.0,
            words: "GUID_TIMEOUT is above 5 s: if setpoints stop the vehicle flies on that long",
        },
    ),
    rule(
        "FENCE_ENABLE",
        Effect::Note {
            when: |value| value != 0.0,
            words: "FENCE_ENABLE is not 0: the autopilot's own fence can end the mission",
        },
    ),
    rule("FENCE_TYPE", Effect::Kept),
    rule("FENCE_RADIUS", Effect::Kept),
    rule("FENCE_ALT_MAX", Effect::Kept),
];

// MPC_ACC_HOR and the jerk limits shape missions and manual flight; they do not apply to OFFBOARD.
pub(super) static PX4: [Rule; 11] = [
    rule("MPC_XY_VEL_MAX", Effect::Speed(1.0)),
    rule("MPC_XY_CRUISE", Effect::Speed(1.0)),
    rule("MPC_ACC_HOR_MAX", Effect::Acceleration(1.0)),
    rule("MPC_TILTMAX_AIR", Effect::Lean(1.0)),
    rule(
        "COM_OF_LOSS_T",
        Effect::Note {
            when: |value| value < 0.5,
            words: "COM_OF_LOSS_T is below 0.5 s: a few lost setpoints end OFFBOARD",
        },
    ),
    rule("COM_OBL_RC_ACT", Effect::Kept),
    rule("NAV_DLL_ACT", Effect::Kept),
    rule("COM_DL_LOSS_T", Effect::Kept),
    rule("GF_ACTION", Effect::Kept),
    rule("GF_MAX_HOR_DIST", Effect::Kept),
    rule("GF_MAX_VER_DIST", Effect::Kept),
];

pub(super) fn rules(firmware: Firmware) -> &'static [Rule] {
    match firmware {
        Firmware::Generic => &[],
        Firmware::ArduCopter => &ARDUCOPTER,
        Firmware::Px4 => &PX4,
    }
}

pub(super) fn is_renamed(rules: &[Rule], name: &str) -> bool {
    rules.iter().any(|rule| rule.instead_of == Some(name))
}

/// What the mission requires of the vehicle. All values follow from its speed.
#[derive(Clone, Copy, Debug)]
pub(in crate::autopilot) struct Needs {
    pub(in crate::autopilot) speed_mps: f32,
}

impl Needs {
    /// Returns the required speed, a sixth above the mission's, so that the vehicle can catch up:
    /// 35 m/s at 30.
    fn speed_mps(&self) -> f32 {
        tenths(self.speed_mps * 7.0 / 6.0)
    }

    /// Returns the required acceleration, from rest to the mission's speed in three seconds: 10
    /// m/s^2 at 30 m/s.
    fn acceleration_mps2(&self) -> f32 {
        tenths(self.speed_mps / 3.0)
    }

    /// Returns the required jerk, from that acceleration to its opposite within a second: 20 m/s^3
    /// at 30 m/s.
    fn jerk_mps3(&self) -> f32 {
        tenths(self.speed_mps / 1.5)
    }

    /// Returns a lean that holds this speed against the drag of an ordinary airframe and leaves
    /// some for accelerating: 45 degrees at 30 m/s.
    fn lean_deg(&self) -> f32 {
        tenths((1.5 * self.speed_mps).clamp(20.0, 60.0))
    }
}

/// Rounds up to a tenth, because these numbers are typed by people.
fn tenths(value: f32) -> f32 {
    libm::ceilf(value * 10.0) / 10.0
}

/// The fraction of a parameter's limit that the reference uses, so that the vehicle can catch up.
pub(super) const MARGIN: f64 = 0.95;

impl Effect {
    /// Returns what the mission needs, in the parameter's unit, and the quantity that a smaller
    /// value would limit.
    pub(super) fn needed(self, needs: &Needs) -> Option<(f32, &'static str)> {
        Some(match self {
            Self::Note { .. } | Self::Kept => return None,
            Self::OwnLean => (needs.lean_deg(), "the tilt angle and therefore the speed"),
            Self::Speed(unit) => (needs.speed_mps() * unit, "speed"),
            Self::Acceleration(unit) => (needs.acceleration_mps2() * unit, "acceleration"),
            Self::Jerk(unit) => (needs.jerk_mps3() * unit, "jerk"),
            Self::Lean(unit) => (
                needs.lean_deg() * unit,
                "the tilt angle and therefore the speed",
            ),
        })
    }

    pub(super) fn judge(self, name: &'static str, value: f32, needs: &Needs) -> Option<Finding> {
        if let Self::Note { when, words } = self {
            return when(value).then_some(Finding::Note(words));
        }
        if matches!(self, Self::OwnLean) && value <= 0.0 {
            return None;
        }
        let (needed, what) = self.needed(needs)?;
        (value < needed).then_some(Finding::Clips {
            name,
            value,
            needed,
            what,
        })
    }

    pub(super) fn clip<T: Scalar>(self, value: f32, limits: &mut MotionLimits<T>) {
        let within = |unit: f32| T::of(f64::from(value / unit) * MARGIN);
        match self {
            _ if value.is_nan() || value <= 0.0 => {}
            Self::Speed(unit) => limits.speed_mps = limits.speed_mps.min(within(unit)),
            Self::Acceleration(unit) => {
                limits.acceleration_mps2 = limits.acceleration_mps2.min(within(unit));
            }
            Self::Jerk(unit) => limits.jerk_mps3 = limits.jerk_mps3.min(within(unit)),
            Self::Lean(_) | Self::OwnLean | Self::Note { .. } | Self::Kept => {}
        }
    }
}

/// A parameter that the checks read, for tables.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Advice {
    /// The name of the parameter.
    pub name: &'static str,
    /// The older name of the parameter, where it has one.
    pub instead_of: Option<&'static str>,
    /// What a mission needs of it, in its own unit, and the quantity that a smaller value would
    /// limit.
    pub needed: Option<(f32, &'static str)>,
    /// The value of the parameter that is one m/s, m/s^2 or degree.
    pub unit: Option<f32>,
    /// The note about it, where it has one.
    pub words: Option<&'static str>,
}

/// Returns every parameter that is read before a mission of this speed, in the order of reading.
pub fn advice(firmware: Firmware, speed_mps: f32) -> impl Iterator<Item = Advice> {
    rules(firmware).iter().map(move |rule| Advice {
        name: rule.name,
        instead_of: rule.instead_of,
        needed: rule.effect.needed(&Needs { speed_mps }),
        unit: match rule.effect {
            Effect::Speed(unit)
            | Effect::Acceleration(unit)
            | Effect::Jerk(unit)
            | Effect::Lean(unit) => Some(unit),
            Effect::OwnLean => Some(1.0),
            Effect::Note { .. } | Effect::Kept => None,
        },
        words: match rule.effect {
            Effect::Note { words, .. } => Some(words),
            _ => None,
        },
    })
}
