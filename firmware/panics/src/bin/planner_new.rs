//! The creation of a planner in its memory.
#![no_std]
#![no_main]

use firmware_core::{
    console::{BoardMission, PlannerBytes, PlannerNumbers, board_planner},
    planner::PlannerError,
};
use panics::Planner;

#[unsafe(no_mangle)]
pub fn entry(
    place: &'static mut Option<Planner>,
    mission: &BoardMission,
    memory: (&'static mut PlannerNumbers, &'static mut PlannerBytes),
) -> Result<&'static mut Planner, PlannerError> {
    board_planner(place, mission, memory)
}
