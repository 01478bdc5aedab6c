//! Parameters of the vehicle that are read before a flight: those that limit the mission, and
//! settings of the autopilot's own failsafes.
//!
//! Parameters are read by name, one after the other; one that does not exist is given up after a
//! few attempts (ArduPilot does not answer). A parameter that limits the mission is reported, and
//! the reference is planned within its limit, so that the vehicle is slow but follows.
//!
//! Nothing is changed, unless
//! [`AutopilotSettings::set_parameters`](super::AutopilotSettings::set_parameters) is set. Then
//! parameters that limit the mission are set to what it needs, and restored after the flight, once
//! the motors stand still.

use core::fmt;

use heapless::Vec;
use mavlink::dialects::common::{
    MavMessage, MavParamType, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA,
};

use super::guidance::Limits;
use super::profile::Firmware;
use super::wire::Address;
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};

/// The effect of a parameter.
#[derive(Clone, Copy, Debug)]
enum Effect {
    /// Limits the horizontal speed; the parameter's unit times this is one m/s.
    Speed(f32),
    /// Limits the horizontal acceleration; the parameter's unit times this is one m/s^2.
    Acceleration(f32),
    /// Limits the change of the horizontal acceleration; the parameter's unit times this is one
    /// m/s^3.
    Jerk(f32),
    /// Limits the lean angle; the parameter's unit times this is one degree.
    Lean(f32),
    /// Limits the lean angle of the position controller alone, degrees; 0 where it has no limit of
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
struct Rule {
    name: &'static str,
    /// Requested only where this parameter does not exist (renamed between versions).
    instead_of: Option<&'static str>,
    effect: Effect,
}

const fn rule(name: &'static str, effect: Effect) -> Rule {
    Rule {
        name,
        instead_of: None,
        effect,
    }
}

static ARDUCOPTER: [Rule; 18] = [
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
static PX4: [Rule; 11] = [
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

fn rules(firmware: Firmware) -> &'static [Rule] {
    match firmware {
        Firmware::Generic => &[],
        Firmware::ArduCopter => &ARDUCOPTER,
        Firmware::Px4 => &PX4,
    }
}

/// A parameter that limits the mission, or that is good to know before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// A parameter that limits the mission.
    Clips {
        /// The name of the parameter.
        name: &'static str,
        /// Its value, in its own unit.
        value: f32,
        /// What the mission needs, in the same unit.
        needed: f32,
        /// The quantity that it limits.
        what: &'static str,
    },
    /// A note for the operator.
    Note(&'static str),
    /// A parameter that was expected could not be read.
    Unread(&'static str),
    /// A parameter that clipped the mission was set.
    Set {
        /// The name of the parameter.
        name: &'static str,
        /// The original value, in the parameter's own unit.
        from: f32,
        /// The new value.
        to: f32,
    },
    /// A parameter that was set has been restored.
    Restored {
        /// The name of the parameter.
        name: &'static str,
        /// The restored value.
        value: f32,
    },
    /// A parameter that was set could not be restored.
    NotRestored {
        /// The name of the parameter.
        name: &'static str,
        /// The value before the flight.
        value: f32,
    },
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
            Self::Set { name, from, to } => write!(f, "{name} set from {from} to {to}"),
            Self::Restored { name, value } => write!(f, "{name} put back to {value}"),
            Self::NotRestored { name, value } => {
                write!(f, "{name} was NOT put back: it was {value}")
            }
        }
    }
}

/// What the mission requires of the vehicle. All values follow from its speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Needs {
    pub(super) speed_mps: f32,
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
const MARGIN: f64 = 0.95;

impl Effect {
    /// Returns what the mission needs, in the parameter's unit, and the quantity that a smaller
    /// value would limit.
    fn needed(self, needs: &Needs) -> Option<(f32, &'static str)> {
        Some(match self {
            Self::Note { .. } | Self::Kept => return None,
            Self::OwnLean => (needs.lean_deg(), "lean, and so speed"),
            Self::Speed(unit) => (needs.speed_mps() * unit, "speed"),
            Self::Acceleration(unit) => (needs.acceleration_mps2() * unit, "acceleration"),
            Self::Jerk(unit) => (needs.jerk_mps3() * unit, "the change of acceleration"),
            Self::Lean(unit) => (needs.lean_deg() * unit, "lean, and so speed"),
        })
    }

