//! The rule-based policies that the paper compares with.

use heapless::Vec;

use super::{Action, Observation, Policy};
use crate::{
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
    users
        .iter()
        .map(|user| -(user - vehicle).norm_squared())
        .collect()
}
