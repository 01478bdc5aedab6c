//! The panic handler of the probes in `src/bin`, which does not exist.
//!
//! Each probe is a program whose only function, `entry`, calls one entry point of `firmware-core`.
//! The panic handler calls a function that is defined nowhere. If the compiler cannot prove that
//! the entry point never panics, a call of the handler remains, and the program does not link.
//!
//! The arguments of `entry` come from outside, so the compiler knows nothing about their values
//! beyond their types; references stand in for state that other functions would have created. What
//! `entry` returns is used by nobody that the compiler could see, so nothing is left out.
//!
//! With the feature `diagnose` the handler exists, all probes link, and they contain the place of each
//! panic that is left.
#![no_std]

use core::panic::PanicInfo;

use firmware_core::{
    SENSORS_MAX, USERS_MAX,
    console::{BoardComputer, BoardPlanner, PlannerBytes, PlannerNumbers},
    controller::Controller,
    policy::{
        mlp::Mlp,
        sets::{NetworkWithWork, SetsNetwork, SetsPolicy, SetsWork},
    },
};

/// The trained policy of a board.
pub type Trained = Mlp<&'static [u8]>;

/// A network for any mission.
pub type AnyNetwork = SetsNetwork<&'static [u8]>;

/// The trained policy for any mission.
pub type AnyMission =
    SetsPolicy<f32, NetworkWithWork<&'static [u8], &'static mut SetsWork>, USERS_MAX, SENSORS_MAX>;

/// The controller of a board with a trained policy.
pub type TrainedController = Controller<f32, Trained, USERS_MAX, SENSORS_MAX>;

/// The planner of a board.
pub type Planner = BoardPlanner<(&'static mut PlannerNumbers, &'static mut PlannerBytes)>;

/// The onboard computer of a board, with all its policies.
pub type Computer = BoardComputer<Trained, &'static mut Planner>;

/// The same with the policy for any mission in flash.
pub type AnyMissionComputer = BoardComputer<&'static mut AnyMission, &'static mut Planner>;

#[cfg(not(feature = "diagnose"))]
unsafe extern "C" {
    /// Not defined anywhere.
    safe fn an_entry_point_can_panic() -> !;
}

#[cfg(not(feature = "diagnose"))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    an_entry_point_can_panic()
}

/// Uses the place of the panic, so that it is in the program.
#[cfg(feature = "diagnose")]
#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    loop {
        core::hint::black_box(info.location());
    }
}
