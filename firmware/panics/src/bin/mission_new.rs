//! The checks of a mission, and a change of it.
#![no_std]
#![no_main]

use firmware_core::{
    Mission, SENSORS_MAX, USERS_MAX,
    mission::{ChangeError, MissionChange, MissionError, MissionParameters},
};
use panics as _;

type Changed = (
    Mission<f32, USERS_MAX, SENSORS_MAX>,
    Result<(), ChangeError<f32>>,
);

#[unsafe(no_mangle)]
pub fn entry(
    parameters: &MissionParameters<f32, USERS_MAX, SENSORS_MAX>,
    change: &MissionChange<f32>,
    slots_begun: u32,
) -> Result<Changed, MissionError<f32>> {
    let mut mission = Mission::new(parameters.clone())?;
    let changed = mission.change(change, slots_begun);
    Ok((mission, changed))
}
