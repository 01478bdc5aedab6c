//! Solves a slot, without std and without an allocator. See Cargo.toml.
#![no_std]
#![no_main]

use core::panic::PanicInfo;

use firmware_core::{
    PowerGain, Watt,
    inner::{SlotLimits, exact::Workspace},
};

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}

/// The prebuilt `core` names this; with `panic = "abort"` nothing calls it.
#[unsafe(no_mangle)]
pub extern "C" fn rust_eh_personality() {}

/// The C start-up calls this; 0 says that the slot came out feasible.
#[unsafe(no_mangle)]
pub extern "C" fn main() -> i32 {
    let limits = SlotLimits {
        sensor_power_max: Watt(0.05_f32),
        user_power_max: Watt(0.2),
        noise_power: Watt(3.162_277_6e-13),
        mse_threshold: 0.015,
    };
    let gains = [PowerGain(4e-12_f32); 36];
    let mut workspace = Workspace::<f32, 64>::default();
    let solved = workspace
        .sensors(&limits, &gains)
        .and_then(|field| field.solve(Some(PowerGain(2e-12))));
    match solved {
        Ok(solution) if solution.status.is_feasible() && solution.rate > 0.0 => 0,
        _ => 1,
    }
}
