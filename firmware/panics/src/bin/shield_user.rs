//! The admissible user for scores.
#![no_std]
#![no_main]

use firmware_core::{
    Mission, SENSORS_MAX, USERS_MAX,
    shield::{self, Fairness, Intervention},
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    fairness: &mut Fairness<USERS_MAX>,
    mission: &Mission<f32, USERS_MAX, SENSORS_MAX>,
    scores: &[f32],
    changed: &mut Intervention,
) -> Option<usize> {
    fairness.revise(mission, None);
    let user = shield::admissible_user(fairness, scores, changed);
    fairness.record(user);
    user
}
