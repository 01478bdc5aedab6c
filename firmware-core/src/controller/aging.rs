// SPDX-License-Identifier: MIT OR Apache-2.0
//! Estimates the channels of a slot for which no state was received, from the last state.
//!
//! A link's gain is assumed to be the gain of the channel model times a factor of that link, as
//! last measured. The age of the measurement limits how far it is trusted: the gain lies between
//! the gains that the factor and the model give at `age V_max delta` further from the vehicle and
//! nearer to it, the distance that could have been flown since. With age the bounds widen to the
//! worst case, which is the far end of the area on one side and straight below on the other. The
//! controller then guarantees its result for every gain between the bounds
//! ([`inner::bounded`](crate::inner::bounded)).
//!
//! This assumes that links change no faster than flying changes the model, and that the factor is a
//! property of the link. A mission without any state yet begins with factors of 1, aged from slot
//! 0. A link that was not heard in the last state is assumed not to be heard now. Where the gains come
//! from a map, the gains of the model are replaced by the least and the largest one of the map nearby.

use heapless::Vec;

use crate::{
    channel::GroundNode,
    collect::collect_first,
    inner::bounded::GainBounds,
    mission::{Mission, MissionChange},
    policy::MeasuredGains,
    scalar::{Position, Scalar},
    units::PowerGain,
};

/// The last channel state that was received.
#[derive(Clone, Debug)]
pub(super) struct LastState<T: Scalar, const M: usize, const J: usize> {
    /// The slot of the state; 0 if none was received.
    slot: u32,
    /// The measured position at which the next slot was planned.
    place: Option<Position<T>>,
    users: Vec<PowerGain<T>, M>,
    sensors: Vec<PowerGain<T>, J>,
}

/// Bounds on every gain of a slot.
#[derive(Clone, Debug)]
pub(super) struct AgedState<T, const M: usize, const J: usize> {
    pub(super) age_slots: u32,
    pub(super) users: Vec<GainBounds<T>, M>,
    pub(super) sensors: Vec<GainBounds<T>, J>,
}

impl<T: Scalar, const M: usize, const J: usize> LastState<T, M, J> {
    pub(super) fn none() -> Self {
        Self {
            slot: 0,
            place: None,
            users: Vec::new(),
            sensors: Vec::new(),
        }
    }

    /// Records the gains of a slot; gains that are 0 are not heard.
    pub(super) fn replace(
        &mut self,
        slot: u32,
        users: &Vec<PowerGain<T>, M>,
        sensors: &Vec<PowerGain<T>, J>,
    ) {
        self.slot = slot;
        self.place = None;
        self.users.clone_from(users);
        self.sensors.clone_from(sensors);
    }

    /// Forgets the gain of a user or sensor that is at another place now: NaN stands for a gain that
    /// is not known, and the channel model is used.
    pub(super) fn forget(&mut self, change: &MissionChange<T>) {
        let gain = match *change {
            MissionChange::User { user, .. } => self.users.get_mut(usize::from(user)),
            MissionChange::Sensor { sensor, .. } => self.sensors.get_mut(usize::from(sensor)),
            _ => None,
        };
        if let Some(gain) = gain {
            *gain = PowerGain(T::of(f64::NAN));
        }
    }

    /// Records the position that was measured after the last slot's end.
    pub(super) fn locate(&mut self, place: Position<T>) {
        self.place.get_or_insert(place);
    }

    /// Returns the gains if they were measured in `slot`, and the position since.
    pub(super) fn of_slot(&self, slot: u32) -> Option<MeasuredGains<'_, T>> {
        let position = self.place.filter(|_| self.slot == slot && slot > 0)?;
        Some(MeasuredGains {
            position,
            user_gains: &self.users,
            sensor_gains: &self.sensors,
        })
    }

    /// Returns bounds on the gains in `slot` over `here`.
    pub(super) fn aged(
        &self,
        mission: &Mission<T, M, J>,
        slot: u32,
        here: &Position<T>,
    ) -> AgedState<T, M, J> {
        let age_slots = slot.saturating_sub(self.slot);
        let strayed_m = T::count(age_slots as usize) * mission.reach_m();
        let p = mission.parameters();
        let channel = mission.channel();
        let bounds = |node: GroundNode, ground: &Position<T>, last: Option<&PowerGain<T>>| {
            let away_m = (here - ground).norm();
            let far = Position::new(
                ground.x.max(p.area.east_m - ground.x),
                ground.y.max(p.area.north_m - ground.y),
            );
            let farthest_m = far.coords.norm().max(away_m);
            let factor = match (last, &self.place) {
                (Some(gain), Some(place)) if gain.0.finite() => {
                    gain.0 / mission.power_gain(node, place).0
                }
                _ => T::one(),
            };
            let gain = |horizontal_m: T| factor * channel.power_gain_across(horizontal_m).0;
            let bounds = match mission.map_bounds(node, here, strayed_m) {
                Some((least, most)) => GainBounds {
                    least: PowerGain(factor * least.0),
                    most: PowerGain(factor * most.0),
                },
                None => GainBounds {
                    least: PowerGain(gain((away_m + strayed_m).min(farthest_m))),
                    most: PowerGain(gain((away_m - strayed_m).max(T::zero()))),
                },
            };
            if bounds.least.is_valid() && bounds.most.is_valid() {
                bounds
            } else {
                // A factor beyond the number type: nothing is known.
                GainBounds::default()
            }
        };
        let users = p.users.iter().enumerate();
        let sensors = p.sensors.iter().enumerate();
        AgedState {
            age_slots,
            users: collect_first(
                users.map(|(m, ground)| bounds(GroundNode::User(m), ground, self.users.get(m))),
            ),
            sensors: collect_first(
                sensors
                    .map(|(j, ground)| bounds(GroundNode::Sensor(j), ground, self.sensors.get(j))),
            ),
        }
    }
}