    fn judge(self, name: &'static str, value: f32, needs: &Needs) -> Option<Finding> {
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

    fn clip<T: Scalar>(self, value: f32, limits: &mut Limits<T>) {
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

/// A parameter that differs from its original value, or is about to be changed, with the original
/// value as received.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChangedParameter {
    /// The name of the parameter.
    pub name: &'static str,
    /// The original value, as on the wire: PX4 sends the bytes of its integers, so only the bits
    /// count.
    pub was: f32,
    /// The type of the parameter.
    pub kind: MavParamType,
}

impl ChangedParameter {
    /// Creates the record that an earlier run saved: the name, the bits of the value and the number
    /// of the type. Returns `None` if the client never changes a parameter of that name or type.
    pub fn noted(name: &str, was_bits: u32, kind: u8) -> Option<Self> {
        const KINDS: [MavParamType; 7] = [
            MavParamType::MAV_PARAM_TYPE_UINT8,
            MavParamType::MAV_PARAM_TYPE_INT8,
            MavParamType::MAV_PARAM_TYPE_UINT16,
            MavParamType::MAV_PARAM_TYPE_INT16,
            MavParamType::MAV_PARAM_TYPE_UINT32,
            MavParamType::MAV_PARAM_TYPE_INT32,
            MavParamType::MAV_PARAM_TYPE_REAL32,
        ];
        let mut rules = ARDUCOPTER.iter().chain(&PX4);
        Some(Self {
            name: rules.find(|rule| rule.name == name)?.name,
            was: f32::from_bits(was_bits),
            kind: KINDS.into_iter().find(|known| *known as u8 == kind)?,
        })
    }

    /// Returns the original value as a number in its own unit.
    pub fn value(&self, firmware: Firmware) -> f32 {
        number(firmware, self.kind, self.was)
    }
}

/// The largest number of parameters that can limit a mission; no autopilot here has more rules.
const CHANGES: usize = 9;

/// The largest number of parameters that are read; no autopilot here has more rules.
const VALUES: usize = 18;

/// Reads one parameter after the other, sets those that limit the mission if that is allowed, and
/// restores them.
#[derive(Clone, Debug, Default)]
pub(super) struct ParameterManager {
    next: usize,
    attempts: u8,
    due: Instant,
    /// The last parameter that was read, for the alternative names.
    found: Option<&'static str>,
    /// The original and the new value of the parameter that is being set.
    setting: Option<(f32, f32)>,
    /// The values that were read, in each parameter's own unit.
    values: Vec<(&'static str, f32), VALUES>,
    /// The lowest speed that a parameter allowed before any was set, m/s.
    found_mps: Option<f32>,
    /// The parameter with the lowest speed below the mission's, and the value that it should have.
    slowest: Option<(&'static str, f32)>,
    /// The parameters that differ from their original values, oldest first; the last is restored
    /// first.
    changed: Vec<ChangedParameter, CHANGES>,
    /// The changed parameters were changed by an earlier run, and are restored before anything is
    /// read.
    restores_first: bool,
}

const ANSWER_TIME: Duration = Duration::from_millis(600);
/// On a link that loses a fifth of all frames, one request in 30,000 stays without an answer.
const ATTEMPTS: u8 = 10;

impl ParameterManager {
    /// Returns whether everything was read (and set) or given up.
    pub(super) fn is_done(&self, firmware: Firmware) -> bool {
        !self.restores_first && self.next >= rules(firmware).len()
    }

    /// Adds parameters that an earlier run changed; they are restored before anything is read.
    pub(super) fn restore_first(&mut self, changes: &[ChangedParameter]) {
        for change in changes {
            let known = self.changed.iter().any(|known| known.name == change.name);
            if !known && self.changed.push(*change).is_ok() {
                self.restores_first = true;
            }
        }
    }

    /// Returns whether something must still be restored before anything is read.
    pub(super) fn restores_first(&self) -> bool {
        self.restores_first
    }

    /// Returns the parameters that differ from their original values, oldest first.
    pub(super) fn changed(&self) -> &[ChangedParameter] {
        &self.changed
    }

    /// Removes the last of the changed parameters, which needs not be restored any more.
    fn settled(&mut self) -> Option<ChangedParameter> {
        let change = self.changed.pop();
        self.restores_first &= !self.changed.is_empty();
        change
    }

    /// Returns the value of a parameter that was read.
    pub(super) fn value(&self, name: &str) -> Option<f32> {
        self.values()
            .find(|(known, _)| *known == name)
            .map(|(_, value)| value)
    }

    /// Returns all values that were read.
    pub(super) fn values(&self) -> impl Iterator<Item = (&'static str, f32)> + '_ {
        self.values.iter().copied()
    }

    /// Returns the parameter with the lowest speed below what the mission needs, and the value that
    /// it should have.
    pub(super) fn slowest(&self) -> Option<(&'static str, f32)> {
        self.slowest
    }

    /// Returns the lowest speed that a parameter allowed before any was set, m/s; `None` where none
    /// limits it.
    pub(super) fn found_mps(&self) -> Option<f32> {
        self.found_mps
    }

    /// Records the final value of a parameter and applies its limit.
    fn settle<T: Scalar>(
        &mut self,
        rule: &Rule,
        value: f32,
        needs: &Needs,
        limits: &mut Limits<T>,
    ) {
        // There are no more rules than places (verified by a test).
        let _ = self.values.push((rule.name, value));
        let before = limits.speed_mps;
        rule.effect.clip(value, limits);
        if limits.speed_mps < before
            && let Some((needed, _)) = rule.effect.needed(needs)
            && value < needed
        {
            self.slowest = Some((rule.name, needed));
        }
    }

    /// Returns whether nothing is left to be restored.
    pub(super) fn is_restored(&self) -> bool {
        self.changed.is_empty()
    }

    /// Gives up restoring the next changed parameter and returns a finding about it.
    pub(super) fn give_up(&mut self, firmware: Firmware) -> Option<Finding> {
        let change = self.settled()?;
        Some(Finding::NotRestored {
            name: change.name,
            value: change.value(firmware),
        })
    }

    fn conclude(&mut self) {
        self.next += 1;
        self.attempts = 0;
        self.due = Instant::ZERO;
        self.setting = None;
    }

    /// Returns the request that is due, if there is one, and reports parameters that were given up.
    pub(super) fn request<T: Scalar>(
        &mut self,
        now: Instant,
        (to, firmware): (Address, Firmware),
        needs: &Needs,
        limits: &mut Limits<T>,
        mut report: impl FnMut(Finding),
    ) -> Option<MavMessage> {
        let rules = rules(firmware);
        while now >= self.due {
            let rule = rules.get(self.next)?;
            let needless = rule.instead_of.is_some() && rule.instead_of == self.found;
            if needless || self.attempts >= ATTEMPTS {
                match self.setting {
                    // The parameter keeps its value, and its limit applies.
                    Some((was, _)) => {
                        self.settle(rule, was, needs, limits);
                        rule.effect
                            .judge(rule.name, was, needs)
                            .into_iter()
                            .for_each(&mut report);
                    }
                    // A parameter that has another name in other versions may be missing.
                    None if needless || is_renamed(rules, rule.name) => {}
                    None => report(Finding::Unread(rule.name)),
                }
                self.conclude();
                continue;
            }
            self.attempts += 1;
            self.due = now + ANSWER_TIME;
            return Some(match (self.setting, self.changed.last()) {
                (Some((_, wanted)), Some(change)) => {
                    let raw = encode(firmware, change.kind, wanted);
                    set(to, rule.name, raw, change.kind)
                }
                _ => MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
                    param_index: -1,
                    target_system: to.system,
                    target_component: to.component,
                    param_id: rule.name.into(),
                }),
            });
        }
        None
    }

    /// Processes a received value; values of parameters that were not requested are ignored. With
    /// `may_set`, a parameter that limits the mission is set next.
    pub(super) fn take<T: Scalar>(
        &mut self,
        firmware: Firmware,
        message: &PARAM_VALUE_DATA,
        needs: &Needs,
        limits: &mut Limits<T>,
        may_set: bool,
    ) -> Option<Finding> {
        let rule = rules(firmware).get(self.next)?;
        if self.attempts == 0 || message.param_id.to_str() != Ok(rule.name) {
            return None;
        }
        self.found = Some(rule.name);
        let value = number(firmware, message.param_type, message.param_value);
        if let Some((from, wanted)) = self.setting {
            // The old value again is a late answer, or a refusal: the request is repeated.
            let done = (value - wanted).abs() <= wanted.abs() * 1e-3;
            return done.then(|| {
                self.conclude();
                self.settle(rule, value, needs, limits);
                Finding::Set {
                    name: rule.name,
                    from,
                    to: value,
                }
            });
        }
        if let Effect::Speed(unit) = rule.effect {
            let found_mps = value / unit * MARGIN as f32;
            self.found_mps = Some(self.found_mps.map_or(found_mps, |mps| mps.min(found_mps)));
        }
        let finding = rule.effect.judge(rule.name, value, needs);
        if let Some(Finding::Clips { needed, .. }) = finding
            && may_set
            // A parameter that cannot be recorded is not changed. It is recorded before it is
            // changed, because the answer can be lost.
            && self.changed.push(ChangedParameter {
                name: rule.name,
                was: message.param_value,
                kind: message.param_type,
            }).is_ok()
        {
            self.setting = Some((value, needed));
            self.attempts = 0;
            self.due = Instant::ZERO;
            return None;
        }
        self.conclude();
        self.settle(rule, value, needs, limits);
        finding
    }

    /// Returns the next request that restores a parameter, and reports parameters that were given
    /// up.
    pub(super) fn restore(
        &mut self,
        now: Instant,
        (to, firmware): (Address, Firmware),
        mut report: impl FnMut(Finding),
    ) -> Option<MavMessage> {
        if self.setting.take().is_some() {
            self.attempts = 0;
            self.due = now;
        }
        while now >= self.due {
            let change = *self.changed.last()?;
            if self.attempts < ATTEMPTS {
                self.attempts += 1;
                self.due = now + ANSWER_TIME;
                return Some(set(to, change.name, change.was, change.kind));
            }
            self.give_up(firmware).into_iter().for_each(&mut report);
            self.attempts = 0;
        }
        None
    }

    /// Processes a received value while parameters are restored.
    pub(super) fn take_restored(
        &mut self,
        firmware: Firmware,
        message: &PARAM_VALUE_DATA,
    ) -> Option<Finding> {
        let change = self.changed.last()?;
        let same = message.param_id.to_str() == Ok(change.name)
            && message.param_value.to_bits() == change.was.to_bits();
        if self.attempts == 0 || !same {
            return None;
        }
        let name = change.name;
        self.settled();
        self.attempts = 0;
        self.due = Instant::ZERO;
        let value = number(firmware, message.param_type, message.param_value);
        Some(Finding::Restored { name, value })
    }
}

fn is_renamed(rules: &[Rule], name: &str) -> bool {
    rules.iter().any(|rule| rule.instead_of == Some(name))
}

fn set(to: Address, name: &'static str, raw: f32, kind: MavParamType) -> MavMessage {
    MavMessage::PARAM_SET(PARAM_SET_DATA {
        param_value: raw,
        target_system: to.system,
        target_component: to.component,
        param_id: name.into(),
        param_type: kind,
    })
}

/// Encodes a number as a parameter's value on the wire: the inverse of [`number`].
fn encode(firmware: Firmware, kind: MavParamType, value: f32) -> f32 {
    match kind {
        MavParamType::MAV_PARAM_TYPE_INT32 if firmware == Firmware::Px4 => {
            f32::from_bits(libm::roundf(value) as i32 as u32)
        }
        _ => value,
    }
}

/// Decodes a parameter's value: ArduPilot sends numbers, PX4 the bytes of its integers.
fn number(firmware: Firmware, kind: MavParamType, raw: f32) -> f32 {
    match kind {
        MavParamType::MAV_PARAM_TYPE_INT32 if firmware == Firmware::Px4 => {
            raw.to_bits() as i32 as f32
        }
        _ => raw,
    }
}

#[cfg(test)]
mod tests {
    use std::string::ToString;

    use super::*;

    const NEEDS: Needs = Needs { speed_mps: 30.0 };
    const TO: Address = Address {
        system: 1,
        component: 1,
    };

    #[test]
    fn a_clipping_parameter_is_named_with_what_it_should_be() {
        let finding = ARDUCOPTER[0].effect.judge("WPNAV_SPEED", 1000.0, &NEEDS);
        assert_eq!(
            finding.unwrap().to_string(),
            "WPNAV_SPEED is 1000: it clips speed; set it to 3500"
        );
        assert_eq!(PX4[0].effect.judge("MPC_XY_VEL_MAX", 35.0, &NEEDS), None);
        let mut limits = Limits::<f64>::ideal();
        ARDUCOPTER[0].effect.clip(1000.0, &mut limits);
        assert_eq!(limits.speed_mps, 9.5);
    }

    #[test]
    fn every_value_and_every_change_can_be_kept() {
        for firmware in [Firmware::ArduCopter, Firmware::Px4] {
            let rules = rules(firmware);
            let clipping = rules.iter().filter(|rule| {
                let needs = NEEDS;
                rule.effect.needed(&needs).is_some()
            });
            assert!(rules.len() <= VALUES && clipping.count() <= CHANGES);
        }
    }

    /// The parameter to change is the one that leaves the lowest speed.
    #[test]
    fn the_slowest_parameter_is_named() {
        let mut manager = ParameterManager::default();
        let mut values = std::vec![("WPNAV_SPEED", 1000.0), ("ANGLE_MAX", 3000.0)];
        play(&mut manager, &mut values, false, false, |_| false);
        assert_eq!(manager.slowest(), Some(("WPNAV_SPEED", 3500.0)));
    }

    /// What is asked for is enough: a vehicle set so is not clipped below the mission's speed.
    #[test]
    fn what_is_needed_does_not_clip() {
        for firmware in [Firmware::ArduCopter, Firmware::Px4] {
            for speed_mps in [3.0, 12.0, 30.0, 55.5] {
                let mut limits = Limits::<f64>::ideal();
                for rule in rules(firmware) {
                    let needs = Needs { speed_mps };
                    if let Some((needed, _)) = rule.effect.needed(&needs) {
                        assert_eq!(rule.effect.judge(rule.name, needed, &needs), None);
                        rule.effect.clip(needed, &mut limits);
                    }
                }
                assert!(limits.speed_mps > f64::from(speed_mps), "{limits:?}");
            }
        }
    }

    /// Plays an autopilot with these parameters until the manager has nothing more to ask.
    fn play(
        manager: &mut ParameterManager,
        values: &mut std::vec::Vec<(&'static str, f32)>,
        may_set: bool,
        restoring: bool,
        lost: impl Fn(u32) -> bool,
    ) -> (Limits<f64>, std::vec::Vec<std::string::String>) {
        let firmware = Firmware::ArduCopter;
        let (mut limits, mut said) = (Limits::<f64>::ideal(), std::vec::Vec::new());
        let mut now = Instant::ZERO + Duration::from_secs(100);
        for round in 0..2_000 {
            now += Duration::from_millis(100);
            let to = (TO, firmware);
            let report = |finding: Finding| said.push(finding.to_string());
            let message = match restoring {
                true => manager.restore(now, to, report),
                false => manager.request(now, to, &NEEDS, &mut limits, report),
            };
            let name = match &message {
                Some(MavMessage::PARAM_REQUEST_READ(read)) => read.param_id,
                Some(MavMessage::PARAM_SET(set)) => set.param_id,
                _ => continue,
            };
            let known = values
                .iter_mut()
                .find(|(known, _)| name.to_str() == Ok(*known));
            let Some((_, value)) = known else { continue };
            if let Some(MavMessage::PARAM_SET(set)) = message {
                *value = set.param_value;
            }
            let answer = PARAM_VALUE_DATA {
                param_id: name,
                param_value: *value,
                param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
                ..PARAM_VALUE_DATA::DEFAULT
            };
            if !lost(round) {
                let found = match restoring {
                    true => manager.take_restored(firmware, &answer),
                    false => manager.take(firmware, &answer, &NEEDS, &mut limits, may_set),
                };
                said.extend(found.map(|finding| finding.to_string()));
            }
        }
        (limits, said)
    }

    #[test]
    fn what_clips_is_set_and_put_back_even_if_every_second_answer_is_lost() {
        let found = std::vec![
            ("WPNAV_SPEED", 1000.0),
            ("WPNAV_ACCEL", 250.0),
            ("ANGLE_MAX", 3000.0),
            ("PSC_ANGLE_MAX", 0.0),
            ("PSC_JERK_XY", 5.0),
            ("FS_GCS_ENABLE", 1.0),
            ("FS_GCS_TIMEOUT", 5.0),
            ("SYSID_MYGCS", 255.0),
            ("GUID_TIMEOUT", 3.0),
            ("FENCE_ENABLE", 0.0),
            ("FENCE_TYPE", 7.0),
            ("FENCE_RADIUS", 300.0),
            ("FENCE_ALT_MAX", 100.0),
        ];
        let (mut values, mut manager) = (found.clone(), ParameterManager::default());
        let (limits, said) = play(&mut manager, &mut values, true, false, |n| n / 6 % 2 == 0);
        assert!(manager.is_done(Firmware::ArduCopter));
        assert_eq!(
            said,
            [
                "WPNAV_SPEED set from 1000 to 3500",
                "WPNAV_ACCEL set from 250 to 1000",
                "ANGLE_MAX set from 3000 to 4500",
                "PSC_JERK_XY set from 5 to 20"
            ]
        );
        assert!(limits.speed_mps > 30.0);
        assert_eq!(manager.value("FENCE_RADIUS"), Some(300.0));
        assert_eq!(values[..3].iter().map(|v| v.1).sum::<f32>(), 9000.0);
        let (_, said) = play(&mut manager, &mut values, true, true, |n| n / 6 % 2 == 0);
        assert_eq!(values, found);
        assert!(manager.is_restored() && said.len() == 4, "{said:?}");
    }

    /// An autopilot that refuses is obeyed; one that falls silent leaves us with words.
    #[test]
    fn what_cannot_be_set_or_put_back_is_said() {
        let mut values = std::vec![("WPNAV_SPEED", 1000.0)];
        let mut manager = ParameterManager::default();
        let (limits, said) = play(&mut manager, &mut values, true, false, |n| n > 0);
        assert_eq!(limits.speed_mps, 9.5);
        assert_eq!(
            said[0],
            "WPNAV_SPEED is 1000: it clips speed; set it to 3500"
        );
        let (_, said) = play(&mut manager, &mut values, true, true, |_| true);
        assert_eq!(said, ["WPNAV_SPEED was NOT put back: it was 1000"]);
    }

    #[test]
    fn a_renamed_parameter_is_asked_for_only_where_the_old_one_is_missing() {
        for old_exists in [true, false] {
            let mut manager = ParameterManager::default();
            let mut asked = std::vec::Vec::new();
            let mut now = Instant::ZERO;
            let mut limits = Limits::<f64>::ideal();
            while !manager.is_done(Firmware::ArduCopter) {
                let to = (TO, Firmware::ArduCopter);
                let request = manager.request(now, to, &NEEDS, &mut limits, |_| {});
                if let Some(MavMessage::PARAM_REQUEST_READ(request)) = request {
                    let name = request.param_id.to_str().unwrap().to_string();
                    let newer = name.starts_with("WP_")
                        || ["ATC_ANGLE_MAX", "PSC_JERK_NE", "MAV_GCS_SYSID"]
                            .contains(&name.as_str());
                    let older = name.starts_with("WPNAV_")
                        || ["ANGLE_MAX", "PSC_JERK_XY", "SYSID_MYGCS"].contains(&name.as_str());
                    let exists = !(newer && old_exists || older && !old_exists);
                    let answer = PARAM_VALUE_DATA {
                        param_id: request.param_id,
                        param_value: 1.0,
                        ..PARAM_VALUE_DATA::DEFAULT
                    };
                    asked.push(name);
                    if exists {
                        manager.take(to.1, &answer, &NEEDS, &mut limits, false);
                    }
                }
                now += Duration::from_millis(100);
            }
            for newer in [
                "WP_SPD",
                "WP_ACC",
                "ATC_ANGLE_MAX",
                "PSC_JERK_NE",
                "MAV_GCS_SYSID",
            ] {
                let asks = asked.iter().any(|name| name == newer);
                assert_eq!(asks, !old_exists, "{newer}: {asked:?}");
            }
            assert_eq!(asked.iter().filter(|n| *n == "GUID_TIMEOUT").count(), 1);
        }
    }
}
