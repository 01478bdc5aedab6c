//! The policy for any mission created, and a change of the mission.
#![no_std]
#![no_main]

use firmware_core::{
    Mission,
    mission::MissionChange,
    policy::{
        Policy,
        sets::{NetworkWithWork, SetsMismatch, SetsWork},
    },
};
use panics::{AnyMission, AnyNetwork};

#[unsafe(no_mangle)]
pub fn entry(
    network: AnyNetwork,
    mission: &Mission<f32>,
    work: &'static mut SetsWork,
    change: &MissionChange<f32>,
    slots_begun: u32,
) -> Result<AnyMission, SetsMismatch> {
    let mut policy = AnyMission::new(NetworkWithWork { network, work }, mission)?;
    policy.revise(change, slots_begun);
    Ok(policy)
}
