// SPDX-License-Identifier: MIT OR Apache-2.0
//! Reads parameters, sets those that limit the mission, and restores them.

use heapless::Vec;
use mavlink::dialects::common::{
    MavMessage, MavParamType, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA,
};

use super::finding::Finding;
use super::rules::{ARDUCOPTER, Effect, MARGIN, Needs, PX4, Rule, is_renamed, rules};
use crate::scalar::Scalar;
use crate::time::{Duration, Instant};
use crate::{
    autopilot::{profile::Firmware, wire::Address},
    limits::MotionLimits,
};

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
pub(super) const CHANGES: usize = 9;

/// The largest number of parameters that are read; no autopilot here has more rules.
pub(super) const VALUES: usize = 18;

/// Reads one parameter after the other, sets those that limit the mission if that is allowed, and
/// restores them.
#[derive(Clone, Debug, Default)]
pub(in crate::autopilot) struct ParameterManager {
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
    pub(in crate::autopilot) fn is_done(&self, firmware: Firmware) -> bool {
        !self.restores_first && self.next >= rules(firmware).len()
    }

    /// Adds parameters that an earlier run changed; they are restored before anything is read.
    pub(in crate::autopilot) fn restore_first(&mut self, changes: &[ChangedParameter]) {
        for change in changes {
            let known = self.changed.iter().any(|known| known.name == change.name);
            if !known && self.changed.push(*change).is_ok() {
                self.restores_first = true;
            }
        }
    }

    /// Returns whether something must still be restored before anything is read.
    pub(in crate::autopilot) fn restores_first(&self) -> bool {
        self.restores_first
    }

    /// Returns the parameters that differ from their original values, oldest first.
    pub(in crate::autopilot) fn changed(&self) -> &[ChangedParameter] {
        &self.changed
    }

    /// Removes the last of the changed parameters, which needs not be restored any more.
    fn settled(&mut self) -> Option<ChangedParameter> {
        let change = self.changed.pop();
        self.restores_first &= !self.changed.is_empty();
        change
    }

    /// Returns the value of a parameter that was read.
    pub(in crate::autopilot) fn value(&self, name: &str) -> Option<f32> {
        self.values()
            .find(|(known, _)| *known == name)
            .map(|(_, value)| value)
    }

    /// Returns all values that were read.
    pub(in crate::autopilot) fn values(&self) -> impl Iterator<Item = (&'static str, f32)> + '_ {
        self.values.iter().copied()
    }

    /// Returns the parameter with the lowest speed below what the mission needs, and the value that
    /// it should have.
    pub(in crate::autopilot) fn slowest(&self) -> Option<(&'static str, f32)> {
        self.slowest
    }

    /// Returns the lowest speed that a parameter allowed before any was set, m/s; `None` where none
    /// limits it.
    pub(in crate::autopilot) fn found_mps(&self) -> Option<f32> {
        self.found_mps
    }

    /// Records the final value of a parameter and applies its limit.
    fn settle<T: Scalar>(
        &mut self,
        rule: &Rule,
        value: f32,
        needs: &Needs,
        limits: &mut MotionLimits<T>,
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
    pub(in crate::autopilot) fn is_restored(&self) -> bool {
        self.changed.is_empty()
    }

    /// Gives up restoring the next changed parameter and returns a finding about it.
    pub(in crate::autopilot) fn give_up(&mut self, firmware: Firmware) -> Option<Finding> {
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
    pub(in crate::autopilot) fn request<T: Scalar>(
        &mut self,
        now: Instant,
        (to, firmware): (Address, Firmware),
        needs: &Needs,
        limits: &mut MotionLimits<T>,
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
    pub(in crate::autopilot) fn take<T: Scalar>(
        &mut self,
        firmware: Firmware,
        message: &PARAM_VALUE_DATA,
        needs: &Needs,
        limits: &mut MotionLimits<T>,
        may_set: bool,
    ) -> Option<Finding> {
        let rule = rules(firmware).get(self.next)?;
        if self.attempts == 0 || !is_named(message, rule.name) {
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
    pub(in crate::autopilot) fn restore(
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
    pub(in crate::autopilot) fn take_restored(
        &mut self,
        firmware: Firmware,
        message: &PARAM_VALUE_DATA,
    ) -> Option<Finding> {
        let change = self.changed.last()?;
        let same =
            is_named(message, change.name) && message.param_value.to_bits() == change.was.to_bits();
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
        MavParamType::MAV_PARAM_TYPE_INT32 if firmware.sends_integers_as_bytes() => {
            f32::from_bits(libm::roundf(value) as i32 as u32)
        }
        _ => value,
    }
}

/// Decodes a parameter's value: ArduPilot sends numbers, PX4 the bytes of its integers.
fn number(firmware: Firmware, kind: MavParamType, raw: f32) -> f32 {
    match kind {
        MavParamType::MAV_PARAM_TYPE_INT32 if firmware.sends_integers_as_bytes() => {
            raw.to_bits() as i32 as f32
        }
        _ => raw,
    }
}

/// Returns whether a value is that of this parameter.
fn is_named(message: &PARAM_VALUE_DATA, name: &str) -> bool {
    // Shorter names end at a NUL.
    let sent = message.param_id.iter().take_while(|&&byte| byte != 0);
    sent.eq(name.as_bytes())
}
