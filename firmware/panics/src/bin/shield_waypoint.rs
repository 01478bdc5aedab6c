//! The admissible waypoint for a displacement.
#![no_std]
#![no_main]

use firmware_core::{
    Displacement, Mission, Position, SENSORS_MAX, USERS_MAX,
    shield::{self, Agility, Intervention, ReachableSet},
};
use panics as _;

#[unsafe(no_mangle)]
pub fn entry(
    mission: &Mission<f32, USERS_MAX, SENSORS_MAX>,
    slot: u32,
    position: Position<f32>,
    agility: &Agility<f32>,
    displacement: &Displacement<f32>,
    changed: &mut Intervention,
) -> Option<Position<f32>> {
    if !shield::displacement_is_sound(displacement) {
        return None;
    }
    let set = ReachableSet::of_slot_with(mission, slot, position, agility);
    Some(shield::admissible_waypoint(&set, displacement, changed))
}
