//! The whole onboard computer: controller, MAVLink client and ground link in one slot cycle.
//!
//! The module has no I/O and no clock: bytes and time come in as arguments, bytes go out on
//! request.
//!
//! ```text
//!             ground bytes                                  MAVLink bytes
//!                 |  ^                                           |  ^
//!  receive_ground v  | take_ground_frame         receive_mavlink v  | take_mavlink_frame
//!        +--------------------------------------------------------------------+
//!        |  link::Decoder   ->   Controller: plan, allocate   ->   Autopilot  |
//!        +--------------------------------------------------------------------+
//! ```
//!
//! In a slot the computer plans from the measured position, flies the leg, reports the
//! [`Arrival`](crate::link::Arrival), receives the channel state that the ground answers with, allocates, and sends the
//! command and a [`VehicleStatus`](crate::link::VehicleStatus); then the next slot begins. Slot `n` ends at `t_0 + n delta` of
//! the vehicle's clock, where `t_0` is the moment at which slot 1 began: the exchange takes place
//! in the first part of the next slot, and no message moves the end of a slot. An arrival that is
//! not answered is sent again. Where no channel state is received within
//! [`OnboardSettings::channel_patience`], the last one, aged, is used instead, and the command
//! states its age. Everything that is received and not used is counted.

mod computer;
mod links;
mod probe;
mod slot_cycle;
mod stage;

pub use computer::{Onboard, OnboardSettings};
pub use probe::{Activity, Probe};
pub use stage::{Fault, Stage};

#[cfg(test)]
mod tests;
