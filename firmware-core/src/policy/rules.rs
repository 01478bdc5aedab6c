// SPDX-License-Identifier: MIT OR Apache-2.0
//! The rule-based policies that the paper compares with.

use heapless::Vec;

use super::{Action, MeasuredGains, Observation, PlanQuality, Policy};
use crate::{
    collect::collect_first,
    mission::{Mission, MissionChange},
    scalar::{Position, Scalar},
};

/// Flies straight to the destination at constant speed and serves the nearest user ("straight-line
/// trajectory and nearest user access"). Holds what the rule needs to know of the mission.
#[derive(Clone, Debug)]
pub struct StraightLine<T: Scalar, const M: usize> {
    slots: u32,
    destination: Position<T>,
    users: Vec<Position<T>, M>,
}

impl<T: Scalar, const M: usize> StraightLine<T, M> {
    /// Creates the policy for a mission.
    pub fn new<const J: usize>(mission: &Mission<T, M, J>) -> Self {
        Self {
            slots: mission.slots(),
            destination: mission.parameters().destination,
            users: mission.parameters().users.clone(),
        }
    }
}

impl<T: Scalar, const M: usize> Policy<T, M> for StraightLine<T, M> {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        let slots_left = self.slots.saturating_sub(observation.slot) + 1;
        let displacement =
            (self.destination - observation.position) / T::count(slots_left as usize);
        Action {
            displacement,
            user_scores: nearness(&self.users, &(observation.position + displacement)),
        }
    }

    fn revise(&mut self, change: &MissionChange<T>, _: u32) {
        match *change {
            MissionChange::Slots(slots) => self.slots = slots,
            _ => move_user(&mut self.users, change),
        }
    }

    fn note_gains(&mut self, _: &MeasuredGains<'_, T>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
}

/// Hovers over one place and serves the nearest user ("fixed UAV position"). The shield flies the
/// vehicle there from the start as fast as allowed, and away in time for the destination.
#[derive(Clone, Debug)]
pub struct FixedPosition<T: Scalar, const M: usize> {
    place: Position<T>,
    users: Vec<Position<T>, M>,
}

impl<T: Scalar, const M: usize> FixedPosition<T, M> {
    /// Creates the policy for hovering over `place`, metres.
    pub fn new<const J: usize>(mission: &Mission<T, M, J>, place: Position<T>) -> Self {
        Self {
            place,
            users: mission.parameters().users.clone(),
        }
    }

    /// Creates the policy for hovering over the centroid of all users and sensors. This is our
    /// choice; the paper names no place.
    pub fn central<const J: usize>(mission: &Mission<T, M, J>) -> Self {
        let p = mission.parameters();
        let nodes = T::count(p.users.len() + p.sensors.len());
        let sum = p
            .users
            .iter()
            .chain(&p.sensors)
            .fold(nalgebra::Vector2::zeros(), |sum, place| sum + place.coords);
        Self::new(mission, Position::from(sum / nodes))
    }
}

impl<T: Scalar, const M: usize> Policy<T, M> for FixedPosition<T, M> {
    fn decide(&mut self, observation: &Observation<'_, T>) -> Action<T, M> {
        Action {
            displacement: self.place - observation.position,
            user_scores: nearness(&self.users, &self.place),
        }
    }

    fn revise(&mut self, change: &MissionChange<T>, _: u32) {
        move_user(&mut self.users, change);
    }

    fn note_gains(&mut self, _: &MeasuredGains<'_, T>) {}

    fn improve(&mut self, _: u64) {}

    fn quality(&self) -> Option<PlanQuality> {
        None
    }
}

/// Takes over the position of a user that moved or joined.
fn move_user<T: Scalar, const M: usize>(
    users: &mut Vec<Position<T>, M>,
    change: &MissionChange<T>,
) {
    if let MissionChange::User { user, position_m } = *change {
        match users.get_mut(usize::from(user)) {
            Some(place) => *place = position_m,
            // The mission has accepted the user, so it has the next number and there is capacity.
            None => drop(users.push(position_m)),
        }
    }
}

/// Returns a score per user that is highest for the nearest user.
fn nearness<T: Scalar, const M: usize>(
    users: &Vec<Position<T>, M>,
    vehicle: &Position<T>,
) -> Vec<T, M> {
    collect_first(users.iter().map(|user| -(user - vehicle).norm_squared()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{scalar::Displacement, shield::Agility, test_missions::table_one};

    fn observation(slot: u32, position: Position<f64>) -> Observation<'static, f64> {
        Observation {
            slot,
            counts: &[0; 15],
            rate: 0.0,
            mse: 0.0,
            position,
            agility: Agility::ideal(&table_one()),
        }
    }

    fn highest(scores: &[f64]) -> usize {
        (0..scores.len())
            .max_by(|&a, &b| scores[a].total_cmp(&scores[b]))
            .expect("users")
    }

    fn nearest(users: &[Position<f64>], place: Position<f64>) -> usize {
        (0..users.len())
            .min_by(|&a, &b| {
                let distance = |user: usize| (users[user] - place).norm();
                distance(a).total_cmp(&distance(b))
            })
            .expect("users")
    }

    /// Equal steps that end at the destination, from wherever the vehicle is; served is the user
    /// nearest to where a step ends.
    #[test]
    fn the_straight_line_has_equal_steps_to_the_destination() {
        let mission = table_one::<f64>();
        let p = mission.parameters();
        let mut policy = StraightLine::<f64, 16>::new(&mission);
        for first in [1, 30, p.slots] {
            let start = Position::new(700.0, 200.0);
            let mut here = start;
            let step = (p.destination - start) / f64::from(p.slots - first + 1);
            for slot in first..=p.slots {
                let action = policy.decide(&observation(slot, here));
                assert!((action.displacement - step).norm() < 1e-9, "slot {slot}");
                here += action.displacement;
                assert_eq!(highest(&action.user_scores), nearest(&p.users, here));
            }
            assert!((here - p.destination).norm() < 1e-6);
        }
    }

    /// The central position is the mean of users and sensors, and the user nearest to it is served.
    #[test]
    fn the_fixed_position_is_the_centroid() {
        let mission = table_one::<f64>();
        let p = mission.parameters();
        let mut policy = FixedPosition::<f64, 16>::central(&mission);
        let action = policy.decide(&observation(1, p.start));
        let place = p.start + action.displacement;
        let nodes = || p.users.iter().chain(&p.sensors);
        let offsets = nodes().fold(Displacement::zeros(), |sum, node| sum + (node - place));
        assert!(offsets.norm() < 1e-6, "{place} {offsets}");
        assert_eq!(highest(&action.user_scores), nearest(&p.users, place));
        assert_eq!(action.user_scores.len(), p.users.len());
    }
}
