// SPDX-License-Identifier: MIT OR Apache-2.0
//! The rates of the users as a function of the vehicle's position, from the exact solution of the
//! slot problem ([`crate::inner`]).

use crate::{
    channel::GroundNode,
    inner::{SlotLimits, Workspace},
    mission::Mission,
    scalar::{Position, Scalar},
    units::PowerGain,
};

/// The rate of a user that left, bit/s/Hz: below every rate and price, so that no assignment serves
/// it.
const ABSENT: f64 = -1000.0;

/// A source of amplitude gains.
pub(crate) trait AmplitudeGains<T: Scalar> {
    /// Returns the amplitude gain between a vehicle over `place` and a node, which is at `ground`.
    fn amplitude<const M: usize, const J: usize>(
        &self,
        mission: &Mission<T, M, J>,
        place: &Position<T>,
        node: (GroundNode, &Position<T>),
    ) -> T;
}

/// The gains of the mission's channel model or map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MissionGains;

impl<T: Scalar> AmplitudeGains<T> for MissionGains {
    fn amplitude<const M: usize, const J: usize>(
        &self,
        mission: &Mission<T, M, J>,
        place: &Position<T>,
        (node, _): (GroundNode, &Position<T>),
    ) -> T {
        mission.power_gain(node, place).amplitude()
    }
}

/// Everything that is needed to evaluate rates at a place.
pub(crate) struct PlaceRates<'a, T: Scalar, G, const M: usize, const J: usize> {
    pub(crate) mission: &'a Mission<T, M, J>,
    pub(crate) limits: &'a SlotLimits<T>,
    pub(crate) gains: G,
    pub(crate) workspace: &'a mut Workspace<T, J>,
}

impl<T: Scalar, G: AmplitudeGains<T>, const M: usize, const J: usize> PlaceRates<'_, T, G, M, J> {
    /// Calls `visit` with the rate, bit/s/Hz, of every user in `users` with the vehicle over
    /// `place`; 0 where no choice meets `Gamma`, and [`ABSENT`] for users that left. Worst case: one
    /// sort of `J` sensors, then `O(log J)` per user.
    pub(crate) fn each(
        &mut self,
        place: &Position<T>,
        users: impl Iterator<Item = usize>,
        mut visit: impl FnMut(usize, T),
    ) {
        let mut amplitudes = [T::zero(); J];
        let sensors = self.sensor_amplitudes(place, &mut amplitudes);
        let mission = self.mission;
        let p = mission.parameters();
        let field = self.workspace.sensors_of_amplitude(self.limits, sensors);
        let feasible = field.as_ref().is_ok_and(|field| field.is_feasible());
        for user in users {
            let rate = match (&field, p.users.get(user)) {
                _ if !mission.has_user(user) => T::of(ABSENT),
                (Ok(field), Some(ground)) if feasible => {
                    let node = (GroundNode::User(user), ground);
                    let amplitude = self.gains.amplitude(mission, place, node);
                    field.rate(PowerGain(amplitude * amplitude))
                }
                _ => T::zero(),
            };
            visit(user, if rate.finite() { rate } else { T::zero() });
        }
    }

    /// Writes the amplitude gains of the sensors that are there to the beginning of `amplitudes`,
    /// and returns it.
    pub(crate) fn sensor_amplitudes<'s>(
        &self,
        place: &Position<T>,
        amplitudes: &'s mut [T; J],
    ) -> &'s [T] {
        let mut count = 0;
        for ((sensor, ground), amplitude) in self.mission.sensors().zip(amplitudes.iter_mut()) {
            let node = (GroundNode::Sensor(sensor), ground);
            *amplitude = self.gains.amplitude(self.mission, place, node);
            count += 1;
        }
        amplitudes.get(..count).unwrap_or(&[])
    }
}
