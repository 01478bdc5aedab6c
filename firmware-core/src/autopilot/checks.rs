//! What is looked at before a flight, and said in words: parameters that clip the mission and
//! settings of the autopilot's own failsafes.
//!
//! Parameters are read by name, one after the other; one that does not exist is given up after
//! a few attempts (ArduPilot answers nothing). Nothing is changed. What clips is reported *and*
//! obeyed: the reference is planned within it, so that a clipped vehicle is slow, not lost.

use core::fmt;

use mavlink::dialects::common::{MavParamType, PARAM_REQUEST_READ_DATA, PARAM_VALUE_DATA};

use super::guidance::Limits;
use super::profile::Firmware;
use super::wire::Address;
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

/// What a parameter bears on.
#[derive(Clone, Copy, Debug)]
enum Bears {
    /// Horizontal speed; the parameter's unit times this is one m/s.
    Speed(f32),
    /// Horizontal acceleration; the parameter's unit times this is one m/s^2.
    Acceleration(f32),
    /// Largest lean; the parameter's unit times this is one degree.
    Lean(f32),
    /// Something to know when the value is (or is not) the given one.
    Note {
        when: fn(f32) -> bool,
        words: &'static str,
    },
}

/// A parameter that is read.
#[derive(Clone, Copy, Debug)]
struct Rule {
    name: &'static str,
    /// Asked for only where this one does not exist (renamed between versions).
    instead_of: Option<&'static str>,
    bears: Bears,
}

const fn rule(name: &'static str, bears: Bears) -> Rule {
    Rule {
        name,
        instead_of: None,
        bears,
    }
}

static ARDUCOPTER: [Rule; 8] = [
    rule("WPNAV_SPEED", Bears::Speed(100.0)),
    Rule {
        name: "WP_SPD",
        instead_of: Some("WPNAV_SPEED"),
        bears: Bears::Speed(1.0),
    },
    rule("WPNAV_ACCEL", Bears::Acceleration(100.0)),
    Rule {
        name: "WP_ACC",
        instead_of: Some("WPNAV_ACCEL"),
        bears: Bears::Acceleration(1.0),
    },
    rule("ANGLE_MAX", Bears::Lean(100.0)),
    rule(
        "FS_GCS_ENABLE",
        Bears::Note {
            when: |value| value == 0.0,
            words: "FS_GCS_ENABLE is 0: if we fall silent the vehicle holds and stays; 1 returns it",
        },
    ),
    rule(
        "GUID_TIMEOUT",
        Bears::Note {
            when: |value| value > 5.0,
            words: "GUID_TIMEOUT is above 5 s: if setpoints stop the vehicle flies on that long",
        },
    ),
    rule(
        "FENCE_ENABLE",
        Bears::Note {
            when: |value| value != 0.0,
            words: "FENCE_ENABLE is on: the autopilot's own fence can end the mission",
        },
    ),
];

static PX4: [Rule; 7] = [
    rule("MPC_XY_VEL_MAX", Bears::Speed(1.0)),
    rule("MPC_XY_CRUISE", Bears::Speed(1.0)),
    rule("MPC_ACC_HOR_MAX", Bears::Acceleration(1.0)),
    rule("MPC_TILTMAX_AIR", Bears::Lean(1.0)),
    rule(
        "COM_OF_LOSS_T",
        Bears::Note {
            when: |value| value < 0.5,
            words: "COM_OF_LOSS_T is below 0.5 s: a few lost setpoints end OFFBOARD",
        },
    ),
    rule(
        "COM_OBL_RC_ACT",
        Bears::Note {
            when: |value| value == 0.0,
            words: "COM_OBL_RC_ACT is 0: if setpoints stop it goes to POSCTL; 4 lands it",
        },
    ),
    rule(
        "NAV_DLL_ACT",
        Bears::Note {
            when: |value| value == 0.0,
            words: "NAV_DLL_ACT is 0: nothing happens when the ground link is lost",
        },
    ),
];

fn rules(firmware: Firmware) -> &'static [Rule] {
    match firmware {
        Firmware::Generic => &[],
        Firmware::ArduCopter => &ARDUCOPTER,
        Firmware::Px4 => &PX4,
    }
}

/// Something that would slow the mission, or is good to know before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// A parameter that clips the mission.
    Clips {
        /// Its name.
        name: &'static str,
        /// Its value, in its own unit.
        value: f32,
        /// What the mission needs, in the same unit.
        needed: f32,
        /// What it clips.
        what: &'static str,
    },
    /// Anything else.
    Note(&'static str),
    /// A parameter that was expected could not be read.
    Unread(&'static str),
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Clips {
                name,
                value,
                needed,
                what,
            } => write!(f, "{name} is {value}: it clips {what}; set it to {needed}"),
            Self::Note(words) => f.write_str(words),
            Self::Unread(name) => write!(f, "{name} could not be read"),
        }
    }
}

/// What the mission asks of the vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Needs {
    pub(super) speed_mps: f32,
    pub(super) acceleration_mps2: f32,
}

/// A lean that holds this speed against the drag of an ordinary airframe and leaves some for
/// accelerating: 45 degrees at 30 m/s.
fn needed_lean_deg(speed_mps: f32) -> f32 {
    (1.5 * speed_mps).clamp(20.0, 60.0)
}

/// Share of a parameter's limit that the reference uses, so that the vehicle can catch up.
const MARGIN: f64 = 0.95;

