//! The onboard computer for an order.
#![no_std]
#![no_main]

use firmware_core::console::{MissionOrder, OrderError};
use panics::{Computer, Planner, Trained};

#[unsafe(no_mangle)]
pub fn entry(
    order: &MissionOrder,
    trained: Option<Trained>,
    planner: Option<&'static mut Planner>,
) -> Result<Computer, OrderError> {
    order.check()?;
    order.build(trained, planner)
}