impl Bears {
    fn judge(self, name: &'static str, value: f32, needs: &Needs) -> Option<Finding> {
        let (needed, what) = match self {
            Self::Note { when, words } => return when(value).then_some(Finding::Note(words)),
            Self::Speed(unit) => (needs.speed_mps * unit, "speed"),
            Self::Acceleration(unit) => (needs.acceleration_mps2 * unit, "acceleration"),
            Self::Lean(unit) => (
                needed_lean_deg(needs.speed_mps) * unit,
                "lean, and so speed",
            ),
        };
        (value < needed).then_some(Finding::Clips {
            name,
            value,
            needed,
            what,
        })
    }

    fn clip<T: Scalar>(self, value: f32, limits: &mut Limits<T>) {
        let within = |unit: f32| T::of(f64::from(value / unit) * MARGIN);
        match self {
            _ if value.is_nan() || value <= 0.0 => {}
            Self::Speed(unit) => limits.speed_mps = limits.speed_mps.min(within(unit)),
            Self::Acceleration(unit) => {
                limits.acceleration_mps2 = limits.acceleration_mps2.min(within(unit));
            }
            Self::Lean(_) | Self::Note { .. } => {}
        }
    }
}

/// Reads one parameter after the other.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reader {
    next: usize,
    attempts: u8,
    due: Instant,
    /// The last parameter that was read, for the alternatives.
    found: Option<&'static str>,
}

const ANSWER_TIME: Duration = Duration::from_millis(600);
const ATTEMPTS: u8 = 5;

impl Reader {
    /// Everything was read or given up.
    pub(super) fn is_done(&self, firmware: Firmware) -> bool {
        self.next >= rules(firmware).len()
    }

    /// The request that is due, if one is. Says what it gave up.
    pub(super) fn request(
        &mut self,
        now: Instant,
        firmware: Firmware,
        to: Address,
        mut report: impl FnMut(Finding),
    ) -> Option<PARAM_REQUEST_READ_DATA> {
        let rules = rules(firmware);
        while now >= self.due {
            let rule = rules.get(self.next)?;
            let needless = rule.instead_of.is_some() && rule.instead_of == self.found;
            if needless || self.attempts >= ATTEMPTS {
                // A parameter that has another name in other versions may be missing.
                let renamed = rules.iter().any(|r| r.instead_of == Some(rule.name));
                if !needless && !renamed {
                    report(Finding::Unread(rule.name));
                }
                self.next += 1;
                self.attempts = 0;
                continue;
            }
            self.attempts += 1;
            self.due = now + ANSWER_TIME;
            return Some(PARAM_REQUEST_READ_DATA {
                param_index: -1,
                target_system: to.system,
                target_component: to.component,
                param_id: rule.name.into(),
            });
        }
        None
    }

    /// Takes a value; other parameters than the one that was asked for are nobody's answer.
    pub(super) fn take<T: Scalar>(
        &mut self,
        firmware: Firmware,
        message: &PARAM_VALUE_DATA,
        needs: &Needs,
        limits: &mut Limits<T>,
    ) -> Option<Finding> {
        let rule = rules(firmware).get(self.next)?;
        if self.attempts == 0 || message.param_id.to_str() != Ok(rule.name) {
            return None;
        }
        self.next += 1;
        self.attempts = 0;
        self.due = Instant::ZERO;
        self.found = Some(rule.name);
        let value = decode(firmware, message);
        rule.bears.clip(value, limits);
        rule.bears.judge(rule.name, value, needs)
    }
}

/// A parameter's value: ArduPilot sends numbers, PX4 the bytes of its integers.
fn decode(firmware: Firmware, message: &PARAM_VALUE_DATA) -> f32 {
    match message.param_type {
        MavParamType::MAV_PARAM_TYPE_INT32 if firmware == Firmware::Px4 => {
            message.param_value.to_bits() as i32 as f32
        }
        _ => message.param_value,
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    const NEEDS: Needs = Needs {
        speed_mps: 30.0,
        acceleration_mps2: 8.0,
    };

    #[test]
    fn a_clipping_parameter_is_named_with_what_it_should_be() {
        let finding = ARDUCOPTER[0].bears.judge("WPNAV_SPEED", 1000.0, &NEEDS);
        assert_eq!(
            finding.unwrap().to_string(),
            "WPNAV_SPEED is 1000: it clips speed; set it to 3000"
        );
        assert_eq!(PX4[0].bears.judge("MPC_XY_VEL_MAX", 35.0, &NEEDS), None);
        let mut limits = Limits::<f64>::ideal();
        ARDUCOPTER[0].bears.clip(1000.0, &mut limits);
        assert_eq!(limits.speed_mps, 9.5);
    }

    #[test]
    fn a_renamed_parameter_is_asked_for_only_where_the_old_one_is_missing() {
        let to = Address {
            system: 1,
            component: 1,
        };
        for old_exists in [true, false] {
            let mut reader = Reader::default();
            let mut asked = std::vec::Vec::new();
            let mut now = Instant::ZERO;
            let mut limits = Limits::<f64>::ideal();
            while !reader.is_done(Firmware::ArduCopter) {
                let request = reader.request(now, Firmware::ArduCopter, to, |_| {});
                if let Some(request) = request {
                    let name = request.param_id.to_str().unwrap().to_string();
                    let exists = old_exists != name.starts_with("WP_");
                    let answer = PARAM_VALUE_DATA {
                        param_id: request.param_id,
                        param_value: 1.0,
                        ..PARAM_VALUE_DATA::DEFAULT
                    };
                    asked.push(name);
                    if exists || !asked.last().unwrap().starts_with("WP") {
                        reader.take(Firmware::ArduCopter, &answer, &NEEDS, &mut limits);
                    }
                }
                now += Duration::from_millis(100);
            }
            assert_eq!(
                asked.iter().any(|n| n == "WP_SPD"),
                !old_exists,
                "{asked:?}"
            );
            assert_eq!(asked.iter().filter(|n| *n == "ANGLE_MAX").count(), 1);
        }
    }
}
